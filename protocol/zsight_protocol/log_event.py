"""Lines of the logs of a cell's processes, one event each."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, Strict

from zsight_protocol.message import Count, Header, Message

__all__ = ["LogEvent", "LogTail"]


class LogEvent(Message):
    """One event; ``number`` counts those of its process from 1, ``severity`` is a word of Python's logging."""

    header: Header
    host: str
    process: str
    number: Count
    severity: Annotated[str, Field(max_length=32)]
    logger: Annotated[str, Field(max_length=256)]
    text: Annotated[str, Field(max_length=8000)]


class LogTail(Message):
    """The last events of a process, oldest first."""

    events: Annotated[tuple[LogEvent, ...], Strict(False)] = ()
