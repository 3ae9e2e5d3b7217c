"""Messages to bytes and back: one self-contained msgpack map a message.

A message with a blob has it under ``data``, as the last entry, behind a padding entry ``_`` that makes the blob start
at a multiple of 16 bytes. So a writer copies the blob once, and a reader makes an aligned array from it with no copy;
any msgpack library decodes the whole.
"""

from __future__ import annotations

import contextlib
import struct
from typing import TYPE_CHECKING, Any, TypeVar, cast

import msgpack
from pydantic import ValidationError

from zsight_protocol.errors import DecodeError, EncodeError, shortened
from zsight_protocol.known_head import KnownHead
from zsight_protocol.recent import Recent

if TYPE_CHECKING:
    from zsight_protocol.message import Message
    from zsight_protocol.point_cloud import Buffer

__all__ = ["ALIGNMENT", "decode", "encode", "encode_parts"]

ALIGNMENT = 16
_HEAD_LIMIT = 64 * 1024  # bytes that the entries before a blob may take
_USUAL_HEAD = 1024  # bytes that they do take
_PACKED = 4096  # bytes that a packer begins with; its own choice, 256 KiB, takes longer to get than a message to pack

M = TypeVar("M", bound="Message")

_written: Recent[tuple[type[Message], int], KnownHead] = Recent()  # by kind and bytes of the blob
_read: Recent[tuple[type[Message], int], KnownHead] = Recent()  # by kind and bytes of the payload


def encode(message: Message) -> bytes:
    """The bytes of a message.

    Raises:
        EncodeError: it holds a number that no message can carry.
    """
    return b"".join(encode_parts(message))


def encode_parts(message: Message) -> tuple[bytes, Buffer]:
    """The bytes of a message in two parts, so that a big blob is copied only once, by the caller.

    Returns:
        Everything before the blob, and the blob (empty for a message that has none).

    Raises:
        EncodeError: the message holds a number that no message can carry.
    """
    blob: Buffer | None = getattr(message, "data", None)
    if blob is None:
        return _packed(msgpack.Packer(buf_size=_PACKED), message, message.model_dump(mode="python")), b""
    known = _written.get((type(message), len(blob)))
    head = known.spelled(message) if known is not None else None
    if head is None:
        head = _head(message, blob)
        if (new := KnownHead.of(head, message)) is not None:
            _written.keep((type(message), len(blob)), new)
    return head, blob


def _head(message: Message, blob: Buffer) -> bytes:
    entries = message.model_dump(mode="python", exclude={"data"})
    packer = msgpack.Packer(buf_size=_PACKED)
    packed = _packed(packer, message, entries)
    head = packer.pack_map_header(len(entries) + 2) + packed[len(packer.pack_map_header(len(entries))) :]
    head += packer.pack("_")
    tail = packer.pack("data") + struct.pack(">BI", 0xC6, len(blob))
    padding = -(len(head) + 2 + len(tail)) % ALIGNMENT
    whole: bytes = head + struct.pack(">BB", 0xC4, padding) + bytes(padding) + tail
    return whole


def _packed(packer: msgpack.Packer, message: Message, entries: dict[str, Any]) -> bytes:
    try:
        packed: bytes = packer.pack(entries)
    except OverflowError:
        raise EncodeError(f"{type(message).__name__} holds a whole number of more than 64 bits") from None
    return packed


def decode(kind: type[M], payload: Buffer) -> M:
    """The message in some bytes; its blob is a view of them, not a copy.

    Raises:
        DecodeError: the bytes are not a message of this kind; says what was wrong. Never allocates more than a small
            multiple of the payload, whatever lengths the bytes declare.
    """
    view = memoryview(payload)
    known = _read.get((kind, len(view)))
    if known is not None and (said := known.said(view)) is not None:
        return cast("M", said)
    try:
        entries = _entries_before_blob(view) if "data" in kind.model_fields else _all_entries(view)
    except DecodeError as error:
        raise DecodeError(f"not a {kind.__name__}: {error}") from None
    except (ValueError, TypeError, OverflowError, RecursionError, msgpack.UnpackException) as error:
        reason = str(error) or type(error).__name__
        raise DecodeError(f"not a {kind.__name__}: {len(view)} bytes that are not one msgpack map ({reason})") from None
    try:
        message = kind.model_validate(entries)
    except ValidationError as error:
        raise DecodeError.from_validation(kind.__name__, error) from None
    if "data" in entries:
        head = bytes(view[: len(view) - len(entries["data"])])
        if (new := KnownHead.of(head, message)) is not None:
            _read.keep((kind, len(view)), new)
    return message


class _Reader:
    """Unpacks item by item, and walks through each one first: only what is really there is ever allocated.

    Without that, lists that declare long lists that declare long lists make gigabytes of a few kilobytes.
    """

    def __init__(self, view: memoryview) -> None:
        self._walker, self._unpacker = (_fed_unpacker(view) for _ in range(2))

    def map_size(self) -> int:
        self._walker.read_map_header()
        size: int = self._unpacker.read_map_header()
        return size

    def item(self) -> Any:
        self._walker.skip()
        return self._unpacker.unpack()

    def tell(self) -> int:
        position: int = self._unpacker.tell()
        return position


def _fed_unpacker(view: memoryview) -> msgpack.Unpacker:
    size = len(view)
    unpacker = msgpack.Unpacker(
        max_buffer_size=max(size, 1),
        max_str_len=size,
        max_bin_len=size,
        max_array_len=size,
        max_map_len=size,
        max_ext_len=0,
    )
    unpacker.feed(view)
    return unpacker


def _all_entries(view: memoryview) -> dict[str, Any]:
    reader = _Reader(view)
    entries = reader.item()
    if not isinstance(entries, dict):
        raise DecodeError(f"the bytes hold a {type(entries).__name__}; expected a map")
    if reader.tell() != len(view):
        raise DecodeError(f"{len(view) - reader.tell()} bytes follow the map; expected none")
    return entries


def _entries_before_blob(view: memoryview) -> dict[str, Any]:
    with contextlib.suppress(msgpack.OutOfData):
        return _entries_within(view, _USUAL_HEAD)
    # Outside the handler: there the first attempt's unpackers, 40 kB each, would still be held.
    return _entries_within(view, _HEAD_LIMIT)


def _entries_within(view: memoryview, limit: int) -> dict[str, Any]:
    reader = _Reader(view[:limit])
    entries: dict[str, Any] = {}
    size = reader.map_size()
    for index in range(size):
        key = reader.item()
        if not isinstance(key, str):
            raise DecodeError(f"a key is a {type(key).__name__}; expected text")
        if key in entries:
            raise DecodeError(f"entry {shortened(key)} stands there twice")
        if key == "data":
            if index != size - 1:
                raise DecodeError(f"data is entry {index + 1} of {size}; expected it to be the last")
            entries["data"] = _blob(view, reader.tell())
        else:
            entries[key] = reader.item()
    entries.pop("_", None)
    return entries


def _blob(view: memoryview, offset: int) -> memoryview:
    """The binary that starts at an offset and must end with the payload."""
    marks = {0xC4: ">B", 0xC5: ">H", 0xC6: ">I"}
    mark = view[offset] if offset < len(view) else None
    if mark not in marks:
        raise DecodeError(f"data starts with byte {mark}; expected a msgpack binary")
    form = marks[mark]
    start = offset + 1 + struct.calcsize(form)
    if start > len(view):
        raise DecodeError("the bytes end inside the length of data")
    (declared,) = struct.unpack(form, view[offset + 1 : start])
    if declared != len(view) - start:
        raise DecodeError(f"data declares {declared} bytes and {len(view) - start} follow")
    return view[start:]
