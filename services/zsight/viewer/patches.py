"""The points of clouds that are seen in a part of the picture."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from zsight.convert import cloud_from_points, points_of
from zsight_core.points import xyz
from zsight_core.transform import from_quaternion, inverse, transform_xyz
from zsight_core.visible import Lens, Rectangle, visible

if TYPE_CHECKING:
    import viser
    from numpy.typing import NDArray

    from zsight.viewer.clouds import Shown
    from zsight_protocol.point_cloud import PointCloud2

__all__ = ["Patch", "lens_of", "patches"]


@dataclass(frozen=True, eq=False)
class Patch:
    """The points of one cloud that were seen in a rectangle: (1, M) in the cloud's frame, (M, 3) in the fixed one."""

    shown: Shown
    message: PointCloud2
    xyz_fixed: NDArray[np.floating]


def patches(clouds: list[Shown], lens: Lens, part: Rectangle, disc: float) -> list[Patch]:
    """What is seen of each cloud in a part of the picture; clouds hide each other.

    Args:
        clouds: on the screen; chosen among are all their points, not only those that are drawn.
        lens: the eye, in the fixed frame.
        part: the rectangle.
        disc: diameter that a point is drawn with, metres.
    """
    if not clouds:
        return []
    points = [points_of(shown.cloud) for shown in clouds]
    placed = [
        transform_xyz(shown.T_fixed_cloud, xyz(each).reshape(-1, 3).astype(np.float64))
        for shown, each in zip(clouds, points, strict=True)
    ]
    mask = visible(np.concatenate(placed), lens, part, disc)
    ends = np.cumsum([len(each) for each in placed])[:-1]
    found = []
    for shown, each, moved, chosen in zip(clouds, points, placed, np.split(mask, ends), strict=True):
        if chosen.any():
            header = shown.cloud.header
            patch = cloud_from_points(each[chosen.reshape(each.shape)][np.newaxis], header.stamp, header.frame_id)
            found.append(Patch(shown, patch, moved[chosen]))
    return found


def lens_of(camera: viser.CameraHandle) -> Lens:
    """The eye of a browser, in the fixed frame."""
    w, x, y, z = camera.wxyz
    tangent = float(np.tan(camera.fov / 2))
    return Lens(inverse(from_quaternion(camera.position, (x, y, z, w))), tangent * camera.aspect, tangent)
