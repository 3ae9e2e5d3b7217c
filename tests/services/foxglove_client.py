"""A client of Foxglove's WebSocket protocol, and a reader of protobuf's wire format, written for the tests alone."""

from __future__ import annotations

import json
import struct
import time
from typing import TYPE_CHECKING, Any, Self

from tests.services.waiting import DEADLINE
from websockets.sync.client import connect
from websockets.typing import Subprotocol

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["FoxgloveClient", "number", "parts", "text"]

_LOOK = 0.1  # seconds

Parts = dict[int, list[bytes | int]]


class FoxgloveClient:
    """One connection; channels by topic."""

    def __init__(self, address: str) -> None:
        self._socket = connect(address, subprotocols=[Subprotocol("foxglove.sdk.v1")], max_size=2**26)
        self.channels: dict[str, dict[str, Any]] = {}
        self.server: dict[str, Any] = {}
        self._payloads: dict[int, list[tuple[int, bytes]]] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._socket.close()

    def take(self, topic: str, meanwhile: Callable[[], object] = lambda: None) -> tuple[int, Parts]:
        """The next message of a topic: its time, nanoseconds, and its fields; what is done while none comes."""
        deadline = time.monotonic() + DEADLINE
        while topic not in self.channels:
            self._read(deadline, meanwhile)
        number = self.channels[topic]["id"]
        if number not in self._payloads:
            self._payloads[number] = []
            wanted = [{"id": number, "channelId": number}]
            self._socket.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))
        while not self._payloads[number]:
            self._read(deadline, meanwhile)
        log_time, payload = self._payloads[number].pop(0)
        return log_time, parts(payload)

    def _read(self, deadline: float, meanwhile: Callable[[], object]) -> None:
        try:
            message = self._socket.recv(timeout=_LOOK)
        except TimeoutError:
            assert time.monotonic() < deadline, "nothing came"
            meanwhile()
            return
        if isinstance(message, bytes):
            kind, subscription, log_time = struct.unpack_from("<BIQ", message)
            if kind == 1:
                self._payloads[subscription].append((log_time, message[13:]))
            return
        told = json.loads(message)
        if told["op"] == "serverInfo":
            self.server = told
        if told["op"] == "advertise":
            self.channels |= {channel["topic"]: channel for channel in told["channels"]}


def parts(data: bytes) -> Parts:
    """The fields of a protobuf message by number: varints, 4 and 8 bytes as they are, or bytes of a length."""
    found: Parts = {}
    at = 0
    while at < len(data):
        tag, at = _varint(data, at)
        value: bytes | int
        if tag & 7 == 0:
            value, at = _varint(data, at)
        else:
            size, at = _varint(data, at) if tag & 7 == 2 else ({1: 8, 5: 4}[tag & 7], at)
            value, at = data[at : at + size], at + size
        found.setdefault(tag >> 3, []).append(value)
    return found


def _varint(data: bytes, at: int) -> tuple[int, int]:
    value = shift = 0
    while True:
        value |= (data[at] & 0x7F) << shift
        at, shift = at + 1, shift + 7
        if data[at - 1] < 0x80:
            return value, at


def text(value: bytes | int) -> str:
    assert isinstance(value, bytes)
    return value.decode()


def number(value: bytes | int) -> float:
    """A double."""
    assert isinstance(value, bytes)
    (found,) = struct.unpack("<d", value)
    return float(found)
