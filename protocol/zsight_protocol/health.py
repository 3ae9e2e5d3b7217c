"""The beat of a process: what goes in and out, what was lost, what went wrong last."""

from __future__ import annotations

from enum import IntEnum
from typing import Annotated

from pydantic import Field, Strict

from zsight_protocol.message import Bare, Count, Extras, Float64, Header, Message, Time

__all__ = ["Health", "Latency", "Level", "ReaderHealth", "WriterHealth"]


class Level(IntEnum):
    """Severity, with the codes of diagnostic_msgs/DiagnosticStatus."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3


class Latency(Message):
    """How long a stage took of late, milliseconds; negative where the clocks of two hosts differ."""

    p50_ms: Float64
    p99_ms: Float64
    max_ms: Float64


class WriterHealth(Message):
    """One key that a process writes; ``since_stamp`` is from a message's own stamp until it was sent."""

    key: str
    sent: Count
    rate_hz: Annotated[Float64, Field(ge=0)]
    bytes_per_second: Annotated[Float64, Field(ge=0)]
    since_stamp: Latency | None = None


class ReaderHealth(Message):
    """One key that a process reads.

    Of the messages sent since it reads, each was received, superseded by a newer one before it was taken, lost on the
    way, or refused as not decodable; late ones were held up on the way, whatever became of them. ``on_the_way`` is from
    sending to arrival, ``since_stamp`` from a message's own stamp until the reader had it decoded.
    """

    key: str
    received: Count
    superseded: Count
    lost: Count
    late: Count
    refused: Count
    rate_hz: Annotated[Float64, Field(ge=0)]
    age_of_last: Float64 | None = None
    on_the_way: Latency | None = None
    since_stamp: Latency | None = None


class Health(Message):
    """The beat itself, with the settings that the process runs with."""

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
    settings: Extras = Field(default_factory=dict)
