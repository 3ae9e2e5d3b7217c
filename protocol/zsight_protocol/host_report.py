"""What the supervisor of a host tells of its processes: how they are, and how they ended when they did."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, Strict, StringConstraints

from zsight_protocol.message import Count, Header, Message, Time

__all__ = ["Crash", "HostReport", "ProcessReport"]

Line = Annotated[str, Field(max_length=2000)]


class Crash(Message):
    """How a process ended the last time: when, why, and the last lines of its log."""

    stamp: Time
    reason: Line
    last_words: Annotated[tuple[Line, ...], Strict(False), Field(max_length=40)] = ()


class ProcessReport(Message):
    """A process of the table: ``starting`` until it is ready, ``waiting`` for its next start, ``ended`` for good.

    In between it is ``running``, or ``silent`` where nothing is heard of it any more though it runs. ``starts`` counts
    its starts; ``pid`` is 0 while it does not run.
    """

    process: str
    service: str
    state: Annotated[str, StringConstraints(pattern=r"^(starting|running|silent|waiting|ended)$")]
    pid: Count = 0
    starts: Count = 0
    crash: Crash | None = None


class HostReport(Message):
    """All processes that one supervisor looks after."""

    header: Header
    host: str
    version: str
    processes: Annotated[tuple[ProcessReport, ...], Strict(False)] = ()
