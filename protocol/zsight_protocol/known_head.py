"""Heads of messages that differ in nothing but their stamp.

Thirty times a second a camera says when it was, and of the rest of what comes before the points the same. What was
spelled and checked once need not be spelled and checked again.
"""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING, Any, Self

if TYPE_CHECKING:
    from zsight_protocol.message import Header, Message
    from zsight_protocol.point_cloud import Buffer

__all__ = ["KnownHead"]

_STAMP = struct.Struct(">B20sI9sI")  # the map's size, and the two numbers of the stamp behind their names
_FIRST, _SECOND = b"\xa6header\x82\xa5stamp\x82\xa3sec\xce", b"\xa7nanosec\xce"


class KnownHead:
    """The bytes before a blob, and the message that they say, which is legal."""

    def __init__(self, size: int, rest: bytes, message: Message) -> None:
        """Args: first byte; bytes from behind the stamp to the blob; message, of which the blob is forgotten."""
        self._size = size
        self._rest = rest
        self._message = message.but(data=b"")
        self._header = _header_of(message)
        self._fields = _fields_of(message)
        self._blob_bytes = len(_data_of(message))

    @classmethod
    def of(cls, head: bytes, message: Message) -> Self | None:
        """The head of a message; none where it does not begin with a stamp in numbers of four bytes."""
        if len(head) < _STAMP.size:
            return None
        size, first, _, second, _ = _STAMP.unpack_from(head)
        return cls(size, head[_STAMP.size :], message) if (first, second) == (_FIRST, _SECOND) else None

    def spelled(self, message: Message) -> bytes | None:
        """The head of a message that differs in its stamp and the bytes of its blob alone; none for any other."""
        stamp = _header_of(message).stamp
        as_known = _fields_of(message) == self._fields and len(_data_of(message)) == self._blob_bytes
        if not as_known or not 2**16 <= stamp.sec < 2**32 or stamp.nanosec < 2**16:  # which take four bytes
            return None
        return _STAMP.pack(self._size, _FIRST, stamp.sec, _SECOND, stamp.nanosec) + self._rest

    def said(self, payload: memoryview) -> Message | None:
        """The message in a payload that differs in its stamp and the bytes of its blob alone; none for any other."""
        blob_from = _STAMP.size + len(self._rest)
        if len(payload) != blob_from + self._blob_bytes:
            return None
        size, first, sec, second, nanosec = _STAMP.unpack_from(payload)
        as_known = (size, first, second) == (self._size, _FIRST, _SECOND)
        if not as_known or payload[_STAMP.size : blob_from] != self._rest or sec >= 2**31 or nanosec >= 10**9:
            return None
        header = self._header.but(stamp=self._header.stamp.but(sec=sec, nanosec=nanosec))
        return self._message.but(header=header, data=payload[blob_from:])


def _header_of(message: Message) -> Header:
    header: Header = message.header  # type: ignore[attr-defined]  # every message with a blob has one
    return header


def _data_of(message: Message) -> Buffer:
    data: Buffer = message.data  # type: ignore[attr-defined]
    return data


def _fields_of(message: Message) -> dict[str, Any]:
    """All that a message says but its stamp and its blob."""
    return {**message.__dict__, "header": _header_of(message).frame_id, "data": b""}
