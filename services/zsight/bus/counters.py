"""What was written and read on a key, what was missed, how fast it goes and how long it takes."""

from __future__ import annotations

import time
from collections import OrderedDict, deque
from typing import TYPE_CHECKING

from zsight.bus.writer_track import WriterTrack
from zsight_protocol.health import Latency, ReaderHealth, WriterHealth

if TYPE_CHECKING:
    from zsight.bus.attachment import Attachment

__all__ = ["Rate", "ReadCounter", "Stopwatch", "WriteCounter"]

_WINDOW = 5.0  # seconds over which rates are averaged
_EVENTS = 4096  # most events that a rate remembers
_TIMES = 256  # latest times that a latency is told from
_LATE_NS = 50_000_000  # slower by this than its writer's fastest message: late
_WRITERS = 256  # most writers that a reader tells apart; the one that was silent longest is forgotten


class Rate:
    """Messages and bytes a second over the last few seconds; counted on one thread, read on any."""

    def __init__(self) -> None:
        """Nothing counted yet."""
        self._events: deque[tuple[float, int]] = deque(maxlen=_EVENTS)

    def count(self, size: int) -> None:
        """One more message of size bytes."""
        self._events.append((time.monotonic(), size))

    def per_second(self) -> tuple[float, float]:
        """Messages and bytes a second."""
        start = time.monotonic() - _WINDOW
        events = [event for event in self._events.copy() if event[0] >= start]
        if len(events) < 2:
            return 0.0, 0.0
        span = events[-1][0] - events[0][0]
        hertz = (len(events) - 1) / span if span > 0 else 0.0
        return hertz, hertz * sum(size for _, size in events) / len(events)


class Stopwatch:
    """The latest times that a stage took; counted on one thread, read on any."""

    def __init__(self) -> None:
        """Nothing measured yet."""
        self._times: deque[int] = deque(maxlen=_TIMES)

    def count(self, nanoseconds: int) -> None:
        """One more time."""
        self._times.append(nanoseconds)

    def latency(self) -> Latency | None:
        """Median, 99th percentile and maximum; none where nothing was measured."""
        times = sorted(self._times.copy())
        if not times:
            return None
        middle, high, highest = (times[int(share * (len(times) - 1))] / 1e6 for share in (0.5, 0.99, 1.0))
        return Latency(p50_ms=middle, p99_ms=high, max_ms=highest)


class WriteCounter:
    """What one writer sent."""

    def __init__(self, key: str) -> None:
        """Args: key that is written."""
        self.key = key
        self.sent = 0
        self._rate = Rate()
        self._since_stamp = Stopwatch()

    def count(self, size: int, since_stamp_ns: int | None = None) -> None:
        """One more message of size bytes, sent so long after its header's stamp."""
        self.sent += 1
        self._rate.count(size)
        if since_stamp_ns is not None:
            self._since_stamp.count(since_stamp_ns)

    def health(self) -> WriterHealth:
        """For the health beat."""
        hertz, bandwidth = self._rate.per_second()
        return WriterHealth(
            key=self.key,
            sent=self.sent,
            rate_hz=hertz,
            bytes_per_second=bandwidth,
            since_stamp=self._since_stamp.latency(),
        )


class ReadCounter:
    """What one reader got.

    Every message that its writers sent since the reader came is one of these: received (handed out), superseded by a
    newer one before it was taken, lost on the way or in a full queue, or refused as not decodable. Late are those that
    came 50 ms slower than their writer's fastest, whatever became of them.
    """

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
        self._tracks: OrderedDict[int, WriterTrack] = OrderedDict()
        self._on_the_way = Stopwatch()
        self._since_stamp = Stopwatch()

    def arrived(self, attachment: Attachment | None, now_ns: int) -> int:
        """Count the gap before this message, and whether it is late; how many are missing before it."""
        if attachment is None:
            return 0
        track = self._track(attachment, now_ns)
        missing = track.arrived(attachment, now_ns)
        self.lost += missing
        if track.delay_ns(attachment, now_ns) > _LATE_NS:
            self.late += 1
        return missing

    def _track(self, attachment: Attachment, now_ns: int) -> WriterTrack:
        track = self._tracks.get(attachment.writer)
        if track is None:
            track = self._tracks[attachment.writer] = WriterTrack(attachment, now_ns)
            if len(self._tracks) > _WRITERS:
                self._tracks.popitem(last=False)
        self._tracks.move_to_end(attachment.writer)
        return track

    def delay_ns(self, attachment: Attachment, now_ns: int) -> int:
        """How much longer than its writer's fastest message one took until now."""
        track = self._tracks.get(attachment.writer)
        return track.delay_ns(attachment, now_ns) if track is not None else 0

    def period_ns(self, attachment: Attachment) -> int:
        """Time between the last two messages of its writer."""
        track = self._tracks.get(attachment.writer)
        return track.period_ns if track is not None else 0

    def taken(self, size: int, received_ns: int, sent_ns: int | None = None, stamp_ns: int | None = None) -> None:
        """One message of size bytes was decoded; when it came, was sent, and was measured by its header's stamp."""
        self.received += 1
        self._last_ns = received_ns
        self._rate.count(size)
        if sent_ns is not None:
            self._on_the_way.count(received_ns - sent_ns)
        if stamp_ns is not None:
            self._since_stamp.count(time.time_ns() - stamp_ns)

    def health(self) -> ReaderHealth:
        """For the health beat."""
        hertz, _ = self._rate.per_second()
        age = None if self._last_ns is None else max(time.time_ns() - self._last_ns, 0) / 1e9
        return ReaderHealth(
            key=self.key,
            received=self.received,
            superseded=self.superseded,
            lost=self.lost,
            late=self.late,
            refused=self.refused,
            rate_hz=hertz,
            age_of_last=age,
            on_the_way=self._on_the_way.latency(),
            since_stamp=self._since_stamp.latency(),
        )
