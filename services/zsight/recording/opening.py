"""Opens a recording of any kind that is known: MCAP, a folder of split MCAP files, ROS 2 bag folders, ROS 1 bags."""

from __future__ import annotations

from typing import TYPE_CHECKING

from zsight.errors import UsageError
from zsight.recording.depth_clouds import DepthClouds
from zsight.recording.mcap_recording import McapRecording
from zsight.recording.series_recording import SeriesRecording
from zsight_core.files.cloud_file import natural_order

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from zsight.recording.played import Recorded

__all__ = ["open_recording"]


def open_recording(path: Path, left_out: Callable[[Path, str], object] | None = None) -> Recorded:
    """The recording at a path.

    Args:
        path: of a file or a folder.
        left_out: told the file and what is wrong with a chunk that is left out; without it, a damaged chunk is refused
            when it is read.

    Raises:
        UsageError: there is none, or it cannot be read.
    """
    if not path.exists():
        raise UsageError(f"there is no recording {path}")
    if path.is_dir() and not (path / "metadata.yaml").is_file():
        files = sorted(path.glob("*.mcap"), key=lambda file: natural_order(file.name))
        if not files:
            raise UsageError(f"folder {path} holds no recording; expected .mcap files, or metadata.yaml of a ROS 2 bag")
        return SeriesRecording([DepthClouds(McapRecording(file, left_out)) for file in files])
    if path.suffix.lower() == ".mcap":
        return DepthClouds(McapRecording(path, left_out))
    if path.is_dir() or path.suffix.lower() == ".bag":
        from zsight.recording.bag_recording import BagRecording

        return DepthClouds(BagRecording(path))
    raise UsageError(f"{path} is no recording; expected a .mcap or .bag file, or a folder")
