"""Reads MCAP files by their index, or, where a file is torn or has none, by walking through it."""

from __future__ import annotations

import heapq
import mmap
import struct
from collections import Counter
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Self

from isal.isal_zlib import crc32

from zsight.errors import UsageError
from zsight.recording.compression import decompressed
from zsight.recording.mcap_records import (
    MAGIC,
    MESSAGE,
    Attachment,
    Channel,
    ChunkIndex,
    Fields,
    Metadata,
    Opcode,
    Schema,
    Statistics,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterator
    from pathlib import Path

__all__ = ["Chunk", "Entry", "McapFile"]

_RECORD = struct.Struct("<BQ")
_FOOTER_SIZE = _RECORD.size + 20 + len(MAGIC)


@dataclass(frozen=True)
class Entry:
    """One message as it stands in the file; ``data`` is a view of the file or of its decompressed chunk."""

    channel: Channel
    log_time: int
    publish_time: int
    sequence: int
    data: memoryview = field(repr=False)


@dataclass(frozen=True)
class Chunk:
    """A chunk by its place; ``channels`` are those with messages in it, where the index says.

    A torn chunk ends before its declared length; messages outside of chunks are one chunk without compression.
    """

    start: int
    end: int
    offset: int
    length: int
    compression: str
    channels: frozenset[int] | None = None
    torn: bool = False
    loose: bool = False


@dataclass
class McapFile:
    """An open file; a context manager.

    Attributes:
        damage: what is wrong with the file, in words; empty where it is whole.
        left_out: told the file and what is wrong with a chunk that is left out; without it, such a file is refused.
    """

    path: Path
    profile: str = ""
    library: str = ""
    damage: str = ""
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    chunks: list[Chunk] = field(default_factory=list)
    metadata: list[Metadata] = field(default_factory=list)
    attachments: list[Attachment] = field(default_factory=list)
    statistics: Statistics = field(default_factory=Statistics)
    left_out: Callable[[Path, str], object] | None = None
    _checked: set[int] = field(default_factory=set, repr=False)  # chunks that fit their checksum, by their place
    _view: memoryview = field(default=memoryview(b""), repr=False)
    _map: mmap.mmap | None = field(default=None, repr=False)

    @classmethod
    def open(cls, path: Path, *, walk: bool = False) -> Self:
        """Open a file.

        Args:
            path: of the file.
            walk: through the whole file even where it has an index.

        Raises:
            UsageError: it cannot be read, or is no MCAP file.
        """
        file = cls(path)
        try:
            with path.open("rb") as opened:
                file._map = mmap.mmap(opened.fileno(), 0, access=mmap.ACCESS_READ)
        except (OSError, ValueError) as error:
            raise UsageError(f"{path} cannot be read: {getattr(error, 'strerror', None) or 'it is empty'}") from None
        file._view = memoryview(file._map)
        if bytes(file._view[: len(MAGIC)]) != MAGIC:
            raise UsageError(f"{path} is no MCAP file: it begins with {bytes(file._view[:8])!r}")
        has_index = file._read_summary()
        if walk or not has_index:
            file._walk(has_index=has_index)
        if not has_index and not file.damage:
            file.damage = "its index is missing or damaged"
        return file

    def __enter__(self) -> Self:
        """Itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close."""
        self.close()

    @property
    def compression(self) -> str:
        """Of most of its compressed chunks, as MCAP calls it; empty where there are none."""
        kinds = Counter(chunk.compression for chunk in self.chunks if chunk.compression)
        return max(kinds, key=kinds.__getitem__, default="")

    def close(self) -> None:
        """Close; where messages of it are still in use, their memory stays until they are not."""
        self._view = memoryview(b"")
        self._map = None

    # By the index.

    def _read_summary(self) -> bool:
        """True where the file ends as it should and has an index of all its chunks."""
        size = len(self._view)
        if size < len(MAGIC) + _FOOTER_SIZE or bytes(self._view[-len(MAGIC) :]) != MAGIC:
            return False
        opcode, length = _RECORD.unpack_from(self._view, size - _FOOTER_SIZE)
        if opcode != Opcode.FOOTER or length != 20:
            return False
        start, _, crc = struct.unpack_from("<QQI", self._view, size - _FOOTER_SIZE + _RECORD.size)
        if not len(MAGIC) < start < size:
            return False
        summary = self._view[start : size - len(MAGIC) - 4]
        if crc and crc32(summary) != crc:
            self.damage = "the index does not fit its checksum"
            return False
        try:
            return self._take_summary(start, size - _FOOTER_SIZE)
        except (ValueError, struct.error):
            return False

    def _take_summary(self, start: int, end: int) -> bool:
        self._take_header()
        has_statistics = False
        for opcode, body, _ in self._records(start, end):
            if opcode == Opcode.CHUNK_INDEX:
                c = ChunkIndex.unpack(body)
                if c.offset + c.length > len(self._view):
                    raise ValueError("a chunk lies outside of the file")
                self.chunks.append(
                    Chunk(c.start, c.end, c.offset, c.length, c.compression, frozenset(c.message_indexes) or None)
                )
            elif opcode == Opcode.STATISTICS:
                self.statistics, has_statistics = Statistics.unpack(body), True
            elif opcode in (Opcode.METADATA_INDEX, Opcode.ATTACHMENT_INDEX):
                self._take_at(Fields(body).number("Q"))
            else:
                self._take_small(opcode, body)
        return (
            has_statistics
            and len(self.chunks) == self.statistics.chunks
            and bool(self.chunks or not self.statistics.messages)
        )

    def _take_at(self, offset: int) -> None:
        opcode, length = _RECORD.unpack_from(self._view, offset)
        self._take_small(opcode, self._view[offset + _RECORD.size : offset + _RECORD.size + length])

    def _take_header(self) -> None:
        opcode, length = _RECORD.unpack_from(self._view, len(MAGIC))
        if opcode != Opcode.HEADER:
            raise ValueError("the file does not begin with a header")
        fields = Fields(self._view[len(MAGIC) + _RECORD.size :][:length])
        self.profile, self.library = fields.text(), fields.text()

    def _take_small(self, opcode: int, body: memoryview) -> None:
        if opcode == Opcode.SCHEMA:
            schema = Schema.unpack(body)
            self.schemas[schema.id] = schema
        elif opcode == Opcode.CHANNEL:
            channel = Channel.unpack(body)
            self.channels[channel.id] = channel
        elif opcode == Opcode.METADATA:
            self.metadata.append(Metadata.unpack(body))
        elif opcode == Opcode.ATTACHMENT:
            self.attachments.append(Attachment.unpack(body))

    def _records(self, start: int, end: int) -> Iterator[tuple[int, memoryview, int]]:
        """Opcode, body and place of every whole record; what follows the last one is left."""
        while start + _RECORD.size <= end:
            opcode, length = _RECORD.unpack_from(self._view, start)
            if opcode == 0 or length > end - start - _RECORD.size:
                return
            yield opcode, self._view[start + _RECORD.size : start + _RECORD.size + length], start
            start += _RECORD.size + length

    # By walking.

    def _walk(self, *, has_index: bool) -> None:
        """Find everything record by record; the last chunk may be torn. What is not reached is taken from the index."""
        indexed = self.chunks, self.metadata, self.attachments
        if not has_index:
            self.schemas, self.channels, indexed = {}, {}, ([], [], [])
        self.chunks, self.metadata, self.attachments, self.statistics = [], [], [], Statistics()
        end, finished = len(MAGIC), False
        loose: list[Chunk] = []
        for opcode, body, place in self._records(len(MAGIC), len(self._view)):
            try:
                if opcode == Opcode.HEADER:
                    self._take_header()
                elif opcode == Opcode.CHUNK:
                    self._take_chunk(body, place)
                elif opcode == Opcode.MESSAGE:
                    _, _, time, _ = struct.unpack_from("<HIQQ", body)
                    loose.append(Chunk(time, time, place, _RECORD.size + len(body), "", loose=True))
                elif opcode == Opcode.DATA_END:
                    finished = True
                else:
                    self._take_small(opcode, body)
            except (ValueError, struct.error) as error:
                self.damage = f"the record at byte {place} is damaged: {error}"
            end = place + _RECORD.size + len(body)
        self.chunks += loose
        if not finished and has_index:
            self.damage = f"there is no record at byte {end}"
        elif not finished:
            self._take_torn(end)
        self._take_missed(*indexed)
        self._count()

    def _take_missed(self, chunks: list[Chunk], metadata: list[Metadata], attachments: list[Attachment]) -> None:
        found = {chunk.offset for chunk in self.chunks}
        self.chunks += [chunk for chunk in chunks if chunk.offset not in found]
        self.metadata += [entry for entry in metadata if entry not in self.metadata]
        self.attachments += [entry for entry in attachments if entry not in self.attachments]

    def _take_chunk(self, body: memoryview, place: int, *, torn: bool = False) -> None:
        fields = Fields(body)
        start, end, _, _ = (fields.number(letter) for letter in "QQQI")
        compression = fields.text()
        self.chunks.append(Chunk(start, end, place, _RECORD.size + len(body), compression, torn=torn))

    def _take_torn(self, end: int) -> None:
        """What was being written when the writer ended: whole messages of a chunk that is not compressed."""
        missing = "the file ends without its index: its writer did not close it"
        self.damage = self.damage or missing
        rest = self._view[end:]
        if len(rest) > _RECORD.size and rest[0] == Opcode.CHUNK:
            try:
                self._take_chunk(rest[_RECORD.size :], end, torn=True)
            except ValueError:
                return

    def _count(self) -> None:
        """Statistics by looking into every chunk; a chunk that cannot be read is left out, and is damage."""
        sound: list[Chunk] = []
        for chunk in self.chunks:
            try:
                entries = self.entries(chunk)
            except ValueError as error:
                if chunk.torn:
                    continue
                self.damage = _damaged(chunk, error)
                continue
            for entry in entries:
                self.statistics.count(entry.channel.id, entry.log_time)
            if entries:
                sound.append(chunk)
        self.chunks = sound
        self.statistics.chunks = sum(not chunk.loose for chunk in sound)

    # Messages.

    def entries(self, chunk: Chunk) -> list[Entry]:
        """The messages of a chunk, in the order of the file.

        Raises:
            ValueError: the chunk is damaged.
        """
        if chunk.loose:
            return self._entries(self._view[chunk.offset : chunk.offset + chunk.length])
        fields = Fields(self._view[chunk.offset + _RECORD.size : chunk.offset + chunk.length])
        _, _, size, crc = (fields.number(letter) for letter in "QQQI")
        compression, stored_size = fields.text(), fields.number("Q")
        if chunk.torn:
            rest = fields.take(chunk.length - _RECORD.size - fields.place)
            return self._entries(rest) if compression == "" else []
        stored = fields.take(stored_size)
        is_chunk = _RECORD.unpack_from(self._view, chunk.offset) == (Opcode.CHUNK, chunk.length - _RECORD.size)
        if not is_chunk or fields.place != chunk.length - _RECORD.size:
            raise ValueError("it does not begin as a chunk of its length does")
        data = decompressed(compression, stored, size)
        if len(data) != size:
            raise ValueError(f"{len(data)} bytes came out; expected {size}")
        if crc and chunk.offset not in self._checked:  # once: a seek looks into many chunks for one message of each
            if crc32(data) != crc:
                raise ValueError("its bytes do not fit its checksum")
            self._checked.add(chunk.offset)
        return self._entries(data)

    def _entries(self, data: memoryview) -> list[Entry]:
        found: list[Entry] = []
        place = 0
        while place + _RECORD.size <= len(data):
            opcode, length = _RECORD.unpack_from(data, place)
            end = place + _RECORD.size + length
            if opcode == 0 or end > len(data):
                break
            if opcode == Opcode.MESSAGE and length >= MESSAGE.size - _RECORD.size:
                _, _, channel, sequence, log_time, publish_time = MESSAGE.unpack_from(data, place)
                known = self.channels.get(channel)
                if known is not None:
                    found.append(Entry(known, log_time, publish_time, sequence, data[place + MESSAGE.size : end]))
            else:
                self._take_small(opcode, data[place + _RECORD.size : end])
            place = end
        return found

    def _sound_entries(self, chunk: Chunk) -> list[Entry]:
        """The messages of a chunk; none of a damaged one, where somebody is told of those."""
        try:
            return self.entries(chunk)
        except ValueError as error:
            words = _damaged(chunk, error)
        if self.left_out is None:
            raise UsageError(f"{self.path}: {words}; mend it first with: zsight bag recover {self.path}")
        self.left_out(self.path, words)
        return []

    def messages(
        self, start: int | None = None, end: int | None = None, channels: Collection[int] | None = None
    ) -> Iterator[Entry]:
        """Messages from start up to and without end (log time, ns), in the order of their log time, then of the file.

        Raises:
            UsageError: a chunk is damaged.
        """
        waiting: list[tuple[int, int, int, Entry]] = []
        wanted = [chunk for chunk in self.chunks if self._may_hold(chunk, start, end, channels)]
        for number, chunk in enumerate(sorted(wanted, key=lambda c: (c.start, c.offset))):
            while waiting and waiting[0][0] <= chunk.start:
                yield heapq.heappop(waiting)[3]
            for position, entry in enumerate(self._sound_entries(chunk)):
                if (
                    (channels is None or entry.channel.id in channels)
                    and (start is None or entry.log_time >= start)
                    and (end is None or entry.log_time < end)
                ):
                    heapq.heappush(waiting, (entry.log_time, number, position, entry))
        while waiting:
            yield heapq.heappop(waiting)[3]

    def _may_hold(self, chunk: Chunk, start: int | None, end: int | None, channels: Collection[int] | None) -> bool:
        return (
            (start is None or chunk.end >= start or chunk.torn)
            and (end is None or chunk.start < end)
            and (channels is None or chunk.channels is None or not chunk.channels.isdisjoint(channels))
        )

    def last_before(self, time: int, channels: Collection[int]) -> Entry | None:
        """The last message of some channels before a time (log time, ns).

        Raises:
            UsageError: a chunk is damaged.
        """
        wanted = [c for c in self.chunks if self._may_hold(c, None, time, channels)]
        best: Entry | None = None
        for chunk in sorted(wanted, key=lambda c: -c.end):
            if best is not None and chunk.end < best.log_time:
                break
            for entry in self._sound_entries(chunk):
                if entry.channel.id in channels and entry.log_time < time:
                    best = entry if best is None or entry.log_time >= best.log_time else best
        return best


def _damaged(chunk: Chunk, error: ValueError) -> str:
    return f"the chunk at byte {chunk.offset} is damaged: {error}"
