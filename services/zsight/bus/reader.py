"""Takes typed messages of one key, or of several."""

from __future__ import annotations

import logging
import threading
import time
from operator import attrgetter
from typing import TYPE_CHECKING, Generic, NamedTuple, TypeVar

from zsight import limits
from zsight.bus.attachment import Attachment
from zsight.bus.inbox import Arrived, Inbox
from zsight.bus.writer import stamp_ns
from zsight_protocol.channels import Delivery
from zsight_protocol.codec import decode
from zsight_protocol.errors import ProtocolError
from zsight_protocol.message import Message

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from zsight.bus.counters import ReadCounter
    from zsight.bus.link import RawReader, RawSample

__all__ = ["Reader", "Received"]

log = logging.getLogger(__name__)

M = TypeVar("M", bound=Message)


class Received(NamedTuple, Generic[M]):
    """A message and how it came.

    Its key; its writer's stamp and number; when it was here (ns, this host); how many messages of that writer went
    missing just before it.
    """

    message: M
    key: str
    attachment: Attachment | None
    received_ns: int
    lost_before: int = 0

    def stages_ms(self) -> dict[str, float]:
        """How long it took from its stamp until it was sent, and from there until it was here, milliseconds."""
        stamp, sent = stamp_ns(self.message), self.attachment.sent_ns if self.attachment is not None else None
        stages = {} if sent is None else {"sent_to_received": (self.received_ns - sent) / 1e6}
        return stages if sent is None or stamp is None else {"stamp_to_sent": (sent - stamp) / 1e6, **stages}


class Reader(Generic[M]):
    """Takes messages of one kind, as the delivery of their channel says, and counts what it missed."""

    def __init__(
        self,
        kind: type[M],
        delivery: Delivery,
        counter: ReadCounter,
        stopping: threading.Event,
        closed: Callable[[Reader[M]], object],
    ) -> None:
        """Args: kind of message; delivery; counter for health beats; event that ends the loop; called when closed."""
        self.counter = counter
        self._kind = kind
        self._delivery = delivery
        self._pending = Inbox(delivery, counter)
        self._lock = threading.RLock()  # a signal that stops the bus may come while it is held
        self._changed = threading.Condition(self._lock)
        self._stopping = stopping
        self._tell_closed = closed
        self._closed = False
        self._came = 0  # messages so far
        self._in_hand = False  # one was taken, and its taker has not come back yet
        self._raw: RawReader | None = None

    def attach(self, raw: RawReader) -> None:
        """Keep the link's reader alive, and close it with this one."""
        self._raw = raw

    def arrived(self, sample: RawSample) -> None:
        """Called by the link's thread."""
        attachment = Attachment.unpack(sample.attachment)
        now = time.time_ns()
        # What may queue must not hold the writer's shared memory meanwhile.
        queues = self._delivery is Delivery.EVERY and sample.size <= limits.MESSAGE_BYTES
        payload = sample.take() if queues else None
        with self._lock:
            if self._is_over():
                return
            missing = self.counter.arrived(attachment, now)
            self._pending.put(Arrived(sample, sample.key, payload, attachment, now, missing))
            self._came += 1
            self._changed.notify_all()
        if missing and self._delivery is Delivery.EVERY:
            log.warning("%d messages on %s were lost on the way", missing, sample.key)

    def take(self, timeout: float | None = None) -> Received[M] | None:
        """The next message; none when timeout seconds have passed, or the bus stops.

        A message that is not what its channel carries is logged, counted and skipped.
        """
        deadline = None if timeout is None else time.monotonic() + timeout
        while (arrived := self._next(deadline)) is not None:
            received = self._decoded(arrived)
            if received is not None and not self._is_overtaken(arrived):
                return self._counted(received)
        return None

    def caught_up(self, timeout: float) -> bool:
        """Wait until whoever takes messages is done with all that have come so far; false where that takes too long."""
        with self._lock:
            came = self._came
            return self._changed.wait_for(lambda: self._done() >= came or self._is_over(), timeout)

    def _done(self) -> int:
        return self._came - len(self._pending) - self._in_hand

    def _next(self, deadline: float | None) -> Arrived | None:
        with self._lock:
            if self._in_hand:
                self._in_hand = False
                self._changed.notify_all()
            # What was to come one by one is still taken after the end; of the rest there would always be a newer one.
            while not self._is_over() or (self._delivery is Delivery.EVERY and len(self._pending)):
                arrived, patience = self._pending.next()
                if arrived is not None:
                    self._in_hand = True
                    return arrived
                left = None if deadline is None else deadline - time.monotonic()
                if left is not None and left <= 0:
                    return None
                self._changed.wait(min((time for time in (patience, left) if time is not None), default=None))
            return None

    def _is_over(self) -> bool:
        return self._closed or self._stopping.is_set()

    def _is_overtaken(self, arrived: Arrived) -> bool:
        """True where the process stood still while it took a message, and a newer one has come since."""
        with self._lock:
            while not self._is_over() and not len(self._pending):
                patience = self._pending.patience(arrived)
                if not patience:
                    return False
                self._changed.wait(patience)
            overtaken = self._pending.holds_newer(arrived) and self._pending.is_stale(arrived)
            self.counter.superseded += overtaken
            return overtaken

    def _decoded(self, arrived: Arrived) -> tuple[Arrived, M, int] | None:
        if arrived.sample.size > limits.MESSAGE_BYTES:  # through shared memory, where Zenoh keeps no limit
            self._refuse(arrived.key, f"{arrived.sample.size} bytes; at most {limits.MESSAGE_BYTES} are read")
            return None
        payload = arrived.payload if self._delivery is Delivery.EVERY else arrived.sample.take()
        if payload is None:
            self.counter.lost += 1
            return None
        try:
            return arrived, decode(self._kind, payload), len(payload)
        except ProtocolError as error:
            self._refuse(arrived.key, error)
            return None

    def _refuse(self, key: str, error: ProtocolError | str) -> None:
        self.counter.refused += 1
        log.warning("refused a message on %s: %s", key, error)

    def _counted(self, decoded: tuple[Arrived, M, int]) -> Received[M]:
        arrived, message, size = decoded
        attachment = arrived.attachment
        sent_ns = None if attachment is None else attachment.sent_ns
        # A latched value may be as old as it likes.
        stamp = None if self._delivery is Delivery.LATCHED else stamp_ns(message)
        self.counter.taken(size, arrived.received_ns, sent_ns, stamp)
        return Received(message, arrived.key, attachment, arrived.received_ns, arrived.lost_before)

    def __iter__(self) -> Iterator[M]:
        """Messages until the bus stops; one that its taker let go of leaves its memory, still warm, to the next."""
        # map holds on to nothing, as a loop with a name for what it took would.
        return map(attrgetter("message"), iter(self.take, None))

    def wake(self) -> None:
        """Let waiting threads look whether the bus is stopping."""
        with self._lock:
            self._changed.notify_all()

    def close(self) -> None:
        """Stop reading and end the loop."""
        self._closed = True
        if self._raw is not None:
            self._raw.close()
        self.wake()
        self._tell_closed(self)
