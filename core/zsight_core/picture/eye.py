"""Where a picture is taken from."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from zsight_core.errors import CoreError, GeometryError
from zsight_core.pinhole import fit
from zsight_core.points import Points, is_organised
from zsight_core.transform import inverse

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

__all__ = ["Eye", "Projection", "eye_around", "own_eye"]

NEAREST = 1e-3  # metres before the eye; what is nearer is not drawn


@dataclass(frozen=True, eq=False)
class Eye:
    """A pinhole in the frame of the points.

    Attributes:
        T_points_eye: (4, 4) place of the eye; its frame is optical: z forward, x right, y down.
        field_of_view: horizontal, radians.
    """

    T_points_eye: NDArray[np.float64]
    field_of_view: float = 0.8


@dataclass(frozen=True, eq=False)
class Projection:
    """An eye with an image size: from the frame of the points to pixels."""

    T_eye_points: NDArray[np.float64]
    focal: float
    width: int
    height: int

    @classmethod
    def of(cls, eye: Eye, width: int, height: int) -> Projection:
        """The projection into an image of this many pixels."""
        return cls(inverse(eye.T_points_eye), width / 2 / np.tan(eye.field_of_view / 2), width, height)

    def pixels(self, xyz_points: NDArray[np.floating]) -> NDArray[np.float64]:
        """(N, 3): column, row and depth in metres of points (N, 3); NaN for points behind the eye."""
        seen = xyz_points.astype(np.float64) @ self.T_eye_points[:3, :3].T + self.T_eye_points[:3, 3]
        depth = np.where(seen[:, 2] > NEAREST, seen[:, 2], np.nan)
        column = self.focal * seen[:, 0] / depth + (self.width - 1) / 2
        row = self.focal * seen[:, 1] / depth + (self.height - 1) / 2
        return np.stack([column, row, depth], axis=1)


def own_eye(points: Points, size: tuple[int, int] = (1280, 720)) -> Eye:
    """The eye of the camera that took an organised cloud, wide enough to show all of its image.

    Args:
        points: (H, W) in the camera's optical frame; of any other cloud a view along z of half a right angle is taken.
        size: width and height of the picture, pixels.
    """
    field_of_view = np.pi / 4
    if is_organised(points):
        try:
            step = max(min(points.shape) // 100, 1)
            pinhole = fit(points[::step, ::step]).pinhole  # the ratio of width and focal length stays
            tangent = max(pinhole.width / pinhole.fx, pinhole.height / pinhole.fy * size[0] / size[1]) / 2
            field_of_view = 2 * np.arctan(tangent)
        except CoreError:
            pass  # too few points to tell, or no pinhole took them: the default field of view will do
    return Eye(np.eye(4), float(field_of_view))


def eye_around(
    target: ArrayLike,
    up: ArrayLike,
    distance: float,
    azimuth: float = 0.0,
    elevation: float = 0.7,
    field_of_view: float = 0.6,
) -> Eye:
    """An eye that looks at a target from a direction of choice.

    Args:
        target: (3,) in the frame of the points, metres; it comes to the middle of the picture.
        up: (3,) in the frame of the points, such as the normal of a table.
        distance: from the eye to the target, metres.
        azimuth: radians about up; 0 looks the way the sensor (the origin of the frame) does.
        elevation: radians above the plane across up.
        field_of_view: horizontal, radians.

    Raises:
        GeometryError: up is zero.
    """
    aim, upward = np.asarray(target, dtype=np.float64), np.asarray(up, dtype=np.float64)
    length = float(np.linalg.norm(upward))
    if not length > 0:
        raise GeometryError(f"up is {up!r}; expected a direction")
    upward = upward / length
    ahead = _across(aim, upward)
    side = np.cross(ahead, upward)
    ahead = np.cos(azimuth) * ahead + np.sin(azimuth) * side
    forward = np.cos(elevation) * ahead - np.sin(elevation) * upward
    right = np.cross(ahead, upward)
    T = np.eye(4)
    T[:3, 0], T[:3, 1], T[:3, 2] = right, np.cross(forward, right), forward
    T[:3, 3] = aim - distance * forward
    return Eye(T, field_of_view)


def _across(direction: NDArray[np.float64], up: NDArray[np.float64]) -> NDArray[np.float64]:
    """Unit vector across up, along a direction; any one where the direction is that of up."""
    for candidate in (direction, np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0])):
        flat = candidate - (candidate @ up) * up
        length = float(np.linalg.norm(flat))
        if length > 1e-6:
            return np.asarray(flat / length)
    raise GeometryError("up is not finite")
