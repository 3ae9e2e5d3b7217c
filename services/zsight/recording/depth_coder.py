"""Clouds as depth images on their way into a recording, and back on their way out."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from zsight.convert import cloud_from_points, points_of
from zsight_core import depth_code, pinhole
from zsight_core.errors import CoreError
from zsight_core.pinhole import Pinhole
from zsight_protocol.camera_info import CameraInfo
from zsight_protocol.errors import DecodeError
from zsight_protocol.point_cloud import PointCloud2
from zsight_protocol.recording import DepthCodedCloud

if TYPE_CHECKING:
    from zsight_core.points import Points
    from zsight_protocol.message import Message

__all__ = ["DepthCoder", "decoded"]


class DepthCoder:
    """Codes clouds that come back within a tenth of a millimetre; all other messages stay as they are.

    The camera behind a key is the one that its calibration tells of, else the one that its first cloud fits.
    """

    def __init__(self) -> None:
        """No camera is known yet."""
        self._cameras: dict[str, Pinhole | None] = {}

    def __call__(self, key: str, message: Message) -> Message:
        """What is written in place of a message."""
        if isinstance(message, CameraInfo):
            self._cameras[key.removesuffix("/camera_info")] = _pinhole(message)
        if not isinstance(message, PointCloud2) or not key.endswith("/points"):
            return message
        camera = key.removesuffix("/points")
        points = points_of(message)
        if camera not in self._cameras:
            self._cameras[camera] = _fitted(points)
        known = self._cameras[camera]
        coded = None if known is None else depth_code.code(points, known)
        if known is None or coded is None:
            return message
        depth, colour, scale = coded
        return DepthCodedCloud(
            header=message.header,
            height=message.height,
            width=message.width,
            fx=known.fx,
            fy=known.fy,
            cx=known.cx,
            cy=known.cy,
            depth_scale=scale,
            has_colour=colour is not None,
            depth=depth.tobytes(),
            colour=b"" if colour is None else colour.tobytes(),
        )


def decoded(coded: DepthCodedCloud) -> PointCloud2:
    """The cloud of a coded one.

    Raises:
        DecodeError: its images have other sizes than it says.
    """
    size, shape = coded.height * coded.width, (coded.height, coded.width)
    if len(coded.depth) != 2 * size or len(coded.colour) != (3 * size if coded.has_colour else 0):
        raise DecodeError(f"a depth-coded cloud of {shape} has {len(coded.depth)} and {len(coded.colour)} bytes")
    depth = np.frombuffer(coded.depth, np.uint16).reshape(shape)
    colour = np.frombuffer(coded.colour, np.uint8).reshape(*shape, 3) if coded.has_colour else None
    camera = Pinhole(coded.width, coded.height, coded.fx, coded.fy, coded.cx, coded.cy)
    points = depth_code.decode(depth, colour, camera, coded.depth_scale)
    return cloud_from_points(points, coded.header.stamp, coded.header.frame_id)


def _pinhole(info: CameraInfo) -> Pinhole | None:
    """The camera of a calibration; none where it is not calibrated, or its lens distorts."""
    if info.k[0] <= 0 or info.k[4] <= 0 or any(info.d) or not info.width or not info.height:
        return None
    return Pinhole(info.width, info.height, info.k[0], info.k[4], info.k[2], info.k[5])


def _fitted(points: Points) -> Pinhole | None:
    try:
        fit = pinhole.fit(points)
    except CoreError:
        return None
    return fit.pinhole if fit.signs == (1, 1, 1) else None
