"""The beat of a process: what goes in and out, what was lost, what went wrong last."""

from __future__ import annotations

from enum import IntEnum
from typing import Annotated

from pydantic import Field, Strict

from zsight_protocol.message import Bare, Count, Float64, Header, Message, Time

__all__ = ["Health", "Level", "ReaderHealth", "WriterHealth"]


class Level(IntEnum):
    """Severity, with the codes of diagnostic_msgs/DiagnosticStatus."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3


class WriterHealth(Message):
    """One key that a process writes."""

    key: str
    sent: Count
    rate_hz: Annotated[Float64, Field(ge=0)]
    bytes_per_second: Annotated[Float64, Field(ge=0)]


class ReaderHealth(Message):
    """One key that a process reads; missed messages were superseded by newer ones or lost on the way."""

    key: str
    received: Count
    missed: Count
    refused: Count
    rate_hz: Annotated[Float64, Field(ge=0)]
    age_of_last: Float64 | None = None


class Health(Message):
    """The beat itself."""

    header: Header
    host: str
    process: str
    service: str
    pid: Count
    version: str
    started: Time
    level: Annotated[Level, Bare()]
    last_error: str = ""
    errors: Count = 0
    memory_bytes: Count = 0
    writers: Annotated[tuple[WriterHealth, ...], Strict(False)] = ()
    readers: Annotated[tuple[ReaderHealth, ...], Strict(False)] = ()
