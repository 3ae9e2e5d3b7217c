"""Who is there and what goes through: the health of every process of a cell, asked for at once."""

from __future__ import annotations

import logging
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from zsight.errors import ConnectionLost
from zsight_protocol.codec import decode
from zsight_protocol.errors import ProtocolError
from zsight_protocol.health import Health

if TYPE_CHECKING:
    from zsight.bus import Bus
    from zsight_protocol.health import ReaderHealth, WriterHealth

__all__ = ["Topic", "ask_health", "present", "topics_of"]

log = logging.getLogger(__name__)


@dataclass
class Topic:
    """A key with those who write and those who read it, each with its process."""

    key: str
    writers: list[tuple[Health, WriterHealth]] = field(default_factory=list)
    readers: list[tuple[Health, ReaderHealth]] = field(default_factory=list)


def ask_health(bus: Bus, timeout: float = 1.0) -> list[Health]:
    """The health of every process that answers within timeout seconds, by host and name."""
    replies = bus.ask(bus.cell.health("*", "*"), b"", timeout, everyone=True)
    beats: list[Health] = []
    for payload in replies.within(timeout):
        try:
            beats.append(decode(Health, payload))
        except ProtocolError as error:
            log.warning("a process tells its health in words that are not understood: %s", error)
    return sorted(beats, key=lambda beat: (beat.host, beat.process))


def present(bus: Bus) -> str:
    """Which processes of the cell are there, in words, for an error that misses one."""
    try:
        beats = ask_health(bus)
    except ConnectionLost:
        return "this process is cut off from the network"
    if not beats:
        return f"cell {bus.cell.namespace} is empty: start it with: zsight up"
    ready = bus.link.alive(bus.cell.alive("*", "*"), 1.0)
    names = [b.process + ("" if bus.cell.alive(b.host, b.process) in ready else " (starting)") for b in beats]
    return f"in cell {bus.cell.namespace} there are {', '.join(names)}; see: zsight node list"


def topics_of(beats: list[Health]) -> list[Topic]:
    """All keys that are written or read, without the housekeeping."""
    topics: dict[str, Topic] = {}
    for beat in beats:
        for writer in beat.writers:
            topics.setdefault(writer.key, Topic(writer.key)).writers.append((beat, writer))
        for reader in beat.readers:
            topics.setdefault(reader.key, Topic(reader.key)).readers.append((beat, reader))
    return [topics[key] for key in sorted(topics) if "/@" not in key]
