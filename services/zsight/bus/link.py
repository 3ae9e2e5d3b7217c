"""The seam under the bus: bytes on keys. One implementation speaks Zenoh, its twin stays in memory."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

from zsight.errors import ConnectionLost, UsageError

if TYPE_CHECKING:
    from zsight_protocol.channels import Delivery
    from zsight_protocol.point_cloud import Buffer

__all__ = [
    "Arrival",
    "Link",
    "LivelinessWatch",
    "RawReader",
    "RawReplies",
    "RawRequest",
    "RawSample",
    "RawWriter",
    "RequestHandler",
    "no_key",
    "session_closed",
]


def no_key(key: str) -> UsageError:
    """What a link raises where a key makes no sense."""
    return UsageError(
        f"key is {key!r}; expected names with one / between, such as zsight/kinect/points; * stands for one, ** for any"
    )


def session_closed(action: str, key: str) -> ConnectionLost:
    """What a link raises once it was closed."""
    return ConnectionLost(f"cannot {action} {key}: the session was closed")


class RawSample(Protocol):
    """Bytes that came in on a key and have not been copied out yet."""

    @property
    def key(self) -> str:
        """Where they came in."""

    @property
    def attachment(self) -> bytes:
        """What the writer attached: see zsight.bus.attachment."""

    @property
    def size(self) -> int:
        """How many bytes they are."""

    def take(self) -> bytes | None:
        """A copy of the bytes; none where they were lost before they could be copied."""


Arrival = Callable[[RawSample], None]


class RawWriter(Protocol):
    """Puts bytes on one key."""

    def put(self, head: bytes, blob: Buffer, attachment: bytes) -> None:
        """Send head and blob as one payload; never waits longer than the delivery allows."""

    def has_readers(self) -> bool:
        """True where anybody reads the key."""

    def close(self) -> None:
        """Stop writing."""


class RawReader(Protocol):
    """Hands every arrival to the callback it was made with until it is closed."""

    def close(self) -> None:
        """Stop reading."""


class RawRequest(Protocol):
    """A request that waits for its replies."""

    @property
    def payload(self) -> bytes:
        """What is asked."""

    @property
    def key(self) -> str:
        """The key that was asked, which may hold wildcards."""

    def reply(self, payload: bytes) -> None:
        """Send one reply; more may follow."""

    def refuse(self, words: str) -> None:
        """Say why there will be no reply, and close."""

    def close(self) -> None:
        """No reply follows: must be called, or the client waits until its time is over."""


RequestHandler = Callable[[RawRequest], None]


class RawReplies(Protocol):
    """The stream of replies to one request."""

    def take(self, timeout: float) -> bytes | None:
        """The next reply, or none at the end of the stream.

        Raises:
            TimeoutError: none came within timeout seconds.
            RequestRefused: the server refused the request.
        """

    def close(self) -> None:
        """Read no more; whoever answers is not told."""


class LivelinessWatch(Protocol):
    """Tells who comes and goes until it is closed."""

    def close(self) -> None:
        """Stop watching."""


@dataclass(frozen=True)
class Closable:
    """Something that only can be closed."""

    close: Callable[[], None]


class Link(Protocol):
    """What the bus needs of a network.

    Whatever takes a key raises a UsageError where it makes no sense, and ConnectionLost once the link was closed.
    """

    def writer(self, key: str, delivery: Delivery) -> RawWriter:
        """A writer on a key."""

    def reader(self, key: str, delivery: Delivery, arrival: Arrival) -> RawReader:
        """A reader on a key expression; arrival runs on the link's own thread and must be short."""

    def serve(self, key: str, handler: RequestHandler) -> Closable:
        """Answer requests; handler runs on the link's own thread and must hand the work on."""

    def ask(self, key: str, payload: bytes, timeout: float, *, everyone: bool = False) -> RawReplies:
        """Send a request to the best server, or to everyone who serves the key expression."""

    def declare_alive(self, key: str) -> Closable:
        """Hold a liveliness token until it is closed or the process dies."""

    def alive(self, key: str, timeout: float) -> set[str]:
        """Keys of all tokens that match."""

    def watch_alive(self, key: str, changed: Callable[[str, bool], None]) -> LivelinessWatch:
        """Call changed(key, alive) for every token that is there, comes or goes."""

    def connected(self) -> bool:
        """True while there is a network to speak of: a router or a peer at the other end."""

    def close(self) -> None:
        """Leave the network; everything declared is withdrawn."""
