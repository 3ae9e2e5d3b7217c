"""What has come in on a key and was not taken yet, kept as the delivery of its channel says."""

from __future__ import annotations

import time
from collections import OrderedDict
from typing import TYPE_CHECKING, NamedTuple

from zsight import limits
from zsight_protocol.channels import Delivery

if TYPE_CHECKING:
    from collections.abc import Hashable

    from zsight.bus.attachment import Attachment
    from zsight.bus.counters import ReadCounter
    from zsight.bus.link import RawSample

__all__ = ["Arrived", "Inbox"]

_STALE_NS = 50_000_000  # a message this much slower than its writer's fastest was held up
_GRACE = 0.03  # seconds that a held-up message waits at least for a newer one
_LONGEST = 1.0  # seconds that it waits at most while newer ones keep coming that were held up too


class Arrived(NamedTuple):
    """Bytes that wait: on which key, who sent them, when they were here (ns), how many are missing before them.

    ``payload`` is a copy where one was made at once.
    """

    sample: RawSample
    key: str
    payload: bytes | None
    attachment: Attachment | None
    received_ns: int
    lost_before: int


class Inbox:
    """Not safe between threads: the reader that owns it locks.

    Of what comes by *latest* only the newest of a key is kept, of *latched* the newest of each writer of a key, of
    *every* all. After a stall of the process or the network a backlog comes in at once: a held-up *latest* message
    waits a moment for a newer one, so that none is handed out that was overtaken on the way.
    """

    def __init__(self, delivery: Delivery, counter: ReadCounter) -> None:
        """Args: delivery; counter of what is superseded or lost here."""
        self._delivery = delivery
        self._counter = counter
        self._waiting: OrderedDict[Hashable, Arrived] = OrderedDict()
        self._arrivals = 0
        self._last_arrival = 0.0
        self._held_since: float | None = None
        self._last_look = 0.0

    def __len__(self) -> int:
        """How many messages wait."""
        return len(self._waiting)

    def put(self, arrived: Arrived) -> None:
        """Keep a message, in place of an older one where only the newest matters."""
        place = self._place(arrived)
        if self._waiting.pop(place, None) is not None:
            self._counter.superseded += 1
        elif len(self._waiting) >= limits.WAITING:
            self._waiting.popitem(last=False)
            self._counter.lost += 1
        self._waiting[place] = arrived
        self._last_arrival = time.monotonic()

    def holds_newer(self, arrived: Arrived) -> bool:
        """Whether a *latest* message waits that came on the same key as this one, which was taken."""
        return arrived.key in self._waiting

    def _place(self, arrived: Arrived) -> Hashable:
        if self._delivery is Delivery.EVERY:
            self._arrivals += 1
            return self._arrivals
        if self._delivery is Delivery.LATCHED:
            return arrived.key, arrived.attachment.writer if arrived.attachment is not None else None
        return arrived.key

    def next(self) -> tuple[Arrived | None, float | None]:
        """The message that comes next, or none and the seconds after which to look again (none: after a change)."""
        if not self._waiting:
            return None, None
        oldest = next(iter(self._waiting.values()))
        patience = self.patience(oldest)
        if patience > 0:
            return None, patience
        self._held_since = None
        return self._waiting.popitem(last=False)[1], None

    def patience(self, arrived: Arrived) -> float:
        """Seconds to wait for a newer message than this one, which was held up; 0 where it was not."""
        if not self.is_stale(arrived):
            return 0.0
        now = time.monotonic()
        grace = max(_GRACE, 2e-9 * self._period_ns(arrived))
        if self._held_since is None or now > self._last_look + 2 * grace:  # just begun, or stood still meanwhile
            self._held_since = now
        self._last_look = now
        end = min(max(self._held_since, self._last_arrival) + grace, self._held_since + _LONGEST)
        return max(end - now, 0.0)

    def is_stale(self, arrived: Arrived) -> bool:
        """True where a writer that goes on has sent newer ones long since."""
        if self._delivery is not Delivery.LATEST or arrived.attachment is None:
            return False
        delay = self._counter.delay_ns(arrived.attachment, time.time_ns())
        return delay > _STALE_NS and delay > 3 * self._period_ns(arrived) // 2

    def _period_ns(self, arrived: Arrived) -> int:
        return self._counter.period_ns(arrived.attachment) if arrived.attachment is not None else 0
