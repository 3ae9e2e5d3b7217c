"""MCAP files made of others: a part of one, several as one, compressed otherwise, or what is left of a torn one."""

from __future__ import annotations

import heapq
import re
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from zsight.errors import UsageError
from zsight.recording.compression import stored_name
from zsight.recording.mcap_file import McapFile
from zsight.recording.mcap_records import Metadata
from zsight.recording.mcap_writer import McapWriter
from zsight.recording.recording_file import IN_FORCE
from zsight_protocol.channels import Delivery

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from pathlib import Path

    from zsight.recording.mcap_file import Entry
    from zsight.recording.mcap_records import Channel, Schema

__all__ = ["Copied", "Part", "copy"]

_SAY_EVERY = 200  # messages between two words of how far it is


@dataclass(frozen=True)
class Part:
    """What is taken over: log times from start up to and without end (ns), topics that contain and lack a pattern."""

    start: int | None = None
    end: int | None = None
    topics: str = ""
    exclude: str = ""

    def wants(self, channel: Channel) -> bool:
        """Whether messages of a channel are taken over."""
        names = (channel.topic, channel.metadata.get("key", ""))
        return (not self.topics or any(re.search(self.topics, name) for name in names)) and not (
            self.exclude and any(re.search(self.exclude, name) for name in names)
        )


@dataclass
class Copied:
    """What became of it: messages in the new file, and what was wrong with the old ones."""

    messages: int = 0
    damage: list[str] = field(default_factory=list)


def copy(
    sources: Sequence[Path],
    target: Path,
    *,
    part: Part | None = None,
    compression: str | None = None,
    walk: bool = False,
    say: Callable[[float], object] = lambda _: None,
) -> Copied:
    """Write a new file of what is in others, in the order of their log time; what was in force before begins it.

    Args:
        sources: files, whole or torn.
        target: the new file.
        part: what is taken over; everything if not given.
        compression: none, lz4 or zstd; that of the sources if not given.
        walk: through the sources even where they have an index.
        say: told the share of it that is done, 0 to 1.

    Raises:
        UsageError: a source cannot be read or is damaged, nothing is to be taken over, or the target is there already.
    """
    wanted = part or Part()
    if any(source.resolve() == target.resolve() for source in sources):
        raise UsageError(f"{target} is one of the files that are read: choose another name")
    files = [McapFile.open(source, walk=walk) for source in sources]
    copied = Copied(damage=[f"{file.path}: {file.damage}" for file in files if file.damage])
    total = sum(file.statistics.messages for file in files)
    stored = stored_name(compression, next((file.compression for file in files if file.compression), ""))
    writer = _Writer(McapWriter(target, files[0].library), stored)
    try:
        writer.begin(files, wanted)
        streams = [_wanted(file, wanted) for file in files]
        for number, entry in enumerate(heapq.merge(*streams, key=lambda found: found[1].log_time)):
            writer.add(*entry)
            copied.messages += 1
            if number % _SAY_EVERY == 0:
                say(number / max(total, 1))
        if writer.is_empty:
            damage = [file.damage for file in files if file.damage]
            words = "; ".join(damage) or "no message of it is wanted"
            raise UsageError(f"{', '.join(map(str, sources))} holds nothing that can be taken over: {words}")
        writer.finish()
    except BaseException:
        target.unlink(missing_ok=True)
        raise
    finally:
        for file in files:
            file.close()
    say(1.0)
    return copied


def _wanted(file: McapFile, part: Part) -> Iterator[tuple[McapFile, Entry]]:
    channels = {channel.id for channel in file.channels.values() if part.wants(channel)}
    for entry in file.messages(part.start, part.end, channels):
        yield file, entry


class _Writer:
    """Takes messages of several files over; what is the same in two of them is one in the new file."""

    def __init__(self, mcap: McapWriter, compression: str) -> None:
        self._mcap = mcap
        self._compression = compression
        self._channels: dict[tuple[int, int, bool], int] = {}
        self._known: dict[tuple[object, ...], int] = {}

    def begin(self, files: Sequence[McapFile], part: Part) -> None:
        metadata = {(m.name, tuple(m.entries.items())): m for file in files for m in file.metadata}
        for entry in metadata.values():
            self._mcap.add_metadata(Metadata(entry.name, entry.entries))
        for file in files:
            for attachment in file.attachments:
                self._mcap.attach(attachment)
            if part.start is not None:
                self._add_in_force(file, part, part.start)

    def _add_in_force(self, file: McapFile, part: Part, start: int) -> None:
        for channel in file.channels.values():
            is_latched = channel.metadata.get("delivery") == Delivery.LATCHED or channel.topic.endswith("/tf_static")
            entry = file.last_before(start, {channel.id}) if is_latched and part.wants(channel) else None
            if entry is not None:
                number = self._channel(file, channel, in_force=True)
                self._mcap.add(number, start, entry.publish_time, entry.sequence, [entry.data])

    @property
    def is_empty(self) -> bool:
        """Whether no message was taken over, nor one that was in force."""
        return not self._known

    def add(self, file: McapFile, entry: Entry) -> None:
        number = self._channel(file, entry.channel, in_force=False)
        if self._mcap.add(number, entry.log_time, entry.publish_time, entry.sequence, [entry.data]):
            self._mcap.close_chunk(self._compression)

    def _channel(self, file: McapFile, channel: Channel, *, in_force: bool) -> int:
        key = (id(file), channel.id, in_force)
        if key not in self._channels:
            self._channels[key] = self._new_channel(file.schemas.get(channel.schema_id), channel, in_force=in_force)
        return self._channels[key]

    def _new_channel(self, schema: Schema | None, channel: Channel, *, in_force: bool) -> int:
        number = 0 if schema is None else self._mcap.schema(schema.name, schema.encoding, schema.data)
        metadata = {**channel.metadata, **({IN_FORCE: "1"} if in_force else {})}
        known = (number, channel.topic, channel.encoding, tuple(sorted(metadata.items())))
        if known not in self._known:
            self._known[known] = self._mcap.channel(channel.topic, number, channel.encoding, metadata)
        return self._known[known]

    def finish(self) -> None:
        self._mcap.finish(self._compression, whole=True)
