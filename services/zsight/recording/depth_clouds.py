"""Recorded depth images, with their colours and calibration, as the clouds that they stand for."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

from zsight.recording.cell_keys import camera_of
from zsight.recording.played import Line, Played
from zsight.recording.ros_image import CompressedImage, Image, colour_pixels, depth_metres
from zsight_protocol.camera_info import CameraInfo
from zsight_protocol.channels import Delivery
from zsight_protocol.errors import DecodeError
from zsight_protocol.point_cloud import PointCloud2

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator

    import numpy as np
    from numpy.typing import NDArray

    from zsight.recording.played import Recorded
    from zsight_protocol.message import Message

__all__ = ["DepthClouds"]

_TOGETHER_NS = 50_000_000  # colour this near a depth image belongs to it


@dataclass(frozen=True)
class _Images:
    """Where one camera's images are."""

    depth: Line
    info: tuple[Line, ...]
    colour: tuple[Line, ...]


class DepthClouds:
    """A recording in which depth images have become clouds; everything else is as it was."""

    def __init__(self, inner: Recorded) -> None:
        """Args: the recording as it is."""
        self._inner = inner
        self.start_ns, self.end_ns = inner.start_ns, inner.end_ns
        self.damage, self.skipped, self.compression = inner.damage, inner.skipped, inner.compression
        self._images: dict[int, _Images] = {}
        images = [line for line in inner.lines if line.kind in (Image, CompressedImage)]
        clouds = [line for line in inner.lines if line.kind is PointCloud2]
        self.lines = [line for line in inner.lines if line not in images]
        for depth in images:
            if "depth" in depth.source and not any(camera_of(c.source) == camera_of(depth.source) for c in clouds):
                self._add(depth, images)
        used = {line for entry in self._images.values() for line in (entry.depth, *entry.colour)}
        for line in images:
            if line not in used and line.count:
                self.skipped[f"{line.source} ({line.type_name})"] = line.count

    def _add(self, depth: Line, images: list[Line]) -> None:
        infos = tuple(line for line in self._inner.lines if line.kind is CameraInfo)
        near = _nearest(depth, infos)
        if not near:
            return
        colour = _nearest(depth, tuple(line for line in images if "depth" not in line.source))
        number = max((line.number for line in self._inner.lines), default=0) + 1 + len(self._images)
        key = f"{camera_of(depth.source)}/points"
        line = Line(number, key, depth.source, PointCloud2, Delivery.LATEST, depth.count, depth.type_name)
        self.lines.append(line)
        self._images[number] = _Images(depth, near, colour)

    def messages(self, start: int, end: int | None, lines: Collection[Line]) -> Iterator[Played]:
        """Messages of some lines from start up to and without end, in their order."""
        made = {self._images[line.number].depth.number: line for line in lines if line.number in self._images}
        inner = [line for line in lines if line.number not in self._images]
        inner += [self._images[line.number].depth for line in made.values()]
        for played in self._inner.messages(start, end, inner):
            line = made.get(played.line.number)
            yield played if line is None else self._made(line, played)

    def last_before(self, time: int, lines: Collection[Line]) -> Played | None:
        """The last message of some lines before a time."""
        made = {self._images[line.number].depth.number: line for line in lines if line.number in self._images}
        inner = [self._images[line.number].depth if line.number in self._images else line for line in lines]
        played = self._inner.last_before(time, inner)
        if played is None or played.line.number not in made:
            return played
        return self._made(made[played.line.number], played)

    def _made(self, line: Line, depth: Played) -> Played:
        return Played(
            line,
            depth.log_time,
            depth.publish_time,
            depth.sequence,
            partial(self._cloud, self._images[line.number], depth),
        )

    def _cloud(self, images: _Images, played: Played) -> Message:
        from zsight.convert import cloud_from_points
        from zsight_core import depth_image
        from zsight_core.errors import CoreError
        from zsight_core.pinhole import Pinhole

        depth = played.load()
        if not isinstance(depth, Image | CompressedImage):
            raise DecodeError("a depth image is no image")
        info_entry = self._inner.last_before(played.log_time + _TOGETHER_NS, images.info)
        info = None if info_entry is None else info_entry.load()
        if not isinstance(info, CameraInfo) or not info.k[0]:
            raise DecodeError(f"no calibration came before the depth image of {played.line.source}")
        pixels, scale = depth_metres(depth)
        height, width = pixels.shape
        colour = self._colour(images, played.log_time)
        if colour is not None and colour.shape[:2] != pixels.shape:
            colour = None
        size = info.width or width, info.height or height  # some calibrations do not say
        try:
            pinhole = Pinhole(*size, info.k[0], info.k[4], info.k[2], info.k[5])
            points = depth_image.to_points(pixels, pinhole, depth_scale=scale, colour=colour)
        except CoreError as error:
            raise DecodeError(str(error)) from None
        return cloud_from_points(points, depth.header.stamp, depth.header.frame_id)

    def _colour(self, images: _Images, time: int) -> NDArray[np.uint8] | None:
        before = self._inner.last_before(time + 1, images.colour)
        after = next(iter(self._inner.messages(time, time + _TOGETHER_NS, images.colour)), None)
        near = [entry for entry in (before, after) if entry is not None]
        if not near:
            return None
        image = min(near, key=lambda entry: abs(entry.log_time - time)).load()
        return colour_pixels(image) if isinstance(image, Image | CompressedImage) else None

    def close(self) -> None:
        """Close the files."""
        self._inner.close()


def _nearest(line: Line, others: tuple[Line, ...]) -> tuple[Line, ...]:
    """Of some topics the one that shares most of its name with a line's; none where no part is shared."""
    parts = line.source.strip("/").split("/")
    shared = [sum(a == b for a, b in zip(parts, other.source.strip("/").split("/"), strict=False)) for other in others]
    best = max(shared, default=0)
    return tuple(other for other, count in zip(others, shared, strict=True) if count == best and best > 0)[:1]
