"""Pictures of answers: the cloud with what was found on it, its triad and its label."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from zsight import object_catalogue
from zsight.convert import matrix_of, points_of
from zsight.errors import DeadlinePassed
from zsight.transforms import TransformBuffer
from zsight_core import picture
from zsight_core.transform import inverse
from zsight_protocol.geometry import TransformList
from zsight_protocol.point_cloud import PointCloud2

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from zsight.bus import Bus
    from zsight.object_catalogue import Catalogue
    from zsight_core.points import Points
    from zsight_protocol.find_object import DetectedObject, FindObjectResult

__all__ = ["draw_answer", "draw_live"]

_SOON = 1.0  # seconds to wait for transforms and a cloud


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


def draw_live(bus: Bus, result: FindObjectResult, path: Path, camera: str = "kinect") -> None:
    """Draw an answer over the newest cloud of a running camera.

    Raises:
        DeadlinePassed: no cloud came.
    """
    clouds = bus.reader(bus.cell.points(camera), PointCloud2)
    static = bus.reader(bus.cell.tf_static, TransformList)
    received = clouds.take(_SOON)
    if received is None:
        raise DeadlinePassed(f"no cloud on {clouds.counter.key} within {_SOON:g} s: no picture was drawn")
    buffer = TransformBuffer()
    while (transforms := static.take(0.05)) is not None:
        buffer.put(transforms.message, static=True)
    cloud = received.message
    T_frame_camera = buffer.lookup(result.header.frame_id or cloud.header.frame_id, cloud.header.frame_id)
    types = object_catalogue.load(object_catalogue.shipped_folder())
    draw_answer(path, points_of(cloud), result, types, T_frame_camera)


def _line(found: DetectedObject) -> str:
    place = found.pose.position
    x, y, z = (round(value, 4) + 0.0 for value in (place.x, place.y, place.z))  # + 0.0: zero has no sign
    return f"{found.type}\t({x:.4f}, {y:.4f}, {z:.4f}) m, probability {found.score:.3f}"
