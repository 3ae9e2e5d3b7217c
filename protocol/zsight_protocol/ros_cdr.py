"""ROS messages as bytes: CDR (OMG DDS-XTypes, plain CDR version 1), as every ROS 2 reader has it."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING, Any

from zsight_protocol.errors import DecodeError, EncodeError
from zsight_protocol.ros_definition import PRIMITIVES, STRINGS

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from zsight_protocol.point_cloud import Buffer
    from zsight_protocol.ros_definition import Definitions, RosField

__all__ = ["read_cdr", "write_cdr"]

_LITTLE_ENDIAN = b"\x00\x01\x00\x00"
_BYTES = ("uint8", "byte", "char")
_APART = 4096  # bytes from which on a blob is not copied into its neighbours


def write_cdr(name: str, values: Mapping[str, Any], definitions: Definitions) -> list[Buffer]:
    """The bytes of a message, in parts that follow each other, so that a big blob need not be copied.

    Args:
        name: ``package/Name``.
        values: numbers, text, bytes, mappings and sequences of them by field; what is missing becomes zero or empty.
        definitions: of the message and all that it is made of.

    Raises:
        EncodeError: a value is not what its field holds.
    """
    writer = _Writer(definitions)
    try:
        writer.message(name, values)
    except (struct.error, TypeError, AttributeError, KeyError) as error:
        raise EncodeError(f"a {name} does not fit its definition: {error}") from None
    return writer.parts()


class _Writer:
    def __init__(self, definitions: Definitions) -> None:
        self._definitions = definitions
        self._done: list[Buffer] = [_LITTLE_ENDIAN]
        self._size = 0  # bytes of what is done, without the first four
        self._tail = bytearray()

    def parts(self) -> list[Buffer]:
        return [*self._done, bytes(self._tail)] if self._tail else self._done

    def message(self, name: str, values: Mapping[str, Any]) -> None:
        for field in self._definitions[name]:
            value = values.get(field.name)
            if field.is_sequence or field.length is not None:
                self._many(field, () if value is None else value)
            else:
                self._one(field.type, value)

    def _one(self, kind: str, value: Any) -> None:
        if kind in PRIMITIVES:
            self._numbers(kind, (value or 0,))
        elif kind in STRINGS:
            self._text(value or "")
        else:
            self.message(kind, value or {})

    def _many(self, field: RosField, values: Any) -> None:
        if field.is_sequence:
            if field.bound is not None and len(values) > field.bound:
                raise TypeError(f"{field.name} has {len(values)} entries; expected at most {field.bound}")
            self._numbers("uint32", (len(values),))
        elif len(values) != field.length:
            values = self._filled(field, values)
        if field.type in _BYTES and isinstance(values, bytes | bytearray | memoryview):
            self._blob(values)
        elif field.type in PRIMITIVES:
            self._numbers(field.type, values)
        else:
            for value in values:
                self._one(field.type, value)

    def _filled(self, field: RosField, values: Sequence[Any]) -> Sequence[Any]:
        if len(values):
            raise TypeError(f"{field.name} has {len(values)} entries; expected {field.length}")
        return [None if field.type not in PRIMITIVES else 0] * (field.length or 0)

    def _numbers(self, kind: str, values: Sequence[Any]) -> None:
        if len(values) == 0:
            return
        letter = PRIMITIVES[kind]
        self._tail += bytes(-(self._size + len(self._tail)) % struct.calcsize(letter))
        self._tail += struct.pack(f"<{len(values)}{letter}", *values)

    def _text(self, value: str) -> None:
        encoded = value.encode()
        self._numbers("uint32", (len(encoded) + 1,))
        self._tail += encoded + b"\x00"

    def _blob(self, data: Buffer) -> None:
        if len(data) < _APART:
            self._tail += data
            return
        self._done += [bytes(self._tail), data]
        self._size += len(self._tail) + len(data)
        self._tail = bytearray()


def read_cdr(name: str, payload: Buffer, definitions: Definitions) -> dict[str, Any]:
    """The values of a message by field; its blobs are views of the payload, not copies.

    Raises:
        DecodeError: the bytes are not such a message. Never allocates more than a small multiple of the payload.
    """
    view = memoryview(payload)
    if len(view) < 4 or view[0] != 0 or view[1] > 1:
        raise DecodeError(f"{len(view)} bytes that begin with {bytes(view[:4]).hex()}; expected plain CDR (0001 0000)")
    reader = _Reader(view[4:], "<" if view[1] else ">", definitions)
    try:
        return reader.message(name)
    except (struct.error, UnicodeDecodeError, RecursionError) as error:
        raise DecodeError(f"not a {name}: {error}") from None


class _Reader:
    def __init__(self, view: memoryview, order: str, definitions: Definitions) -> None:
        self._view = view
        self._order = order
        self._definitions = definitions
        self._place = 0

    def message(self, name: str) -> dict[str, Any]:
        if name not in self._definitions:
            raise DecodeError(f"there is no definition of {name}")
        return {field.name: self._field(field) for field in self._definitions[name]}

    def _field(self, field: RosField) -> Any:
        if not field.is_sequence and field.length is None:
            return self._one(field.type)
        count = self._numbers("uint32", 1)[0] if field.is_sequence else field.length or 0
        if field.type in _BYTES:
            return self._take(count)
        if field.type in PRIMITIVES:
            return self._numbers(field.type, count)
        if count > len(self._view) - self._place:
            raise DecodeError(f"{field.name} declares {count} entries in {len(self._view) - self._place} bytes")
        return [self._one(field.type) for _ in range(count)]

    def _one(self, kind: str) -> Any:
        if kind in PRIMITIVES:
            return self._numbers(kind, 1)[0]
        if kind in STRINGS:
            (size,) = self._numbers("uint32", 1)
            return bytes(self._take(size)).removesuffix(b"\x00").decode()
        return self.message(kind)

    def _numbers(self, kind: str, count: int) -> tuple[Any, ...]:
        if count == 0:
            return ()
        letter = PRIMITIVES[kind]
        size = struct.calcsize(letter)
        self._place += -self._place % size
        return struct.unpack(f"{self._order}{count}{letter}", self._take(count * size))

    def _take(self, size: int) -> memoryview:
        if size > len(self._view) - self._place:
            raise DecodeError(f"{size} bytes are declared and {len(self._view) - self._place} follow")
        self._place += size
        return self._view[self._place - size : self._place]
