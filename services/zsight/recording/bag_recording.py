"""A ROS 1 bag or the folder of a ROS 2 bag as the player sees it, read with rosbags."""

from __future__ import annotations

import dataclasses
import weakref
from functools import cache, partial
from typing import TYPE_CHECKING, Any

import numpy as np

from zsight.errors import UsageError
from zsight.recording.cell_keys import foreign_line
from zsight.recording.foreign_cloud import tidy
from zsight.recording.played import Line, Played
from zsight_protocol.errors import DecodeError
from zsight_protocol.point_cloud import PointCloud2
from zsight_protocol.ros_message import from_values

if TYPE_CHECKING:
    from collections.abc import Collection, Hashable, Iterator
    from pathlib import Path

    from rosbags.interfaces import Connection

    from zsight_protocol.message import Message

__all__ = ["BagRecording"]

_STEP_NS = 1_000_000_000  # how far back the last message before a time is looked for at first


class BagRecording:
    """A bag that is open for playing."""

    def __init__(self, path: Path) -> None:
        """Args: path of a .bag file, or of the folder of a ROS 2 bag.

        Raises:
            UsageError: it cannot be read.
        """
        from rosbags.highlevel import AnyReader, AnyReaderError
        from rosbags.typesys import Stores, get_typestore

        try:
            self._reader = AnyReader([path], default_typestore=get_typestore(Stores.ROS2_JAZZY))
            self._reader.open()
        except (AnyReaderError, OSError, ValueError, KeyError) as error:
            raise UsageError(f"{path} cannot be read as a bag: {error}") from None
        # A camera that plays a bag has no moment at which it would close it.
        self._closing = weakref.finalize(self, self._reader.close)
        self._path = path
        self.damage = self.compression = ""
        self.skipped: dict[str, int] = {}
        self.start_ns, self.end_ns = self._reader.start_time, self._reader.end_time
        self._connections: dict[int, Connection] = {}
        self.lines: list[Line] = []
        for number, connection in enumerate(self._reader.connections):
            self._add(number, connection)

    def _add(self, number: int, connection: Connection) -> None:
        line = foreign_line(number, connection.topic, connection.msgtype, connection.msgcount)
        if line is None:
            if connection.msgcount:
                self.skipped[f"{connection.topic} ({connection.msgtype})"] = connection.msgcount
            return
        self.lines.append(line)
        self._connections[number] = connection

    def messages(self, start: int, end: int | None, lines: Collection[Line]) -> Iterator[Played]:
        """Messages of some lines from start up to and without end, in their order.

        Raises:
            UsageError: the bag is damaged.
        """
        wanted = [self._connections[line.number] for line in lines]
        line_of = {_identity(self._connections[line.number]): line for line in lines}
        if not wanted:
            return
        try:
            found = self._reader.messages(wanted, start=start, stop=end)
            for sequence, (connection, time, raw) in enumerate(found):
                line = line_of[_identity(connection)]
                yield Played(line, time, time, sequence, partial(self._load, line, raw, connection.msgtype))
        except Exception as error:  # of the libraries that unpack it, each another
            raise UsageError(f"{self._path} is damaged: {error}") from error

    def last_before(self, time: int, lines: Collection[Line]) -> Played | None:
        """The last message of some lines before a time."""
        back = _STEP_NS
        while True:
            start = max(time - back, self.start_ns)
            last = None
            for last in self.messages(start, time, lines):  # noqa: B007  the last one is wanted
                pass
            if last is not None or start <= self.start_ns:
                return last
            back *= 8

    def _load(self, line: Line, raw: bytes, msgtype: str) -> Message:
        try:
            values = _values(self._reader.deserialize(raw, msgtype))
        except Exception as error:
            raise DecodeError(f"a message on {line.source} cannot be read: {error}") from error
        if line.kind is None:
            raise DecodeError(f"there is no message for {msgtype}")
        return from_values(line.kind, tidy(values) if line.kind is PointCloud2 else values)

    def close(self) -> None:
        """Close the files."""
        self._closing()


def _identity(connection: Connection) -> tuple[int, int]:
    return connection.id, id(connection.owner)


def _values(message: Any) -> dict[str, Any]:
    """A message of rosbags as fields and values."""
    return {name: _value(getattr(message, theirs)) for name, theirs in _names(type(message))}  # type: ignore[arg-type]  # a class is hashable


@cache
def _names(kind: Hashable) -> tuple[tuple[str, str], ...]:
    """The fields of a class, as we write them and as it does: ROS 1 has K, D, R and P of a camera as capitals."""
    names = [field.name for field in dataclasses.fields(kind)]  # type: ignore[arg-type]  # a dataclass
    return tuple((n.lower(), n) for n in names if not n.startswith("_") and not (n.isupper() and len(n) > 1))


def _value(value: Any) -> Any:
    if isinstance(value, str | float | int):
        return value
    if dataclasses.is_dataclass(value):
        return _values(value)
    if isinstance(value, np.ndarray):
        return np.ascontiguousarray(value).data if value.dtype == np.uint8 else value.tolist()
    return [_value(entry) for entry in value] if isinstance(value, list) else value
