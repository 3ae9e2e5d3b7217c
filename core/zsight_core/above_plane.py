"""The points that stand above a surface."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from zsight_core.errors import GeometryError
from zsight_core.filters import finite_mask
from zsight_core.jit import njit
from zsight_core.plane import Plane, frame_on_plane, heights
from zsight_core.points import xyz
from zsight_core.take import take

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from zsight_core.points import Points

__all__ = ["above_mask", "points_above", "warm_up"]


def above_mask(cloud: Points | NDArray[np.floating[Any]], plane: Plane, low: float, high: float) -> NDArray[np.bool_]:
    """Mask (H, W) of the points whose height above the plane, towards the camera, lies in low..high metres.

    Raises:
        GeometryError: low > high.
    """
    if not low <= high:
        raise GeometryError(f"heights are {low} to {high} m; expected the lower one first")
    above = heights(cloud, plane)
    mask: NDArray[np.bool_] = (above >= np.float32(low)) & (above <= np.float32(high))
    return mask


def points_above(
    points: Points,
    plane: Plane,
    low: float,
    high: float,
    surface: NDArray[np.bool_] | None = None,
    out: Points | None = None,
) -> Points:
    """The points that stand low..high metres above the plane: (1, M), all fields kept.

    Args:
        points: (H, W), camera frame, metres.
        plane: facing the camera.
        low: least height; more than the noise of the surface.
        high: greatest height.
        surface: mask (H, W) of the points that make up the surface; given, only points over its convex outline count.
        out: room for the result, contiguous, at least M points; the result is then a view of it.

    Raises:
        GeometryError: low > high; fewer than 3 surface points.
    """
    mask = above_mask(points, plane, low, high)
    if surface is not None:
        mask &= _over(points, plane, surface, mask)
    return take(points, mask, out)


def _over(points: Points, plane: Plane, surface: NDArray[np.bool_], candidates: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Which candidates lie over the convex outline of the surface."""
    T = frame_on_plane(plane, plane.normal * plane.distance)
    coordinates = xyz(points)
    shown = coordinates[surface & finite_mask(points)]
    outline = _outline(shown @ T[:3, :2].astype(np.float32))
    over = np.zeros(candidates.shape, np.bool_)
    over[candidates] = _within(coordinates[candidates] @ T[:3, :2].astype(np.float32), outline)
    return over


def _outline(flat: NDArray[np.float32]) -> NDArray[np.float64]:
    """Convex outline (K, 2), counter-clockwise, of (N, 2) points (Andrew's monotone chain, 1979)."""
    finite = flat[np.isfinite(flat).all(axis=1)].astype(np.float64)
    if len(finite) < 3:
        raise GeometryError(f"the surface has {len(finite)} points; expected at least 3")
    outline: NDArray[np.float64] = _chain(_extremes(finite))
    return outline


@njit(cache=True, nogil=True)
def _extremes(flat: NDArray[np.float64]) -> NDArray[np.float64]:
    """Of many points (N, 2) those that can be on the outline, sorted by x, then y.

    Cut into 1024 columns, only the lowest and highest point of each and the leftmost and rightmost of all can be.
    """
    left, width = flat[:, 0].min(), max(flat[:, 0].max() - flat[:, 0].min(), 1e-12)
    best = np.full((1024, 4), -1)
    for i in range(len(flat)):
        column: int = min(1023, int((flat[i, 0] - left) / width * 1024))
        for side in range(4):
            rival = best[column, side]
            if rival < 0 or flat[i, side // 2] * (1 - side % 2 * 2) < flat[rival, side // 2] * (1 - side % 2 * 2):
                best[column, side] = i
    kept = np.unique(best)
    kept = kept[kept >= 0]
    lower = np.empty((len(kept), 2))
    for k in range(len(kept)):
        lower[k] = flat[kept[k]]
    lower = lower[np.argsort(lower[:, 1], kind="mergesort")]
    return lower[np.argsort(lower[:, 0], kind="mergesort")]


@njit(cache=True, nogil=True)
def _chain(flat: NDArray[np.float64]) -> NDArray[np.float64]:
    """Monotone chain over points (N, 2) sorted by x, then y."""
    count = len(flat)
    hull = np.empty((2 * count, 2))
    used = 0
    for direction in range(2):
        base = used
        for k in range(count):
            point = flat[k] if direction == 0 else flat[count - 1 - k]
            while used - base >= 2:
                a, b = hull[used - 2], hull[used - 1]
                if (b[0] - a[0]) * (point[1] - a[1]) - (b[1] - a[1]) * (point[0] - a[0]) > 0:
                    break
                used -= 1
            hull[used, 0], hull[used, 1] = point[0], point[1]
            used += 1
        used -= 1
    return hull[:used].copy()


@njit(cache=True, nogil=True)
def _within(flat: NDArray[np.float32], outline: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Mask (N,) of the points (N, 2) inside a convex counter-clockwise outline or on it."""
    inside = np.ones(len(flat), np.bool_)
    for i in range(len(flat)):
        for k in range(len(outline)):
            a, b = outline[k], outline[(k + 1) % len(outline)]
            if (b[0] - a[0]) * (flat[i, 1] - a[1]) - (b[1] - a[1]) * (flat[i, 0] - a[0]) < -1e-9:
                inside[i] = False
                break
    return inside


def warm_up() -> None:
    """Compile the kernels of this file."""
    square = np.array([[0, 0], [0, 1], [1, 0], [1, 1]], np.float32)
    _within(square, _outline(square))
