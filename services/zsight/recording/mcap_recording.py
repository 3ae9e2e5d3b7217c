"""An MCAP file, ours or another's with ROS 2 messages, as the player sees it."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from zsight.errors import UsageError
from zsight.recording.cell_keys import foreign_line
from zsight.recording.foreign_cloud import tidy
from zsight.recording.mcap_file import McapFile
from zsight.recording.played import Line, Played
from zsight.recording.recording_file import ABOUT, IN_FORCE, row_of
from zsight.recording.topic_name import key_of
from zsight_protocol.channels import Delivery
from zsight_protocol.point_cloud import PointCloud2
from zsight_protocol.recording import DepthCodedCloud
from zsight_protocol.ros_cdr import read_cdr
from zsight_protocol.ros_definition import parse_definition, short_name
from zsight_protocol.ros_message import from_values, ros_type

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterator
    from pathlib import Path

    from zsight.recording.mcap_file import Entry
    from zsight.recording.mcap_records import Channel, Schema
    from zsight_protocol.message import Message
    from zsight_protocol.ros_definition import Definitions

__all__ = ["McapRecording"]


class McapRecording:
    """A file that is open for playing."""

    def __init__(self, path: Path, left_out: Callable[[Path, str], object] | None = None) -> None:
        """Open a file.

        Args:
            path: of the file, which may be torn.
            left_out: told of every damaged chunk, which is left out then; without it, it is refused.

        Raises:
            UsageError: it is no MCAP file, or has no messages.
        """
        self.file = McapFile.open(path)
        self.file.left_out = left_out
        self.damage, self.compression = self.file.damage, self.file.compression
        self.skipped: dict[str, int] = {}
        about = next((m.entries for m in self.file.metadata if m.name == ABOUT), {})
        self.namespace = about.get("namespace", "")
        self._definitions: dict[int, Definitions] = {}
        self._line_of: dict[int, Line] = {}
        for channel in self.file.channels.values():
            self._add(channel)
        self.lines = list(self._line_of.values())
        if not self.file.statistics.messages:
            raise UsageError(f"{path} holds no messages")
        self.start_ns, self.end_ns = self.file.statistics.start, self.file.statistics.end

    def _add(self, channel: Channel) -> None:
        count = self.file.statistics.by_channel.get(channel.id, 0)
        schema = self.file.schemas.get(channel.schema_id)
        type_name = "" if schema is None else schema.name
        line = self._own(channel, schema) if self.namespace else self._foreign(channel, schema)
        if line is None:
            if count:
                self.skipped[f"{channel.topic} ({type_name or channel.encoding})"] = count
            return
        self._line_of[channel.id] = line

    def _own(self, channel: Channel, schema: Schema | None) -> Line | None:
        full = channel.metadata.get("key") or key_of(channel.topic)
        inside = full.startswith(f"{self.namespace}/")
        key = full.removeprefix(f"{self.namespace}/") if inside else f"/{full}"
        row = row_of(full, self.namespace)
        kind = None if row is None or schema is None else row.message
        if schema is not None and kind is None:
            return None
        delivery = Delivery.EVERY if row is None else row.delivery
        return self._line(channel, schema, key, kind, delivery)

    def _foreign(self, channel: Channel, schema: Schema | None) -> Line | None:
        if schema is None or schema.encoding != "ros2msg" or channel.encoding != "cdr":
            return None
        line = foreign_line(channel.id, channel.topic, schema.name, 0)
        return None if line is None else self._line(channel, schema, line.key, line.kind, line.delivery)

    def _line(
        self, channel: Channel, schema: Schema | None, key: str, kind: type[Message] | None, delivery: Delivery
    ) -> Line:
        if schema is not None:
            self._definitions[schema.id] = parse_definition(schema.name, schema.data.decode("utf-8", "replace"))
        return Line(
            channel.id,
            key,
            channel.topic,
            kind,
            delivery,
            self.file.statistics.by_channel.get(channel.id, 0),
            "" if schema is None else schema.name,
            IN_FORCE in channel.metadata,
        )

    def messages(self, start: int, end: int | None, lines: Collection[Line]) -> Iterator[Played]:
        """Messages of some lines from start up to and without end, in their order."""
        return map(self._played, self.file.messages(start, end, {line.number for line in lines}))

    def last_before(self, time: int, lines: Collection[Line]) -> Played | None:
        """The last message of some lines before a time."""
        entry = self.file.last_before(time, {line.number for line in lines})
        return None if entry is None else self._played(entry)

    def _played(self, entry: Entry) -> Played:
        line = self._line_of[entry.channel.id]
        return Played(line, entry.log_time, entry.publish_time, entry.sequence, partial(self._load, line, entry))

    def _load(self, line: Line, entry: Entry) -> Message | bytes:
        if line.kind is None:
            return bytes(entry.data)
        schema = self.file.schemas[entry.channel.schema_id]
        if schema.name == ros_type(DepthCodedCloud).name:
            return self._decoded(entry, schema)
        values = read_cdr(short_name(schema.name), entry.data, self._definitions[schema.id])
        return from_values(line.kind, tidy(values) if line.kind is PointCloud2 else values)

    def _decoded(self, entry: Entry, schema: Schema) -> Message:
        from zsight.recording.depth_coder import decoded

        values = read_cdr(short_name(schema.name), entry.data, self._definitions[schema.id])
        return decoded(from_values(DepthCodedCloud, values))

    def close(self) -> None:
        """Close the file."""
        self.file.close()
