"""The clouds of a recording as a camera's: one key, at their average rate, with calibration and place."""

from __future__ import annotations

import logging
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

from zsight.convert import points_of
from zsight.errors import UsageError
from zsight.recording.opening import open_recording
from zsight_core.errors import FileError
from zsight_protocol.camera_info import CameraInfo
from zsight_protocol.errors import ProtocolError
from zsight_protocol.geometry import TransformList
from zsight_protocol.point_cloud import PointCloud2

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from zsight.recording.played import Line, Played, Recorded
    from zsight_core.points import Points

log = logging.getLogger(__name__)

__all__ = ["RecordedClouds"]

_RATES = (0.1, 100.0)  # clouds a second; a recording with one cloud, or odd times, says nothing of use


@dataclass(frozen=True)
class RecordedClouds:
    """What a camera service needs of a recording."""

    path: Path
    frame_id: str
    rate: float
    transforms: TransformList | None
    camera_info: CameraInfo | None
    _recording: Recorded
    _line: Line

    @classmethod
    def open(cls, path: Path, key: str = "") -> RecordedClouds:
        """Open the clouds on a key (without namespace), or, if none is given, on the one with the most.

        Raises:
            UsageError: the recording cannot be read or has no such clouds.
        """
        recording = open_recording(path, partial(log.warning, "%s: %s; the clouds in it are left out"))
        lines = [line for line in recording.lines if line.kind is PointCloud2 and line.count]
        wanted = [line for line in lines if line.key == key] if key else lines
        if not wanted:
            known = ", ".join(sorted({line.key for line in lines})) or "none"
            raise UsageError(f"{path} has no clouds{f' on {key}' if key else ''}; keys with clouds: {known}")
        line = max(wanted, key=lambda candidate: (candidate.key.endswith("/points"), candidate.count))
        span = (recording.end_ns - recording.start_ns) / 1e9
        rate = min(max((line.count - 1) / span, _RATES[0]), _RATES[1]) if span > 0 and line.count > 1 else 1.0
        camera = line.key.partition("/")[0]
        frame = _frame(recording, line)
        return cls(path, frame, rate, _transforms(recording), _info(recording, camera), recording, line)

    def clouds(self) -> Iterator[Points]:
        """The clouds in their order; raises FileError in the place of one that is damaged, and goes on behind it."""
        return _Clouds(self.path, iter(self._recording.messages(self._recording.start_ns, None, [self._line])))


class _Clouds:
    """An iterator that goes on behind an error, which a generator does not."""

    def __init__(self, path: Path, messages: Iterator[Played]) -> None:
        self._path = path
        self._messages = messages

    def __iter__(self) -> Iterator[Points]:
        return self

    def __next__(self) -> Points:
        played = next(self._messages)
        try:
            cloud = played.load()
        except ProtocolError as error:
            raise FileError(self._path, f"a cloud on {played.line.source}: {error}") from None
        if not isinstance(cloud, PointCloud2):
            raise FileError(self._path, f"a message on {played.line.source} is no cloud")
        return points_of(cloud)


def _frame(recording: Recorded, line: Line) -> str:
    """The frame of the first cloud that can be read; empty where none can."""
    for played in recording.messages(recording.start_ns, None, [line]):
        with suppress(ProtocolError):
            cloud = played.load()
            return cloud.header.frame_id if isinstance(cloud, PointCloud2) else ""
    return ""


def _transforms(recording: Recorded) -> TransformList | None:
    """All transforms that never change, the last word of each writer."""
    found = [recording.last_before(recording.end_ns + 1, [line]) for line in recording.lines if line.key == "tf_static"]
    lists = [played.load() for played in found if played is not None]
    transforms = tuple(entry for part in lists if isinstance(part, TransformList) for entry in part.transforms)
    return TransformList(transforms=transforms) if transforms else None


def _info(recording: Recorded, camera: str) -> CameraInfo | None:
    lines = [line for line in recording.lines if line.key == f"{camera}/camera_info"]
    found = recording.last_before(recording.end_ns + 1, lines) if lines else None
    info = None if found is None else found.load()
    return info if isinstance(info, CameraInfo) else None
