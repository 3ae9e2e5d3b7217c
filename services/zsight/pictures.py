"""Pictures of answers: the cloud with what was found on it, its triad and its label."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

import numpy as np

from zsight.catalogue import type_files
from zsight.convert import matrix_of, points_of
from zsight.errors import DeadlinePassed
from zsight.transforms import TransformBuffer, TransformUnknown
from zsight_core import picture
from zsight_core.transform import inverse
from zsight_protocol.geometry import TransformList
from zsight_protocol.point_cloud import PointCloud2

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from zsight.bus import Bus, Reader
    from zsight.catalogue.type_files import Catalogue
    from zsight_core.points import Points
    from zsight_protocol.find_object import DetectedObject, FindObjectResult
    from zsight_protocol.message import Header

__all__ = ["draw_answer", "draw_live"]

_SOON = 1.0  # seconds to wait for transforms and a cloud
_STEP = 0.05  # seconds to wait for one more transform


def draw_answer(
    path: Path,
    points: Points,
    result: FindObjectResult,
    catalogue: Catalogue,
    T_frame_camera: NDArray[np.float64],
    *,
    title: str = "",
    lines: tuple[str, ...] = (),
    eye: picture.Eye | None = None,
) -> None:
    """Draw an answer over its cloud into a PNG file.

    Args:
        path: of the file, overwritten.
        points: (H, W) cloud, camera frame.
        result: the answer.
        catalogue: shapes of the types found.
        T_frame_camera: (4, 4) the camera in the frame of the answer.
        title: heading of the legend.
        lines: further lines of the legend.
        eye: where the picture is taken from; left out: the camera.
    """
    T_camera_frame = inverse(T_frame_camera)
    drawings: list[picture.Drawing] = []
    for found in result.objects:
        T_camera_model = T_camera_frame @ matrix_of(found.pose)
        shape = catalogue.outline(found)
        longest = max(found.size)
        if shape is not None:
            drawings.append(picture.Outline(shape, T_camera_model, label=f"{found.type}  {found.score:.2f}"))
        drawings.append(picture.Triad(T_camera_model, length=float(np.clip(0.6 * longest, 0.05, 0.15))))
    words = lines or tuple(_line(found) for found in result.objects) or (result.status.value.replace("_", " "),)
    drawings.append(picture.Legend(words, title=title or None))
    picture.save_png(path, picture.draw(points, drawings, eye))


def draw_live(bus: Bus, result: FindObjectResult, path: Path) -> None:
    """Draw an answer over the newest cloud of the camera that it came from.

    Raises:
        DeadlinePassed: no cloud came.
        TransformUnknown: nobody tells where the camera is in the frame of the answer.
    """
    camera = str(result.report.get("camera") or "kinect")
    clouds = bus.reader(bus.cell.points(camera), PointCloud2)
    frames = [
        (bus.reader(key, TransformList), static) for key, static in ((bus.cell.tf_static, True), (bus.cell.tf, False))
    ]
    received = clouds.take(_SOON)
    if received is None:
        raise DeadlinePassed(f"no cloud on {clouds.counter.key} within {_SOON:g} s: no picture was drawn")
    cloud = received.message
    T_frame_camera = _place_of_camera(frames, result.header.frame_id or cloud.header.frame_id, cloud.header)
    types = type_files.load(type_files.shipped_folder())
    draw_answer(path, points_of(cloud), result, types, T_frame_camera)


def _place_of_camera(
    frames: list[tuple[Reader[TransformList], bool]], frame: str, header: Header
) -> NDArray[np.float64]:
    """Where the camera was when its cloud was measured, as soon as that is known."""
    buffer, deadline = TransformBuffer(), time.monotonic() + _SOON
    while True:
        for reader, static in frames:
            heard = reader.take(_STEP)
            while heard is not None:
                buffer.put(heard.message, static=static)
                heard = reader.take(0)
        try:
            return buffer.lookup(frame, header.frame_id, header.stamp.ns)
        except TransformUnknown:
            if time.monotonic() >= deadline:
                raise


def _line(found: DetectedObject) -> str:
    place = found.pose.position
    x, y, z = (round(value, 4) + 0.0 for value in (place.x, place.y, place.z))  # + 0.0: zero has no sign
    return f"{found.type}\t({x:.4f}, {y:.4f}, {z:.4f}) m, probability {found.score:.3f}"
