"""What was written and read on a key, what was missed, and how fast it goes."""

from __future__ import annotations

import time
from collections import deque
from typing import TYPE_CHECKING

from zsight_protocol.health import ReaderHealth, WriterHealth

if TYPE_CHECKING:
    from zsight.bus.attachment import Attachment

__all__ = ["Rate", "ReadCounter", "WriteCounter"]

_WINDOW = 5.0  # seconds over which rates are averaged


class Rate:
    """Messages and bytes a second over the last few seconds."""

    def __init__(self) -> None:
        """Nothing counted yet."""
        self._events: deque[tuple[float, int]] = deque()
        self._bytes = 0

    def count(self, size: int) -> None:
        """One more message of size bytes."""
        now = time.monotonic()
        self._events.append((now, size))
        self._bytes += size
        self._forget(now)

    def _forget(self, now: float) -> None:
        while self._events and self._events[0][0] < now - _WINDOW:
            self._bytes -= self._events.popleft()[1]

    def per_second(self) -> tuple[float, float]:
        """Messages and bytes a second."""
        self._forget(time.monotonic())
        if len(self._events) < 2:
            return 0.0, 0.0
        span = self._events[-1][0] - self._events[0][0]
        intervals = len(self._events) - 1
        hertz = intervals / span if span > 0 else 0.0
        return hertz, hertz * self._bytes / len(self._events)


class WriteCounter:
    """What one writer sent."""

    def __init__(self, key: str) -> None:
        """Args: key that is written."""
        self.key = key
        self.sent = 0
        self._rate = Rate()

    def count(self, size: int) -> None:
        """One more message of size bytes."""
        self.sent += 1
        self._rate.count(size)

    def health(self) -> WriterHealth:
        """For the health beat."""
        hertz, bandwidth = self._rate.per_second()
        return WriterHealth(key=self.key, sent=self.sent, rate_hz=hertz, bytes_per_second=bandwidth)


class ReadCounter:
    """What one reader got: received, superseded by newer ones, lost on the way, late, refused as not decodable."""

    def __init__(self, key: str) -> None:
        """Args: key expression that is read."""
        self.key = key
        self.received = 0
        self.superseded = 0
        self.lost = 0
        self.late = 0
        self.refused = 0
        self._rate = Rate()
        self._last_ns: int | None = None
        self._sequences: dict[int, int] = {}
        self._fastest: dict[int, int] = {}

    def arrived(self, attachment: Attachment | None, now_ns: int) -> int:
        """Count the gap before this message; how much slower it came than its writer's fastest, in nanoseconds."""
        if attachment is None:
            return 0
        expected = self._sequences.get(attachment.writer, attachment.sequence - 1) + 1
        self.lost += max(attachment.sequence - expected, 0)
        self._sequences[attachment.writer] = max(attachment.sequence, expected - 1)
        # Differences to the fastest message need no common clock.
        transit = now_ns - attachment.sent_ns
        fastest = self._fastest[attachment.writer] = min(self._fastest.get(attachment.writer, transit), transit)
        return transit - fastest

    def taken(self, size: int, received_ns: int) -> None:
        """One message of size bytes was decoded."""
        self.received += 1
        self._last_ns = received_ns
        self._rate.count(size)

    def health(self) -> ReaderHealth:
        """For the health beat."""
        hertz, _ = self._rate.per_second()
        age = None if self._last_ns is None else max(time.time_ns() - self._last_ns, 0) / 1e9
        return ReaderHealth(
            key=self.key,
            received=self.received,
            missed=self.superseded + self.lost,
            refused=self.refused,
            rate_hz=hertz,
            age_of_last=age,
        )
