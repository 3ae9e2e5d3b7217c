"""The base of every service's settings, how they are read from text, and which may change while the service runs."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError

from zsight.errors import UsageError

if TYPE_CHECKING:
    from collections.abc import Mapping

__all__ = ["Live", "Settings", "describe", "is_live", "mistake", "parse", "variable"]

_LIVE = "may change while the service runs"

T = TypeVar("T")
Live = Annotated[T, _LIVE]
"""Marks a setting that its service reads anew each time it needs it: ``leaf: Live[float]``."""


class Settings(BaseModel):
    """Settings of a service, each with its unit and range in its description.

    They are read-only but for the live ones, whose ranges are checked again when they are set.
    """

    model_config = ConfigDict(extra="forbid", validate_assignment=True)

    @classmethod
    def __pydantic_init_subclass__(cls, **_: Any) -> None:
        """Freeze what is not live."""
        for name, field in cls.model_fields.items():
            field.frozen = not is_live(cls, name)


S = TypeVar("S", bound=Settings)


def is_live(kind: type[Settings], name: str) -> bool:
    """Whether a setting may change while its service runs."""
    return _LIVE in kind.model_fields[name].metadata


def parse(kind: type[S], values: Mapping[str, Any]) -> S:
    """Settings from names and values, which may be text.

    Raises:
        UsageError: a name is unknown or a value is out of range; says which are known.
    """
    try:
        return kind.model_validate({name.replace("-", "_"): value for name, value in values.items()})
    except ValidationError as error:
        raise UsageError(mistake(kind, error)) from None


def mistake(kind: type[Settings], error: ValidationError) -> str:
    """What is wrong with the first wrong setting, in words."""
    first = error.errors(include_url=False)[0]
    name = ".".join(str(part) for part in first["loc"])
    if first["type"] == "extra_forbidden":
        return f"no setting is called {name}; known are {', '.join(kind.model_fields)}"
    return f"setting {name} is {first['input']!r}: {first['msg']}"


def variable(process: str, name: str) -> str:
    """The environment variable that holds a setting of a process."""
    return "".join(c if c.isalnum() else "_" for c in f"ZSIGHT_{process}_{name}".upper())


def describe(kind: type[Settings]) -> list[tuple[str, str, str]]:
    """Name, default ("-" for none) and description of each setting."""
    return [
        (name.replace("_", "-"), _text(field.default), field.description or "")
        for name, field in kind.model_fields.items()
    ]


def _text(default: Any) -> str:
    """A default as it would be typed."""
    if default is None or default == "":
        return "-"
    return str(default).lower() if isinstance(default, bool) else str(default)
