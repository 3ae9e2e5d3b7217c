"""The pinhole model of a camera: where a point of its optical frame falls in its image."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from zsight_core.errors import GeometryError, PointsError
from zsight_core.points import is_organised, xyz

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from zsight_core.points import Points

__all__ = ["Distortion", "Pinhole", "PinholeFit", "fit"]

Distortion = tuple[float, float, float, float, float]
"""The plumb-bob model's k1, k2, p1, p2, k3 (Brown 1966), in the order of ROS and OpenCV."""

_FEWEST_POINTS = 8


@dataclass(frozen=True)
class Pinhole:
    """Image size and intrinsics, all in pixels; the centre of the first pixel is (0, 0)."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: Distortion | None = None

    def __post_init__(self) -> None:
        if self.width < 1 or self.height < 1:
            raise GeometryError(f"pinhole has {self.width} x {self.height} pixels; expected at least one")
        numbers = (self.fx, self.fy, self.cx, self.cy, *(self.distortion or ()))
        if not all(math.isfinite(number) for number in numbers) or self.fx <= 0 or self.fy <= 0:
            raise GeometryError(f"pinhole has fx {self.fx}, fy {self.fy}, cx {self.cx}, cy {self.cy}, distortion "
                                f"{self.distortion}; expected finite numbers and focal lengths above zero")  # fmt: skip

    def project(self, coordinates: NDArray[np.floating]) -> NDArray[np.float64]:
        """Pixels (..., 2), u right and v down, of points (..., 3) in the optical frame, metres; NaN behind it."""
        z = np.where(coordinates[..., 2] > 0, coordinates[..., 2], np.nan).astype(np.float64)
        with np.errstate(over="ignore", invalid="ignore"):
            x, y = _distort(coordinates[..., 0] / z, coordinates[..., 1] / z, self.distortion)
            return np.stack([self.fx * x + self.cx, self.fy * y + self.cy], axis=-1)

    def rays(self) -> NDArray[np.float64]:
        """Where each pixel looks: x / z and y / z in the optical frame, read-only (H, W, 2).

        NaN where the distortion cannot be undone, which happens in the corners of strongly distorted images.
        """
        return _rays(self)


@dataclass(frozen=True)
class PinholeFit:
    """The pinhole that fits an organised cloud best, and how well.

    ``signs`` are +1 or -1: x, y, z times these lie in the camera's optical frame (z forward, x right, y down); many
    are all +1, a cloud with y up and z backward has (1, -1, -1). ``residual`` is the root of the mean squared distance,
    pixels, between where the model puts a point and the pixel that it has in the cloud.
    """

    pinhole: Pinhole
    signs: tuple[int, int, int]
    residual: float

    def holds(self, limit: float = 1.0) -> bool:
        """True where the residual is below a limit, pixels: the cloud is a pinhole's and has not been moved."""
        return self.residual < limit


def fit(points: Points) -> PinholeFit:
    """Find the intrinsics behind an organised cloud, by least squares over u = fx x / z + cx and v = fy y / z + cy.

    A cloud that is no pinhole's in its own optical frame (moved to another frame, rows and columns swapped, sorted)
    gets an answer, too: one with a large residual.

    Args:
        points: (H, W), organised, x y z in metres; holes are left out.

    Raises:
        PointsError: the cloud is not organised or has no x, y, z.
        GeometryError: too few finite points, or all in one row or column of the image.
    """
    if not is_organised(points):
        raise PointsError(f"cloud has shape {points.shape}; expected an organised one, as a depth camera makes it")
    coordinates = xyz(points)
    finite = np.isfinite(coordinates).all(axis=-1) & (coordinates[..., 2] != 0)
    v, u = np.nonzero(finite)
    if len(u) < _FEWEST_POINTS:
        raise GeometryError(f"cloud has {len(u)} finite points; a pinhole fit takes at least {_FEWEST_POINTS}")
    x, y, z = (coordinates[finite][:, axis].astype(np.float64) for axis in range(3))
    slope_u, cx, error_u = _line(x / z, u)
    slope_v, cy, error_v = _line(y / z, v)
    forward = 1 if np.median(z) > 0 else -1
    signs = (_sign(slope_u) * forward, _sign(slope_v) * forward, forward)
    height, width = points.shape
    pinhole = Pinhole(width, height, abs(slope_u), abs(slope_v), cx, cy)
    return PinholeFit(pinhole, signs, math.sqrt(error_u + error_v))


def _line(ratio: NDArray[np.float64], pixel: NDArray[np.intp]) -> tuple[float, float, float]:
    """Slope, intercept and mean squared error of pixel = slope * ratio + intercept."""
    centre, middle = ratio.mean(), pixel.mean()
    spread = np.mean((ratio - centre) ** 2)
    slope = np.mean((ratio - centre) * (pixel - middle)) / spread if spread > 0 else 0.0
    if not (np.isfinite(slope) and slope != 0):
        raise GeometryError(
            "the cloud's points lie in one row or column, or do not spread; no pinhole follows from that"
        )
    error = np.mean((slope * (ratio - centre) - (pixel - middle)) ** 2)
    return float(slope), float(middle - slope * centre), float(error)


def _sign(number: float) -> int:
    return 1 if number > 0 else -1


@lru_cache(maxsize=4)
def _rays(pinhole: Pinhole) -> NDArray[np.float64]:
    u, v = np.meshgrid(np.arange(pinhole.width, dtype=np.float64), np.arange(pinhole.height, dtype=np.float64))
    x, y = (u - pinhole.cx) / pinhole.fx, (v - pinhole.cy) / pinhole.fy
    rays = np.stack(_undistort(x, y, pinhole.distortion), axis=-1)
    rays.flags.writeable = False
    return rays


def _distort(
    x: NDArray[np.float64], y: NDArray[np.float64], distortion: Distortion | None
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Ideal x / z, y / z to those that the lens shows: radial and tangential terms."""
    if distortion is None:
        return x, y
    k1, k2, p1, p2, k3 = distortion
    square = x * x + y * y
    radial = 1 + square * (k1 + square * (k2 + square * k3))
    return (
        x * radial + 2 * p1 * x * y + p2 * (square + 2 * x * x),
        y * radial + p1 * (square + 2 * y * y) + 2 * p2 * x * y,
    )


def _undistort(
    seen_x: NDArray[np.float64], seen_y: NDArray[np.float64], distortion: Distortion | None
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The inverse of `_distort`: what it adds is taken away again, with the result put in, until nothing changes."""
    if distortion is None:
        return seen_x, seen_y
    x, y = seen_x, seen_y
    with np.errstate(over="ignore", invalid="ignore"):
        for _ in range(100):
            shown_x, shown_y = _distort(x, y, distortion)
            off_x, off_y = seen_x - shown_x, seen_y - shown_y
            x, y = x + off_x, y + off_y
            if np.nanmax(np.hypot(off_x, off_y), initial=0) < 1e-12:
                break
        lost = ~(np.hypot(off_x, off_y) < 1e-6)
    return np.where(lost, np.nan, x), np.where(lost, np.nan, y)
