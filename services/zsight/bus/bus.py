"""Typed messages on keys: what a service writes, reads, asks and answers, with everything counted."""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from zsight.bus.attachment import Attachment, new_writer_id
from zsight.bus.counters import ReadCounter, WriteCounter
from zsight.errors import ConnectionLost
from zsight_protocol.channels import Cell, Delivery, channel_of
from zsight_protocol.codec import decode, encode_parts
from zsight_protocol.errors import ProtocolError
from zsight_protocol.message import Message

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from zsight.bus.link import Closable, Link, RawReader, RawReplies, RawSample, RawWriter, RequestHandler

__all__ = ["Bus", "Reader", "Received", "Writer"]

log = logging.getLogger(__name__)

M = TypeVar("M", bound=Message)

_QUEUE = 256  # messages that an 'every' reader may be behind before the oldest is counted as lost
_STALE_NS = 50_000_000  # a message this much slower than the fastest one was held up on the way
_GRACE = 0.03  # seconds to wait for what comes behind a message that was held up


@dataclass(frozen=True)
class Received(Generic[M]):
    """A message and how it came: its key, its writer's stamp and number, and when it was here (ns, this host)."""

    message: M
    key: str
    attachment: Attachment | None
    received_ns: int


class Bus:
    """The messages of one process."""

    def __init__(self, link: Link, cell: Cell | None = None) -> None:
        """Args: link to the network, closed with the bus; cell whose keys are used."""
        self.link = link
        self.cell = cell or Cell()
        self.stopping = threading.Event()
        self.writers: list[WriteCounter] = []
        self.readers: list[ReadCounter] = []
        self.on_ready: Callable[[], object] = lambda: None
        self._ready_token: object = None
        self._open_readers: list[Reader[Any]] = []
        self._open_writers: list[Writer[Any]] = []

    def writer(self, key: str, kind: type[M]) -> Writer[M]:
        """A writer of one kind of message, delivered as the channel table says."""
        delivery = channel_of(key, self.cell.namespace).delivery
        counter = WriteCounter(key)
        self.writers.append(counter)
        writer = Writer(self.link.writer(key, delivery), kind, counter)
        # A writer that nobody refers to is withdrawn, and what it latched with it.
        self._open_writers.append(writer)
        return writer

    def reader(self, key: str, kind: type[M], *, delivery: Delivery | None = None) -> Reader[M]:
        """A reader of one kind of message; the key may hold wildcards, then the delivery must be given."""
        delivery = delivery or channel_of(key, self.cell.namespace).delivery
        counter = ReadCounter(key)
        self.readers.append(counter)
        reader = Reader(kind, delivery, counter, self.stopping)
        reader.attach(self.link.reader(key, delivery, reader.arrived))
        self._open_readers.append(reader)
        return reader

    def serve(self, key: str, handler: RequestHandler) -> Closable:
        """Answer requests on a key; handler must hand the work to another thread."""
        return self.link.serve(key, handler)

    def ask(self, key: str, payload: bytes, timeout: float, *, everyone: bool = False) -> RawReplies:
        """Send a request."""
        return self.link.ask(key, payload, timeout, everyone=everyone)

    def ready(self) -> None:
        """Called by a service when it reads all that it reads: from now on others may count on it."""
        # Zenoh withdraws a liveliness token that nobody refers to.
        self._ready_token = self.on_ready()

    def stop(self) -> None:
        """Wake every reader and end its loop; what is declared stays until close."""
        self.stopping.set()
        for reader in self._open_readers:
            reader.wake()

    def close(self) -> None:
        """Stop and leave the network."""
        self.stop()
        self.link.close()

    def __enter__(self) -> Bus:
        """The bus itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close it."""
        self.close()


class Writer(Generic[M]):
    """Sends messages of one kind on one key, numbered from 1."""

    def __init__(self, raw: RawWriter, kind: type[M], counter: WriteCounter) -> None:
        """Args: raw writer of the link; kind of message; counter that health beats read."""
        self._raw = raw
        self._kind = kind
        self._counter = counter
        self._id = new_writer_id()
        self._lock = threading.Lock()

    def send(self, message: M) -> None:
        """Send one message.

        Raises:
            ConnectionLost: the session was closed.
        """
        head, blob = encode_parts(message)
        with self._lock:
            sequence = self._counter.sent + 1
            attachment = Attachment(self._id, sequence, time.time_ns()).pack()
            try:
                self._raw.put(head, blob, attachment)
            except Exception as error:
                raise ConnectionLost(f"cannot send on {self._counter.key}: {error}") from error
            self._counter.count(len(head) + len(blob))

    def has_readers(self) -> bool:
        """True where anybody reads the key."""
        return self._raw.has_readers()

    def close(self) -> None:
        """Stop writing."""
        self._raw.close()


_Entry = tuple["RawSample", Attachment | None, int, bool]
"""A message that waits: its bytes, who sent it, when it was here (ns), whether it was held up on the way."""


def _writer(attachment: Attachment | None) -> int | None:
    return None if attachment is None else attachment.writer


class Reader(Generic[M]):
    """Takes messages of one kind, as the delivery of their channel says, and counts what it missed."""

    def __init__(self, kind: type[M], delivery: Delivery, counter: ReadCounter, stopping: threading.Event) -> None:
        """Args: kind of message; delivery; counter that health beats read; event that ends the loop."""
        self.counter = counter
        self._kind = kind
        self._delivery = delivery
        self._pending: deque[_Entry] = deque()
        self._changed = threading.Condition()
        self._stopping = stopping
        self._closed = False
        self._raw: RawReader | None = None

    def attach(self, raw: RawReader) -> None:
        """Keep the link's reader alive, and close it with this one."""
        self._raw = raw

    def arrived(self, sample: RawSample) -> None:
        """Called by the link's thread."""
        attachment = Attachment.unpack(sample.attachment)
        now = time.time_ns()
        with self._changed:
            if self._closed or self._stopping.is_set():
                return
            late = self.counter.arrived(attachment, now) > _STALE_NS
            older = next(
                (i for i, entry in enumerate(self._pending) if self._replaces(sample, attachment, entry)), None
            )
            if older is not None:
                del self._pending[older]
                self.counter.superseded += 1
            elif len(self._pending) >= _QUEUE:
                self._pending.popleft()
                self.counter.lost += 1
            self._pending.append((sample, attachment, now, late))
            self._changed.notify_all()

    def _replaces(self, sample: RawSample, attachment: Attachment | None, older: _Entry) -> bool:
        """Of a key only the newest message matters; what several writers latched on it stands side by side."""
        if self._delivery is Delivery.EVERY or sample.key != older[0].key:
            return False
        return self._delivery is not Delivery.LATCHED or _writer(attachment) == _writer(older[1])

    def take(self, timeout: float | None = None) -> Received[M] | None:
        """The next message; none when timeout seconds have passed, or the bus stops.

        A message that is not what its channel carries is logged, counted and skipped.
        """
        deadline = None if timeout is None else time.monotonic() + timeout
        while True:
            entry = self._next(deadline)
            if entry is None:
                return None
            received = self._decoded(*entry)
            if received is not None:
                return received

    def _next(self, deadline: float | None) -> tuple[RawSample, Attachment | None, int] | None:
        with self._changed:
            # What was to come one by one is still taken after the end; of the others there would always be a newer one.
            while not self._pending or (self._is_over() and self._delivery is not Delivery.EVERY):
                if self._is_over() or not self._wait(deadline):
                    return None
            if self._delivery is not Delivery.EVERY and self._pending[0][3]:
                self._wait_for_fresh()
            sample, attachment, now, _ = self._pending.popleft()
            return sample, attachment, now

    def _is_over(self) -> bool:
        return self._closed or self._stopping.is_set()

    def _wait(self, deadline: float | None) -> bool:
        """Wait for a change; false when the deadline has passed."""
        if deadline is None:
            self._changed.wait()
            return True
        return self._changed.wait(deadline - time.monotonic()) if deadline > time.monotonic() else False

    def _wait_for_fresh(self) -> None:
        """After a stall a backlog comes in fast: wait for the newest of it."""
        self._changed.wait_for(lambda: not self._pending[0][3] or self._closed, timeout=_GRACE)

    def _decoded(self, sample: RawSample, attachment: Attachment | None, now: int) -> Received[M] | None:
        payload = sample.take()
        if payload is None:
            self.counter.lost += 1
            return None
        try:
            message = decode(self._kind, payload)
        except ProtocolError as error:
            self.counter.refused += 1
            log.warning("refused a message on %s: %s", sample.key, error)
            return None
        self.counter.taken(len(payload), now)
        return Received(message, sample.key, attachment, now)

    def __iter__(self) -> Iterator[M]:
        """Messages until the bus stops."""
        while (received := self.take()) is not None:
            yield received.message

    def wake(self) -> None:
        """Let waiting threads look whether the bus is stopping."""
        with self._changed:
            self._changed.notify_all()

    def close(self) -> None:
        """Stop reading and end the loop."""
        self._closed = True
        if self._raw is not None:
            self._raw.close()
        self.wake()
