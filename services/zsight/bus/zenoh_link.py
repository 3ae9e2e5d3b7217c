"""The link over Zenoh. This package is the only one that imports zenoh."""

from __future__ import annotations

import json
import logging
import os
import queue
import re
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import zenoh
from zenoh import ext, handlers

from zsight import limits
from zsight.bus.buffer_ring import BufferRing
from zsight.bus.link import Arrival, Closable, RequestHandler, no_key, session_closed
from zsight.errors import ConnectionLost, NotAllowed, RequestRefused, UsageError
from zsight.keys import identity
from zsight.keys.identity import read_hosts, read_identity
from zsight.keys.roles import access_rules, grants_of
from zsight.reaching import what_happened
from zsight_protocol.channels import Delivery

if TYPE_CHECKING:
    from collections.abc import Callable

    from zsight.keys.identity import Identity
    from zsight.network import Network
    from zsight_protocol.point_cloud import Buffer

__all__ = ["ZenohLink", "open_link", "open_router"]

log = logging.getLogger(__name__)

_SHARED_FROM = 32 * 1024  # smaller payloads travel faster inside a message than as a reference to shared memory
_OPEN_MS = 2000  # a call that takes longer is given up and tried anew: TCP would call ever less often by itself
_LEASE_MS = 1000  # a silent link counts as cut after this long
_NOBODY = "Unable to connect to any of"  # Zenoh's words for no answer; they repeat the endpoints
_ROUTING = "(rx: (worker_threads: 32))"
"""Zenoh's threads in a router that read from links: one that hands a message on to a link that has been cut waits, and
while all wait, nobody notices that the link is silent. Zenoh's own number is 2."""
_REFUSED = b"refused: "  # tells our servers' words from Zenoh's own error replies


def open_link(network: Network, *, mode: str = "client", explain: bool = True) -> ZenohLink:
    """Join the network; where that fails, look what happens at each endpoint, which may take a second, to explain it.

    Raises:
        ConnectionLost: no endpoint could be reached; says which were tried.
        UsageError: an endpoint or the configuration file makes no sense.
    """
    config = _config(network, mode)
    guard = Guard.of(network)
    try:
        return ZenohLink(zenoh.open(config), guard, shared_memory=network.shared_memory)
    except zenoh.ZError as error:
        why = "" if str(error).startswith(_NOBODY) else f" ({_short(error)})"
        look = partial(what_happened, keys=network.keys) if explain else str
        tried = "; ".join(map(look, network.connect))
        raise ConnectionLost(f"cannot reach a router{why}: {tried}") from None


def open_router(network: Network) -> ZenohLink:
    """Be the router that the other processes join.

    Raises:
        ConnectionLost: an endpoint is taken, or cannot be listened on.
        UsageError: others would reach it and no key be asked for, or its keys make no sense.
    """
    network.require_guarded()
    if network.open and not network.keys:
        log.warning("open to everybody who reaches %s: nobody is asked for a key", ", ".join(network.listen))
    os.environ.setdefault("ZENOH_RUNTIME", _ROUTING)  # read once a process, with its first session
    try:
        return ZenohLink(zenoh.open(_config(network, "router")), Guard())
    except zenoh.ZError as error:
        where = ", ".join(network.listen)
        raise ConnectionLost(
            f"cannot listen on {where} ({_short(error)}): is another router running there? Stop it with: zsight down"
        ) from None


def _short(error: Exception) -> str:
    """The first sentence of Zenoh's long errors."""
    quoted = re.search(r'msg: "([^"]+)', str(error))
    words = quoted[1] if quoted else str(error)
    return words.split(" at ", 1)[0].splitlines()[0].rstrip(" .")


def _config(network: Network, mode: str) -> zenoh.Config:
    settings: dict[str, Any] = {
        "mode": mode,
        "scouting/multicast/enabled": network.multicast,
        "timestamping/enabled": True,
        "transport/link/tx/queue/size/data": 16,
        "transport/link/tx/lease": _LEASE_MS,
        "transport/link/rx/max_message_size": limits.MESSAGE_BYTES,
        "transport/unicast/max_sessions": limits.SESSIONS,
        "transport/unicast/open_timeout": _OPEN_MS,
        "transport/shared_memory/enabled": network.shared_memory,
        **_secured(network, mode),
    }
    if network.shared_memory:
        # What is not put there by a ring may be taken back from nobody: Zenoh must not put it there by itself.
        settings["transport/shared_memory/transport_optimization/enabled"] = False
    if mode == "router":
        settings["listen/endpoints"] = list(network.listen)
        settings["connect/endpoints"] = list(network.peers)
        settings["connect/exit_on_failure"] = False
    else:
        settings["connect/endpoints"] = list(network.connect)
        settings["connect/timeout_ms"] = 0
    settings["connect/retry"] = {"period_init_ms": 100, "period_max_ms": 500, "period_increase_factor": 2}
    if network.config_file and not Path(network.config_file).is_file():
        raise UsageError(f"ZENOH_CONFIG names {network.config_file}, and there is no such file")
    try:
        config = zenoh.Config.from_file(network.config_file) if network.config_file else zenoh.Config()
        for key, value in settings.items():
            config.insert_json5(key, json.dumps(value))
    except zenoh.ZError as error:
        given = ", ".join((*network.connect, *network.listen, *network.peers, network.config_file)).rstrip(", ")
        raise UsageError(
            f"the network settings are not understood: {_short(error)}; got {given}; "
            "expected endpoints such as tcp/192.0.2.7:7447"
        ) from None
    return config


def _secured(network: Network, mode: str) -> dict[str, Any]:
    """Mutual TLS with the keys of this host, and at the router the access rules of all hosts."""
    if not network.keys:
        return {}
    folder = Path(network.keys)
    read_identity(folder)
    router = mode == "router"
    tls = {
        "root_ca_certificate": str(folder / (identity.TRUSTED if router else identity.CA)),
        "enable_mtls": True,
        "connect_private_key": str(folder / identity.KEY),
        "connect_certificate": str(folder / identity.CERTIFICATE),
        "verify_name_on_connect": True,
        "close_link_on_expiration": True,
    }
    if not router:
        return {"transport/link/tls": tls}
    tls |= {"listen_private_key": str(folder / identity.KEY), "listen_certificate": str(folder / identity.CERTIFICATE)}
    return {"transport/link/tls": tls, "access_control": access_rules(read_hosts(folder))}


@dataclass(frozen=True)
class Guard:
    """What this host's keys allow; without keys everything.

    The router drops what is not allowed without a word, so that it is looked at here first, where it can be told.
    """

    identity: Identity | None = None

    @classmethod
    def of(cls, network: Network) -> Guard:
        """Of the keys in a network's folder."""
        return cls(read_identity(Path(network.keys)) if network.keys else None)

    def require(self, action: str, key: str) -> None:
        """That an action on a key is allowed.

        Raises:
            NotAllowed: it is not.
        """
        if self.identity is None:
            return
        granted = [
            f"{cell}/{pattern}" for cell in self.identity.cells for pattern in grants_of(self.identity).of(action)
        ]
        if not any(zenoh.KeyExpr(pattern).includes(zenoh.KeyExpr(key)) for pattern in granted):
            raise NotAllowed(
                f"the keys of {self.identity.host} do not allow to {action} {key}: its roles are "
                f"{', '.join(self.identity.roles)} in {', '.join(self.identity.cells)}; see: zsight keys add --help"
            )


class ZenohLink:
    """A Zenoh session as the bus sees it."""

    def __init__(self, session: zenoh.Session, guard: Guard, *, shared_memory: bool = True) -> None:
        """Args: an open session, closed with the link; what this host may do; whether to use shared memory."""
        self._session = session
        self._guard = guard
        self._shared_memory = shared_memory
        self._closed = False

    def _require(self, action: str, key: str) -> None:
        """That the link is open, a key makes sense and an action on it is allowed."""
        if self._closed:
            raise session_closed(action, key)
        try:
            zenoh.KeyExpr(key)
        except zenoh.ZError:
            raise no_key(key) from None
        self._guard.require(action, key)

    def writer(self, key: str, delivery: Delivery) -> _ZenohWriter:
        """A writer on a key."""
        self._require("publish", key)
        if delivery is Delivery.LATCHED:
            publisher: Any = ext.declare_advanced_publisher(
                self._session,
                key,
                congestion_control=zenoh.CongestionControl.BLOCK,
                cache=ext.CacheConfig(max_samples=1),
                publisher_detection=True,
            )
            # The advanced publisher does not tell who reads it; a plain one that sends nothing does.
            return _ZenohWriter(publisher, self._session.declare_publisher(key))
        drop = delivery is Delivery.LATEST
        plain = self._session.declare_publisher(
            key,
            congestion_control=zenoh.CongestionControl.DROP if drop else zenoh.CongestionControl.BLOCK,
            priority=zenoh.Priority.DATA if drop else zenoh.Priority.INTERACTIVE_HIGH,
        )
        return _ZenohWriter(plain, plain, BufferRing() if drop and self._shared_memory else None)

    def reader(self, key: str, delivery: Delivery, arrival: Arrival) -> Closable:
        """A reader on a key expression."""
        self._require("read", key)
        # A direct callback has no hidden queue; the bus keeps what it wants of the arrivals.
        handler: Any = handlers.Callback(lambda sample: arrival(_ZenohSample(sample)), indirect=False)
        if delivery is Delivery.LATCHED:
            # A writer keeps one value; to ask for one alone loses values where the key holds wildcards.
            history = ext.HistoryConfig(detect_late_publishers=True)
            subscriber: Any = ext.declare_advanced_subscriber(self._session, key, handler, history=history)
        else:
            subscriber = self._session.declare_subscriber(key, handler)
        return Closable(lambda: self._undeclare(subscriber))

    def serve(self, key: str, handler: RequestHandler) -> Closable:
        """Answer requests."""
        self._require("serve", key)
        direct: Any = handlers.Callback(lambda query: handler(_ZenohRequest(query, key)), indirect=False)
        queryable = self._session.declare_queryable(key, direct, complete=True)
        return Closable(lambda: self._undeclare(queryable))

    def ask(self, key: str, payload: bytes, timeout: float, *, everyone: bool = False) -> _ZenohReplies:
        """Send a request."""
        self._require("ask", key)
        return _ZenohReplies(self._session, key, payload, timeout, everyone=everyone)

    def declare_alive(self, key: str) -> Closable:
        """Hold a liveliness token."""
        self._require("hold", key)
        token = self._session.liveliness().declare_token(key)
        return Closable(lambda: self._undeclare(token))

    def alive(self, key: str, timeout: float) -> set[str]:
        """Keys of all tokens that match."""
        replies = self._session.liveliness().get(key, timeout=timeout)
        return {str(reply.ok.key_expr) for reply in replies if reply.ok is not None}

    def watch_alive(self, key: str, changed: Callable[[str, bool], None]) -> Closable:
        """Call changed(key, alive) for every token that is there, comes or goes."""
        handler: Any = handlers.Callback(
            lambda sample: changed(str(sample.key_expr), sample.kind == zenoh.SampleKind.PUT), indirect=False
        )
        subscriber = self._session.liveliness().declare_subscriber(key, handler, history=True)
        return Closable(lambda: self._undeclare(subscriber))

    def connected(self) -> bool:
        """True while a router or a peer is at the other end."""
        info = self._session.info
        return not self._closed and bool(info.routers_zid() or info.peers_zid())

    def close(self) -> None:
        """Leave the network."""
        self._closed = True
        self._session.close()

    def _undeclare(self, entity: Any) -> None:
        if not self._closed:
            entity.undeclare()


class _ZenohSample:
    def __init__(self, sample: zenoh.Sample) -> None:
        self._sample = sample

    @property
    def key(self) -> str:
        return str(self._sample.key_expr)

    @property
    def attachment(self) -> bytes:
        attachment = self._sample.attachment
        return attachment.to_bytes() if attachment is not None else b""

    @property
    def size(self) -> int:
        return len(self._sample.payload)

    def take(self) -> bytes | None:
        payload = self._sample.payload
        copied = payload.to_bytes()
        shared = payload.as_shm()
        # A writer takes back the memory of a reader that stalled: what was copied then may be half another cloud.
        return copied if shared is None or shared.is_valid() else None


class _ZenohWriter:
    """Big payloads of which only the newest matters go through shared memory; what must not be lost never does.

    A buffer may be taken back from a reader that stalls; bytes in a socket may not.
    """

    def __init__(self, publisher: Any, matching: Any, ring: BufferRing | None = None) -> None:
        self._publisher = publisher
        self._matching = matching
        self._ring = ring
        self._is_read = False
        # Zenoh tells of a change, and at once where somebody reads already; to ask before each cloud takes longer.
        told: Any = handlers.Callback(self._matched, indirect=False)
        self._listener = matching.declare_matching_listener(told)

    def _matched(self, status: zenoh.MatchingStatus) -> None:
        self._is_read = status.matching

    def put(self, head: bytes, blob: Buffer, attachment: bytes) -> None:
        payload: bytes | zenoh.ZBytes | None = None
        if self._ring is not None and len(head) + len(blob) >= _SHARED_FROM:
            if not self._is_read:
                return
            payload = self._ring.payload(head, blob)
        if payload is None:
            payload = b"".join((head, blob)) if blob else head
        self._publisher.put(payload, attachment=attachment)
        if self._ring is not None:
            # Whoever sends clouds often works on the next one at once, and Zenoh's sending thread would wait meanwhile.
            os.sched_yield()

    def has_readers(self) -> bool:
        return self._is_read

    def close(self) -> None:
        self._listener.undeclare()
        self._publisher.undeclare()
        if self._matching is not self._publisher:
            self._matching.undeclare()
        if self._ring is not None:
            self._ring.close()


class _ZenohRequest:
    def __init__(self, query: zenoh.Query, served: str) -> None:
        self._query = query
        payload = query.payload
        self.payload = payload.to_bytes() if payload is not None else b""
        self.key = str(query.key_expr)
        # A reply needs a key without wildcards: the one that was asked, or the one that is served.
        self._reply_key = self.key if "*" not in self.key else served.replace("*", "_")

    def reply(self, payload: bytes) -> None:
        self._query.reply(self._reply_key, payload, express=True)  # with the priority of the request

    def refuse(self, words: str) -> None:
        self._query.reply_err(_REFUSED + words.encode())
        self.close()

    def close(self) -> None:
        self._query.drop()


class _ZenohReplies:
    def __init__(self, session: zenoh.Session, key: str, payload: bytes, timeout: float, *, everyone: bool) -> None:
        self._queue: queue.SimpleQueue[bytes | Exception | None] = queue.SimpleQueue()
        self._cancel = zenoh.CancellationToken()
        session.get(
            key,
            handlers.Callback(self._arrived, self._ended, indirect=False),
            payload=payload,
            timeout=timeout,
            target=zenoh.QueryTarget.ALL if everyone else zenoh.QueryTarget.BEST_MATCHING,
            consolidation=zenoh.ConsolidationMode.NONE,
            priority=zenoh.Priority.REAL_TIME,
            express=True,
            cancellation_token=self._cancel,
        )

    def _arrived(self, reply: zenoh.Reply) -> None:
        if reply.ok is not None:
            self._queue.put(reply.ok.payload.to_bytes())
        elif reply.err is not None:
            # Other error replies are Zenoh's own word for a timeout; the caller has its own clock.
            words = reply.err.payload.to_bytes()
            if words.startswith(_REFUSED):
                self._queue.put(RequestRefused(words.removeprefix(_REFUSED).decode("utf-8", "replace")))

    def _ended(self) -> None:
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
        self._cancel.cancel()
