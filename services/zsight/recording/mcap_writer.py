"""Writes an MCAP file chunk by chunk: what it says is written survives the end of the process."""

from __future__ import annotations

import contextlib
import errno
import os
import struct
from typing import TYPE_CHECKING

from isal.isal_zlib import crc32

from zsight.errors import UsageError
from zsight.recording.compression import compressed
from zsight.recording.mcap_records import (
    MAGIC,
    MESSAGE,
    Attachment,
    Channel,
    ChunkIndex,
    Metadata,
    Opcode,
    Schema,
    Statistics,
    packed_record,
    packed_text,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from zsight_protocol.point_cloud import Buffer

__all__ = ["McapWriter"]

_CHUNK_BYTES = 4 << 20  # a chunk with this much in it is closed
_APART = 64 << 10  # bytes from which on a part is not copied into its neighbours
_MOST_PARTS = 512  # parts that one call of the system writes; Linux takes up to 1024
_NO_ROOM = (errno.ENOSPC, errno.EDQUOT)
_MOST_CHANNELS = 65000  # the number of a channel has 16 bits


class McapWriter:
    """One file. Not safe between threads.

    A message's bytes are taken in parts and not copied; they must not change until its chunk is closed.
    """

    def __init__(self, path: Path, library: str, *, chunk_bytes: int = _CHUNK_BYTES, crc: bool = True) -> None:
        """Create the file.

        Args:
            path: where it shall be.
            library: what writes it.
            chunk_bytes: a chunk with this much in it is closed.
            crc: whether every chunk gets a checksum.

        Raises:
            UsageError: there is a file already.
            OSError: the system refuses.
        """
        try:
            self._file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o666)
        except FileExistsError:
            raise UsageError(f"{path} is there already: choose another name, or remove it first") from None
        self.path = path
        self.size = 0
        self.statistics = Statistics()
        self._chunk_bytes = chunk_bytes
        self._crc = crc
        self._schemas: dict[tuple[str, str, bytes], Schema] = {}
        self._channels: list[Channel] = []
        self._indexes: list[ChunkIndex] = []
        self._attachments: list[tuple[int, int, Attachment]] = []
        self._metadata: list[tuple[int, int, Metadata]] = []
        self._counts: dict[int, dict[int, int]] = {}  # messages of each channel in the chunk at an offset
        self._chunk = _Chunk()
        try:
            self._append([MAGIC + packed_record(Opcode.HEADER, packed_text("ros2") + packed_text(library))])
        except OSError:
            self.discard()
            raise

    def schema(self, name: str, encoding: str, data: bytes) -> int:
        """Number of a schema, which is written where it is new."""
        key = (name, encoding, data)
        if key not in self._schemas:
            schema = Schema(len(self._schemas) + 1, name, encoding, data)
            self._append([schema.pack()])
            self._schemas[key] = schema
        return self._schemas[key].id

    def channel(self, topic: str, schema_id: int, encoding: str, metadata: dict[str, str]) -> int:
        """Number of a new channel; schema 0 is none."""
        if len(self._channels) >= _MOST_CHANNELS:
            raise UsageError(f"a file holds at most {_MOST_CHANNELS} channels: begin another one")
        channel = Channel(len(self._channels), schema_id, topic, encoding, metadata)
        self._append([channel.pack()])
        self._channels.append(channel)
        return channel.id

    def add(self, channel: int, log_time: int, publish_time: int, sequence: int, parts: Sequence[Buffer]) -> bool:
        """Put a message into the chunk that is open; true where that is full now and should be closed."""
        self._chunk.add(channel, log_time, publish_time, sequence, parts)
        return self._chunk.size >= self._chunk_bytes

    @property
    def open_bytes(self) -> int:
        """Bytes in the chunk that is open."""
        return self._chunk.size

    @property
    def open_messages(self) -> int:
        """Messages in the chunk that is open."""
        return self._chunk.messages

    def close_chunk(self, compression: str = "") -> int:
        """Write what is in the open chunk, if anything; the bytes written.

        Raises:
            OSError: the system refuses; the file ends then with the last whole chunk, and the open one is lost.
        """
        chunk, self._chunk = self._chunk, _Chunk()
        if not chunk.messages:
            return 0
        chunk.finish()
        crc = 0
        if self._crc:
            for part in chunk.parts:
                crc = crc32(part, crc)
        stored = compressed(compression, chunk.parts, chunk.size)
        stored_size = sum(map(len, stored))
        head = struct.pack("<QQQI", chunk.start, chunk.end, chunk.size, crc) + packed_text(compression)
        head += struct.pack("<Q", stored_size)
        offset = self.size
        start = struct.pack("<BQ", Opcode.CHUNK, len(head) + stored_size) + head
        length = len(start) + stored_size
        indexes, places = chunk.index_records(offset + length)
        self._append([start, *stored, indexes])
        self._indexes.append(
            ChunkIndex(
                chunk.start, chunk.end, offset, length, places, len(indexes), compression, stored_size, chunk.size
            )
        )
        self._counts[offset] = {channel: len(times) for channel, times in chunk.index.items()}
        for channel, times in chunk.index.items():
            for time, _ in times:
                self.statistics.count(channel, time)
        return length + len(indexes)

    def attach(self, attachment: Attachment) -> None:
        """Put a file into the file."""
        record = attachment.pack()
        self._attachments.append((self.size, len(record), attachment))
        self._append([record])

    def add_metadata(self, metadata: Metadata) -> None:
        """Put names and values into the file."""
        record = metadata.pack()
        self._metadata.append((self.size, len(record), metadata))
        self._append([record])

    def sync(self) -> None:
        """Wait until all that was written is on the disk; may run on another thread."""
        os.fdatasync(self._file)

    def finish(
        self,
        compression: str = "",
        closing: Callable[[Statistics], Metadata] | None = None,
        *,
        sync: bool = True,
        whole: bool = False,
    ) -> None:
        """Close the chunk and the file, with its summary. Where there is no room for that, the last chunks give way.

        Args:
            compression: of the chunk that is open.
            sync: wait until all of it is on the disk.
            whole: no chunk gives way.
            closing: told what the file holds in the end; its answer is the last thing that the file says.

        Raises:
            OSError: the system refuses even so; the file is closed, and can be recovered.
        """
        try:
            try:
                self.close_chunk(compression)
            except OSError:  # lost: its messages are not counted as written
                if whole:
                    raise
            while True:
                try:
                    self._append([self._end(closing)])
                    break
                except OSError as error:
                    if whole or not self._indexes or error.errno not in _NO_ROOM:
                        raise
                    self._give_up_last_chunk()
            if sync:
                with contextlib.suppress(OSError):
                    self.sync()
        finally:
            os.close(self._file)

    def _end(self, closing: Callable[[Statistics], Metadata] | None) -> bytes:
        """The last metadata and the summary."""
        if closing is None:
            return self._summary(self.size, self._metadata)
        metadata = closing(self.statistics)
        record = metadata.pack()
        listed = [*self._metadata, (self.size, len(record), metadata)]
        return record + self._summary(self.size + len(record), listed)

    def abandon(self) -> None:
        """Close the file as it is, without a summary."""
        os.close(self._file)

    def discard(self) -> None:
        """Close the file, and remove it."""
        self.abandon()
        self.path.unlink(missing_ok=True)

    def _give_up_last_chunk(self) -> None:
        last = self._indexes.pop()
        counts = self.statistics.by_channel
        for channel, messages in self._counts.pop(last.offset, {}).items():
            counts[channel] -= messages
            self.statistics.messages -= messages
        self._attachments = [entry for entry in self._attachments if entry[0] < last.offset]
        self._metadata = [entry for entry in self._metadata if entry[0] < last.offset]
        os.ftruncate(self._file, last.offset)
        os.lseek(self._file, last.offset, os.SEEK_SET)
        self.size = last.offset

    def _append(self, parts: Sequence[Buffer]) -> None:
        """Write parts at the end; if that fails, the file is as it was."""
        before = self.size
        try:
            for start in range(0, len(parts), _MOST_PARTS):
                self._write([memoryview(part) for part in parts[start : start + _MOST_PARTS]])
        except OSError:
            os.ftruncate(self._file, before)
            os.lseek(self._file, before, os.SEEK_SET)
            self.size = before
            raise

    def _write(self, views: list[memoryview]) -> None:
        while views:
            written = os.writev(self._file, views)
            self.size += written
            while views and written >= len(views[0]):
                written -= len(views.pop(0))
            if views and written:
                views[0] = views[0][written:]

    def _summary(self, place: int, metadata: list[tuple[int, int, Metadata]]) -> bytes:
        """Everything from the end of the data on, which is at a place of the file."""
        s = self.statistics
        s.schemas, s.channels, s.chunks = len(self._schemas), len(self._channels), len(self._indexes)
        s.attachments, s.metadata = len(self._attachments), len(metadata)
        groups = [
            (Opcode.SCHEMA, [schema.pack() for schema in self._schemas.values()]),
            (Opcode.CHANNEL, [channel.pack() for channel in self._channels]),
            (Opcode.STATISTICS, [s.pack()]),
            (Opcode.CHUNK_INDEX, [index.pack() for index in self._indexes]),
            (Opcode.ATTACHMENT_INDEX, [_attachment_index(*entry) for entry in self._attachments]),
            (Opcode.METADATA_INDEX, [_metadata_index(*entry) for entry in metadata]),
        ]
        data_end = packed_record(Opcode.DATA_END, struct.pack("<I", 0))
        summary_start = place = place + len(data_end)
        summary, offsets = b"", b""
        for opcode, records in groups:
            body = b"".join(records)
            if body:
                offsets += packed_record(Opcode.SUMMARY_OFFSET, struct.pack("<BQQ", opcode, place, len(body)))
            summary += body
            place += len(body)
        footer = struct.pack("<BQQQ", Opcode.FOOTER, 20, summary_start, place)
        crc = crc32(footer, crc32(offsets, crc32(summary)))
        return data_end + summary + offsets + footer + struct.pack("<I", crc) + MAGIC


def _attachment_index(offset: int, length: int, a: Attachment) -> bytes:
    head = struct.pack("<QQQQQ", offset, length, a.time, a.time, len(a.data))
    return packed_record(Opcode.ATTACHMENT_INDEX, head + packed_text(a.name) + packed_text(a.media_type))


def _metadata_index(offset: int, length: int, metadata: Metadata) -> bytes:
    return packed_record(Opcode.METADATA_INDEX, struct.pack("<QQ", offset, length) + packed_text(metadata.name))


class _Chunk:
    """Messages of one chunk; small parts are joined, big ones kept as they are."""

    def __init__(self) -> None:
        self.parts: list[Buffer] = []
        self.size = 0
        self.messages = 0
        self.start = self.end = 0
        self.index: dict[int, list[tuple[int, int]]] = {}
        self._small = bytearray()

    def add(self, channel: int, log_time: int, publish_time: int, sequence: int, parts: Sequence[Buffer]) -> None:
        length = sum(map(len, parts))
        self.index.setdefault(channel, []).append((log_time, self.size))
        self._small += MESSAGE.pack(Opcode.MESSAGE, length + 22, channel, sequence & 0xFFFFFFFF, log_time, publish_time)
        for part in parts:
            if len(part) < _APART:
                self._small += part
            else:
                self.parts += [self._small, part]
                self._small = bytearray()
        self.size += MESSAGE.size + length
        self.start = min(self.start, log_time) if self.messages else log_time
        self.end = max(self.end, log_time)
        self.messages += 1

    def finish(self) -> None:
        if self._small:
            self.parts.append(self._small)

    def index_records(self, place: int) -> tuple[bytes, dict[int, int]]:
        """The index of every channel, and where each will be if the first is at a place of the file."""
        records, places = b"", {}
        for channel, entries in self.index.items():
            places[channel] = place + len(records)
            body = b"".join(struct.pack("<QQ", *entry) for entry in entries)
            records += packed_record(Opcode.MESSAGE_INDEX, struct.pack("<HI", channel, len(body)) + body)
        return records, places
