"""Sends typed messages on one key."""

from __future__ import annotations

import threading
import time
from typing import TYPE_CHECKING, Generic, TypeVar

from zsight.bus.attachment import Attachment, new_writer_id
from zsight.errors import ConnectionLost
from zsight_protocol.codec import encode_parts
from zsight_protocol.message import Header, Message

if TYPE_CHECKING:
    from collections.abc import Callable

    from zsight.bus.counters import WriteCounter
    from zsight.bus.link import RawWriter

__all__ = ["Writer", "stamp_ns"]

M = TypeVar("M", bound=Message)


def stamp_ns(message: Message) -> int | None:
    """When a message says that it was measured, nanoseconds since the epoch; none where it does not say."""
    header = getattr(message, "header", None)
    return header.stamp.ns if isinstance(header, Header) else None


class Writer(Generic[M]):
    """Sends messages of one kind on one key, numbered from 1."""

    def __init__(
        self, raw: RawWriter, kind: type[M], counter: WriteCounter, closed: Callable[[Writer[M]], object]
    ) -> None:
        """Args: raw writer of the link; kind of message; counter that health beats read; called when it is closed."""
        self.counter = counter
        self._raw = raw
        self._kind = kind
        self._tell_closed = closed
        self._id = new_writer_id()
        self._lock = threading.Lock()

    def send(self, message: M) -> None:
        """Send one message.

        Raises:
            ConnectionLost: the session was closed.
        """
        head, blob = encode_parts(message)
        with self._lock:
            sent_ns = time.time_ns()
            attachment = Attachment(self._id, self.counter.sent + 1, sent_ns).pack()
            try:
                self._raw.put(head, blob, attachment)
            except Exception as error:
                raise ConnectionLost(f"cannot send on {self.counter.key}: {error}") from error
            stamp = stamp_ns(message)
            self.counter.count(len(head) + len(blob), None if stamp is None else sent_ns - stamp)

    def has_readers(self) -> bool:
        """True where anybody reads the key."""
        return self._raw.has_readers()

    def close(self) -> None:
        """Stop writing."""
        self._raw.close()
        self._tell_closed(self)
