"""The settings of a running process: what they are, what they may be, and a change of one."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, JsonValue, Strict, StringConstraints

from zsight_protocol.message import Float64, Message

__all__ = ["Parameter", "ParameterAnswer", "ParameterRequest"]

Words = Annotated[str, Field(max_length=2000)]


class Parameter(Message):
    """One setting of a process.

    ``kind`` is bool, int, float or str, or json for lists and maps. ``minimum`` and ``maximum`` bound a number; an
    excluded one is no legal value itself. ``choices`` are all legal values where there are few. One that is not
    ``live`` is read at the start of its process alone; ``saved`` ones keep their value over a restart.
    """

    name: Annotated[str, StringConstraints(pattern=r"^[a-z][a-z0-9_]{0,63}$")]
    kind: Annotated[str, StringConstraints(pattern=r"^(bool|int|float|str|json)$")]
    value: JsonValue
    default: JsonValue
    minimum: Float64 | None = None
    maximum: Float64 | None = None
    minimum_excluded: bool = False
    maximum_excluded: bool = False
    choices: Annotated[tuple[JsonValue, ...], Strict(False)] = ()
    live: bool = False
    saved: bool = False
    description: Words = ""


class ParameterRequest(Message):
    """What to do with the settings of a process: list all, get one by name, set one, and keep it over a restart."""

    action: Annotated[str, StringConstraints(pattern=r"^(list|get|set)$")]
    name: Annotated[str, Field(max_length=64)] = ""
    value: JsonValue = None
    save: bool = False


class ParameterAnswer(Message):
    """The settings asked for, with whose they are; what became of a change in words."""

    host: str
    process: str
    service: str
    parameters: Annotated[tuple[Parameter, ...], Strict(False)] = ()
    message: Words = ""
