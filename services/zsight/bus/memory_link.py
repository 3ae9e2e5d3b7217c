"""The link's twin in memory: the same semantics without processes, for tests of services."""

from __future__ import annotations

import queue
import re
import threading
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from zsight.bus.link import Arrival, Closable, RequestHandler, no_key, session_closed
from zsight.errors import ConnectionLost, RequestRefused
from zsight_protocol.channels import Delivery

if TYPE_CHECKING:
    from collections.abc import Callable, MutableMapping

    from zsight_protocol.point_cloud import Buffer

__all__ = ["MemoryLink", "MemoryNetwork", "matches"]


_KEY = re.compile(r"(\*\*?|[^/*#?$]+)(/(\*\*?|[^/*#?$]+))*")


def matches(expression: str, key: str) -> bool:
    """True where a key, which may hold wildcards itself, meets a key expression with ``*`` and ``**``.

    As in Zenoh, chunks that begin with '@' are met by the same chunk only.
    """
    return _meet(expression.split("/"), key.split("/"))


def _meet(a: list[str], b: list[str]) -> bool:
    if not a or not b:
        return all(chunk == "**" for chunk in a + b)
    if a[0] == "**":
        return _meet(a[1:], b) or (not b[0].startswith("@") and _meet(a, b[1:]))
    if b[0] == "**":
        return _meet(b, a)
    wild = "*" in (a[0], b[0]) and not (a[0].startswith("@") or b[0].startswith("@"))
    return (wild or a[0] == b[0]) and _meet(a[1:], b[1:])


@dataclass(frozen=True)
class _Sample:
    key: str
    payload: bytes
    attachment: bytes

    @property
    def size(self) -> int:
        return len(self.payload)

    def take(self) -> bytes | None:
        return self.payload


class MemoryNetwork:
    """What the links of one test share."""

    def __init__(self) -> None:
        self.lock = threading.RLock()
        self.readers: dict[object, tuple[str, Arrival]] = {}
        self.servers: dict[object, tuple[str, RequestHandler, MemoryLink]] = {}
        self.tokens: dict[object, str] = {}
        self.watches: dict[object, tuple[str, Callable[[str, bool], None]]] = {}
        self.latched: dict[object, _Sample] = {}
        self.waiting: dict[_Replies, MemoryLink] = {}

    def tell(self, key: str, *, alive: bool) -> None:
        """Tell every watch about a token."""
        with self.lock:
            watches = list(self.watches.values())
        for expression, changed in watches:
            if matches(expression, key):
                changed(key, alive)


class MemoryLink:
    """One process of a network in memory."""

    def __init__(self, network: MemoryNetwork | None = None) -> None:
        """Args: the network to join; left out: one of its own."""
        self._network = network or MemoryNetwork()
        self._mine: list[Closable] = []
        self._cut = False
        self._closed = False

    def cut(self) -> None:
        """Pull the cable of this process: what it asks reaches nobody, and no reply comes any more."""
        self._cut = True

    def _require(self, action: str, key: str) -> None:
        """That the link is open, and a key makes sense."""
        if self._closed:
            raise session_closed(action, key)
        if not _KEY.fullmatch(key):
            raise no_key(key)

    def _hold(self, closable: Closable) -> Closable:
        self._mine.append(closable)
        return closable

    def writer(self, key: str, delivery: Delivery) -> _Writer:
        """A writer on a key."""
        self._require("publish", key)
        writer = _Writer(self._network, key, delivery)
        self._hold(Closable(writer.close))
        return writer

    def reader(self, key: str, delivery: Delivery, arrival: Arrival) -> Closable:
        """A reader on a key expression."""
        self._require("read", key)
        name = object()
        with self._network.lock:
            self._network.readers[name] = (key, arrival)
            latched = [s for s in self._network.latched.values() if matches(key, s.key)]
        if delivery is Delivery.LATCHED:
            for sample in latched:
                arrival(sample)
        return self._hold(Closable(lambda: self._forget(self._network.readers, name)))

    def serve(self, key: str, handler: RequestHandler) -> Closable:
        """Answer requests."""
        self._require("serve", key)
        name = object()
        with self._network.lock:
            self._network.servers[name] = (key, handler, self)
        return self._hold(Closable(lambda: self._forget(self._network.servers, name)))

    def ask(self, key: str, payload: bytes, timeout: float, *, everyone: bool = False) -> _Replies:
        """Send a request; timeout is kept by the caller's clock alone."""
        del timeout
        self._require("ask", key)
        with self._network.lock:
            served = [] if self._cut else self._network.servers.values()
            found = [(h, link) for e, h, link in served if matches(e, key)]
        replies = _Replies(self._network, len(found) if everyone else min(len(found), 1), self.connected)
        for handler, server in found if everyone else found[:1]:
            request = _Request(key, payload, replies)
            server.hold_request(request)
            handler(request)
        return replies

    def hold_request(self, request: _Request) -> None:
        """A request that ends with this link."""
        self._mine.append(Closable(request.close))

    def declare_alive(self, key: str) -> Closable:
        """Hold a liveliness token."""
        self._require("hold", key)
        name = object()
        with self._network.lock:
            self._network.tokens[name] = key
        self._network.tell(key, alive=True)
        return self._hold(Closable(lambda: self._drop_token(name)))

    def _drop_token(self, name: object) -> None:
        with self._network.lock:
            key = self._network.tokens.pop(name, None)
        if key is not None:
            self._network.tell(key, alive=False)

    def alive(self, key: str, timeout: float) -> set[str]:
        """Keys of all tokens that match."""
        del timeout
        with self._network.lock:
            return {token for token in self._network.tokens.values() if matches(key, token)}

    def watch_alive(self, key: str, changed: Callable[[str, bool], None]) -> Closable:
        """Call changed(key, alive) for every token that is there, comes or goes."""
        name = object()
        with self._network.lock:
            self._network.watches[name] = (key, changed)
        for token in self.alive(key, 0):
            changed(token, True)
        return self._hold(Closable(lambda: self._forget(self._network.watches, name)))

    def connected(self) -> bool:
        """Until it is cut."""
        return not self._cut

    def close(self) -> None:
        """Leave the network."""
        self._closed = True
        for closable in reversed(self._mine):
            closable.close()
        self._mine.clear()

    def _forget(self, table: MutableMapping[object, Any], name: object) -> None:
        with self._network.lock:
            table.pop(name, None)


class _Writer:
    def __init__(self, network: MemoryNetwork, key: str, delivery: Delivery) -> None:
        self._network = network
        self._key = key
        self._delivery = delivery
        self._closed = False

    def put(self, head: bytes, blob: Buffer, attachment: bytes) -> None:
        sample = _Sample(self._key, head + bytes(blob), attachment)
        with self._network.lock:
            if self._closed:
                raise ConnectionLost("the writer was closed")
            if self._delivery is Delivery.LATCHED:
                self._network.latched[self] = sample
            arrivals = [
                arrival for expression, arrival in self._network.readers.values() if matches(expression, self._key)
            ]
        for arrival in arrivals:
            arrival(sample)

    def has_readers(self) -> bool:
        with self._network.lock:
            return any(matches(expression, self._key) for expression, _ in self._network.readers.values())

    def close(self) -> None:
        with self._network.lock:
            self._closed = True
            self._network.latched.pop(self, None)


class _Replies:
    def __init__(self, network: MemoryNetwork, servers: int, connected: Callable[[], bool]) -> None:
        self._network = network
        self._connected = connected
        self._queue: queue.SimpleQueue[bytes | Exception | None] = queue.SimpleQueue()
        self._open = servers
        if servers == 0:
            self._queue.put(None)

    def put(self, payload: bytes | Exception) -> None:
        if self._connected():
            self._queue.put(payload)

    def end_one(self) -> None:
        with self._network.lock:
            self._open -= 1
            last = self._open == 0
        if last and self._connected():
            self._queue.put(None)

    def take(self, timeout: float) -> bytes | None:
        try:
            entry = self._queue.get(timeout=max(timeout, 0.0))
        except queue.Empty:
            raise TimeoutError from None
        if isinstance(entry, Exception):
            raise entry
        return entry

    def close(self) -> None:
        """Nobody is told."""


class _Request:
    def __init__(self, key: str, payload: bytes, replies: _Replies) -> None:
        self.key = key
        self.payload = payload
        self._replies = replies
        self._lock = threading.Lock()
        self._open = True

    def reply(self, payload: bytes) -> None:
        with self._lock:
            if self._open:
                self._replies.put(payload)

    def refuse(self, words: str) -> None:
        with self._lock:
            if self._open:
                self._replies.put(RequestRefused(words))
        self.close()

    def close(self) -> None:
        with self._lock:
            was_open, self._open = self._open, False
        if was_open:
            self._replies.end_one()
