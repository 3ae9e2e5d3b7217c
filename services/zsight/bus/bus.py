"""Typed messages on keys: what a service writes, reads, asks and answers, with everything counted."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING, Any, TypeVar

from zsight.bus.counters import ReadCounter, WriteCounter
from zsight.bus.gate import Gate
from zsight.bus.reader import Reader, Received
from zsight.bus.replies import Replies
from zsight.bus.writer import Writer
from zsight_protocol.channels import Cell, Delivery, channel_of
from zsight_protocol.message import Message

if TYPE_CHECKING:
    from collections.abc import Callable

    from zsight.bus.link import Closable, Link, RequestHandler

__all__ = ["Bus", "Reader", "Received", "Replies", "Writer"]

M = TypeVar("M", bound=Message)


class Bus:
    """The messages of one process."""

    def __init__(self, link: Link, cell: Cell | None = None) -> None:
        """Args: link to the network, closed with the bus; cell whose keys are used."""
        self.link = link
        self.cell = cell or Cell()
        self.stopping = threading.Event()
        self.on_ready: Callable[[], object] = lambda: None
        self.is_ready = False
        self._ready_token: object = None
        # A writer that nobody refers to is withdrawn, and what it latched with it.
        self._open_readers: dict[Reader[Any], None] = {}
        self._open_writers: dict[Writer[Any], None] = {}

    @property
    def writers(self) -> list[WriteCounter]:
        """What every open writer counts."""
        return [writer.counter for writer in list(self._open_writers)]

    @property
    def readers(self) -> list[ReadCounter]:
        """What every open reader counts."""
        return [reader.counter for reader in list(self._open_readers)]

    def writer(self, key: str, kind: type[M]) -> Writer[M]:
        """A writer of one kind of message, delivered as the channel table says."""
        delivery = channel_of(key, self.cell.namespace).delivery
        writer = Writer(
            self.link.writer(key, delivery),
            kind,
            WriteCounter(key),
            lambda closed: self._open_writers.pop(closed, None),
        )
        self._open_writers[writer] = None
        return writer

    def reader(self, key: str, kind: type[M], *, delivery: Delivery | None = None) -> Reader[M]:
        """A reader of one kind of message; the key may hold wildcards, then the delivery must be given."""
        delivery = delivery or channel_of(key, self.cell.namespace).delivery
        reader = Reader(
            kind, delivery, ReadCounter(key), self.stopping, lambda closed: self._open_readers.pop(closed, None)
        )
        reader.attach(self.link.reader(key, delivery, reader.arrived))
        self._open_readers[reader] = None
        return reader

    def serve(self, key: str, handler: RequestHandler) -> Closable:
        """Answer requests on a key, within their limits; handler must hand the work to another thread."""
        return self.link.serve(key, Gate(handler))

    def ask(self, key: str, payload: bytes, timeout: float, *, everyone: bool = False) -> Replies:
        """Send a request to the best server, or to everyone who serves the key expression."""
        return Replies(self.link, self.link.ask(key, payload, timeout, everyone=everyone))

    def ready(self) -> None:
        """Called by a service when it reads all that it reads: from now on others may count on it."""
        self.is_ready = True
        # Zenoh withdraws a liveliness token that nobody refers to.
        self._ready_token = self.on_ready()

    def stop(self) -> None:
        """Wake every reader and end its loop; what is declared stays until close."""
        self.stopping.set()
        for reader in list(self._open_readers):
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
