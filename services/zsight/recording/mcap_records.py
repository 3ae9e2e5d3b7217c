"""The records of an MCAP file that are small: written and read side by side, in the order of the specification.

Chunks and the messages in them are written by McapWriter and read by McapFile, which copy no blob.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from enum import IntEnum
from typing import TYPE_CHECKING, Self, TypeVar

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = [
    "MAGIC",
    "MESSAGE",
    "Attachment",
    "Channel",
    "ChunkIndex",
    "Fields",
    "Metadata",
    "Opcode",
    "Schema",
    "Statistics",
    "packed_record",
    "packed_text",
]

K = TypeVar("K")
V = TypeVar("V")

MAGIC = b"\x89MCAP0\r\n"
MESSAGE = struct.Struct("<BQHIQQ")
"""Opcode, length, channel, sequence, log time and publish time in front of a message's bytes."""


class Opcode(IntEnum):
    """What a record is."""

    HEADER = 0x01
    FOOTER = 0x02
    SCHEMA = 0x03
    CHANNEL = 0x04
    MESSAGE = 0x05
    CHUNK = 0x06
    MESSAGE_INDEX = 0x07
    CHUNK_INDEX = 0x08
    ATTACHMENT = 0x09
    ATTACHMENT_INDEX = 0x0A
    STATISTICS = 0x0B
    METADATA = 0x0C
    METADATA_INDEX = 0x0D
    SUMMARY_OFFSET = 0x0E
    DATA_END = 0x0F


def packed_record(opcode: Opcode, body: bytes) -> bytes:
    """A whole record."""
    return struct.pack("<BQ", opcode, len(body)) + body


def packed_text(text: str) -> bytes:
    """Text behind its length."""
    encoded = text.encode()
    return struct.pack("<I", len(encoded)) + encoded


def _packed_map(entries: dict[str, str]) -> bytes:
    body = b"".join(packed_text(key) + packed_text(value) for key, value in entries.items())
    return struct.pack("<I", len(body)) + body


class Fields:
    """Takes the fields of a record, one after the other.

    A field that goes over the end raises ValueError, and never reads what is not there.
    """

    def __init__(self, view: memoryview) -> None:
        """Args: the record's body."""
        self._view = view
        self.place = 0

    def number(self, letter: str) -> int:
        """A whole number by its letter of the struct module."""
        (value,) = struct.unpack("<" + letter, self.take(struct.calcsize("<" + letter)))
        return int(value)

    def take(self, size: int) -> memoryview:
        """So many bytes."""
        if size > len(self._view) - self.place:
            raise ValueError(f"{size} bytes are declared and {len(self._view) - self.place} follow")
        self.place += size
        return self._view[self.place - size : self.place]

    def text(self) -> str:
        """Text behind its length."""
        return str(self.take(self.number("I")), "utf-8")

    def map(self) -> dict[str, str]:
        """Pairs of text."""
        inner = Fields(self.take(self.number("I")))
        return inner.pairs(inner.text, inner.text)

    def pairs(self, key: Callable[[], K], value: Callable[[], V]) -> dict[K, V]:
        """Pairs until the end."""
        found: dict[K, V] = {}
        while self.place < len(self._view):
            name = key()
            found[name] = value()
        return found


@dataclass(frozen=True)
class Schema:
    """How messages of a type are defined."""

    id: int
    name: str
    encoding: str
    data: bytes

    def pack(self) -> bytes:
        """The record."""
        head = struct.pack("<H", self.id) + packed_text(self.name) + packed_text(self.encoding)
        return packed_record(Opcode.SCHEMA, head + struct.pack("<I", len(self.data)) + self.data)

    @classmethod
    def unpack(cls, view: memoryview) -> Self:
        """From a record's body."""
        fields = Fields(view)
        return cls(fields.number("H"), fields.text(), fields.text(), bytes(fields.take(fields.number("I"))))


@dataclass(frozen=True)
class Channel:
    """A topic as one writer wrote it."""

    id: int
    schema_id: int
    topic: str
    encoding: str
    metadata: dict[str, str]

    def pack(self) -> bytes:
        """The record."""
        head = struct.pack("<HH", self.id, self.schema_id) + packed_text(self.topic) + packed_text(self.encoding)
        return packed_record(Opcode.CHANNEL, head + _packed_map(self.metadata))

    @classmethod
    def unpack(cls, view: memoryview) -> Self:
        """From a record's body."""
        fields = Fields(view)
        return cls(fields.number("H"), fields.number("H"), fields.text(), fields.text(), fields.map())


@dataclass(frozen=True)
class ChunkIndex:
    """Where a chunk is and what is in it; ``message_indexes`` says where each channel's index is."""

    start: int
    end: int
    offset: int
    length: int
    message_indexes: dict[int, int]
    index_length: int
    compression: str
    compressed_size: int
    uncompressed_size: int

    def pack(self) -> bytes:
        """The record."""
        head = struct.pack("<QQQQI", self.start, self.end, self.offset, self.length, 10 * len(self.message_indexes))
        places = b"".join(struct.pack("<HQ", *entry) for entry in self.message_indexes.items())
        tail = struct.pack("<Q", self.index_length) + packed_text(self.compression)
        sizes = struct.pack("<QQ", self.compressed_size, self.uncompressed_size)
        return packed_record(Opcode.CHUNK_INDEX, head + places + tail + sizes)

    @classmethod
    def unpack(cls, view: memoryview) -> Self:
        """From a record's body."""
        fields = Fields(view)
        start, end, offset, length = (fields.number("Q") for _ in range(4))
        inner = Fields(fields.take(fields.number("I")))
        places = inner.pairs(lambda: inner.number("H"), lambda: inner.number("Q"))
        index_length, compression = fields.number("Q"), fields.text()
        return cls(
            start, end, offset, length, places, index_length, compression, fields.number("Q"), fields.number("Q")
        )


@dataclass(frozen=True)
class Metadata:
    """Names and values that belong to no message."""

    name: str
    entries: dict[str, str]

    def pack(self) -> bytes:
        """The record."""
        return packed_record(Opcode.METADATA, packed_text(self.name) + _packed_map(self.entries))

    @classmethod
    def unpack(cls, view: memoryview) -> Self:
        """From a record's body."""
        fields = Fields(view)
        return cls(fields.text(), fields.map())


@dataclass(frozen=True)
class Attachment:
    """A file inside the file."""

    name: str
    media_type: str
    data: bytes = field(repr=False)
    time: int = 0

    def pack(self) -> bytes:
        """The record; without a checksum, which is zero then."""
        head = struct.pack("<QQ", self.time, self.time) + packed_text(self.name) + packed_text(self.media_type)
        return packed_record(Opcode.ATTACHMENT, head + struct.pack("<Q", len(self.data)) + self.data + bytes(4))

    @classmethod
    def unpack(cls, view: memoryview) -> Self:
        """From a record's body."""
        fields = Fields(view)
        time, _ = fields.number("Q"), fields.number("Q")
        return cls(fields.text(), fields.text(), bytes(fields.take(fields.number("Q"))), time)


@dataclass
class Statistics:
    """How much there is of everything."""

    messages: int = 0
    schemas: int = 0
    channels: int = 0
    attachments: int = 0
    metadata: int = 0
    chunks: int = 0
    start: int = 0
    end: int = 0
    by_channel: dict[int, int] = field(default_factory=dict)

    def count(self, channel: int, log_time: int) -> None:
        """One more message."""
        self.start = min(self.start, log_time) if self.messages else log_time
        self.end = max(self.end, log_time)
        self.messages += 1
        self.by_channel[channel] = self.by_channel.get(channel, 0) + 1

    def pack(self) -> bytes:
        """The record."""
        head = struct.pack(
            "<QHIIIIQQI", self.messages, self.schemas, self.channels, self.attachments, self.metadata, self.chunks,
            self.start, self.end, 10 * len(self.by_channel),
        )  # fmt: skip
        return packed_record(
            Opcode.STATISTICS, head + b"".join(struct.pack("<HQ", *entry) for entry in self.by_channel.items())
        )

    @classmethod
    def unpack(cls, view: memoryview) -> Self:
        """From a record's body."""
        fields = Fields(view)
        messages, schemas = fields.number("Q"), fields.number("H")
        channels, attachments, metadata, chunks = (fields.number("I") for _ in range(4))
        start, end = fields.number("Q"), fields.number("Q")
        inner = Fields(fields.take(fields.number("I")))
        by_channel = inner.pairs(lambda: inner.number("H"), lambda: inner.number("Q"))
        return cls(messages, schemas, channels, attachments, metadata, chunks, start, end, by_channel)
