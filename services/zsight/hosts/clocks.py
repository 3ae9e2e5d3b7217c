"""How far the clocks of the hosts are apart, measured with their heartbeats."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import TYPE_CHECKING

from zsight_protocol.codec import decode
from zsight_protocol.errors import ProtocolError
from zsight_protocol.health import Health

if TYPE_CHECKING:
    from zsight.bus import Bus

__all__ = ["WARN_ABOVE", "Clock", "ask_clocks"]

WARN_ABOVE = 0.020
"""Seconds between two clocks above which transforms and clouds of two hosts no longer fit together."""


@dataclass(frozen=True)
class Clock:
    """A host's clock beside this host's: ahead by ``offset`` seconds, known to +- ``uncertainty``."""

    host: str
    offset: float
    uncertainty: float

    @property
    def warning(self) -> str:
        """What to do, in words; empty where the clock is right, or not surely wrong."""
        if abs(self.offset) - self.uncertainty <= WARN_ABOVE:
            return ""
        side = "ahead of" if self.offset > 0 else "behind"
        words = f"the clock of {self.host} is {abs(self.offset) * 1e3:.0f} ms {side} this host's"
        return f"{words}: let both follow one time server, or transforms and clouds will not fit together"


def ask_clocks(bus: Bus, timeout: float = 1.0) -> list[Clock]:
    """The clock of every host that answers within timeout seconds, by name.

    A host stamps its answer between the question's departure and the answer's arrival here, so its clock is known to
    half of that round trip (Cristian 1989); of several processes on a host the fastest answer counts.
    """
    asked = time.time()
    begin = time.monotonic()
    replies = bus.ask(bus.cell.health("*", "*"), b"", timeout, everyone=True)
    clocks: dict[str, Clock] = {}
    for payload in replies.within(timeout):
        half = (time.monotonic() - begin) / 2
        try:
            beat = decode(Health, payload)
        except ProtocolError:
            continue
        clock = Clock(beat.host, beat.header.stamp.ns / 1e9 - (asked + half), half)
        if beat.host not in clocks or half < clocks[beat.host].uncertainty:
            clocks[beat.host] = clock
    return [clocks[host] for host in sorted(clocks)]
