"""The book's search for a table: the fullest of many thin horizontal slabs, and the plane fitted to one slab."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numba import njit

from zsight_core.errors import GeometryError
from zsight_core.moments import covariance, principal_axes
from zsight_core.plane import Plane, plane_through
from zsight_core.words import words_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from zsight_core.points import Points
    from zsight_core.words import Layout

__all__ = ["SlabFit", "fit_slab", "slab_counts", "table_height", "warm_up"]

Region = tuple[float, float, float, float]
"""x low, x high, y low, y high: metres, world frame."""

EVERYWHERE: Region = (-math.inf, math.inf, -math.inf, math.inf)


@dataclass(frozen=True)
class SlabFit:
    """What the points of a slab look like, in the world frame: metres.

    ``plane`` through them; its normal points up (z >= 0), unlike the camera-facing planes of `zsight_core.plane`.
    ``centroid`` (3,); ``major_axis`` (3,) unit vector along which they spread most, x >= 0; ``count`` of points;
    ``spread`` (3,) standard deviations along the minor, middle and major axis.
    """

    plane: Plane
    centroid: NDArray[np.float64]
    major_axis: NDArray[np.float64]
    spread: NDArray[np.float64]
    count: int


def table_height(
    points: Points,
    T_world_camera: NDArray[np.float64],
    low: float,
    high: float,
    slab: float = 0.005,
    region: Region = EVERYWHERE,
) -> float:
    """Height of the middle of the slab that holds most points, by one pass over the cloud.

    The slabs are those of the book's loop (Newman, chapter 8, find_table_height): from `low` in steps of `slab` while
    the lower edge is below `high`, each with both edges. The lowest of equally full slabs wins.

    Args:
        points: (H, W), camera frame.
        T_world_camera: (4, 4); world z is up.
        low: where the lowest slab begins, metres.
        high: no slab begins at or above it, metres.
        slab: thickness, metres.
        region: only points of this rectangle count.

    Raises:
        GeometryError: limits that leave no slab; no point in any slab.
    """
    edges = _edges(low, high, slab)
    counts = slab_counts(points, T_world_camera, edges, region)
    fullest = int(np.argmax(counts))
    if counts[fullest] == 0:
        raise GeometryError(f"no point lies between {low} m and {high} m; check the camera pose and the limits")
    return float(edges[fullest] + 0.5 * slab)


def slab_counts(
    points: Points,
    T_world_camera: NDArray[np.float64],
    edges: NDArray[np.float64],
    region: Region = EVERYWHERE,
) -> NDArray[np.int64]:
    """How many points lie in each slab edges[k] <= z <= edges[k + 1], both edges included: int64 (len(edges) - 1,).

    Args:
        points: (H, W), camera frame.
        T_world_camera: (4, 4).
        edges: (K + 1,) heights, metres, ascending, evenly spaced up to rounding.
        region: only points of this rectangle count.
    """
    cloud = words_of(points)
    motion = np.asarray(T_world_camera, dtype=np.float64)[:3].astype(np.float32)
    return _slab_counts(cloud.words, cloud.layout, motion, edges.astype(np.float32), np.array(region, dtype=np.float64))


def fit_slab(
    points: Points,
    T_world_camera: NDArray[np.float64],
    low: float,
    high: float,
    region: Region = EVERYWHERE,
) -> SlabFit:
    """Plane, centroid and major axis, in the world frame, of the points between two heights, without a copy of them.

    Args:
        points: (H, W), camera frame.
        T_world_camera: (4, 4); world z is up.
        low: least height, metres.
        high: greatest height, metres.
        region: only points of this rectangle count.

    Raises:
        GeometryError: fewer than 3 points there, or all on one line.
    """
    cloud = words_of(points)
    T = np.asarray(T_world_camera, dtype=np.float64)
    middle = np.array([0.0, 0.0, 0.5 * (low + high)])
    limits = np.array([*region, low, high])
    sums = _slab_moments(cloud.words, cloud.layout, T[:3].astype(np.float32), limits, middle[2])
    if sums[0] < 3:
        raise GeometryError(f"{int(sums[0])} points lie between {low} m and {high} m; expected at least 3")
    mean, spread = covariance(sums)
    variances, axes = principal_axes(spread)
    if variances[1] <= 1e-12 * variances[2]:
        raise GeometryError("all points of the slab lie on one line; a plane needs three that do not")
    normal = axes[:, 0] if axes[2, 0] >= 0 else -axes[:, 0]
    major = axes[:, 2] if axes[0, 2] >= 0 else -axes[:, 2]
    centroid = mean + middle
    plane = plane_through(normal, centroid)
    upright = Plane(normal, float(normal @ centroid)) if plane.normal[2] * normal[2] < 0 else plane
    return SlabFit(upright, centroid, major, np.sqrt(np.maximum(variances, 0.0)), int(sums[0]))


def _edges(low: float, high: float, slab: float) -> NDArray[np.float64]:
    """The edges as the book's loop meets them: by adding up, with the rounding that this brings."""
    if not (math.isfinite(low) and math.isfinite(high) and slab > 0 and low < high and (high - low) / slab < 1e6):
        raise GeometryError(f"slabs of {slab} m from {low} m to {high} m; expected low < high, at most 10^6 slabs")
    edges = [low]
    while edges[-1] < high:
        edges.append(edges[-1] + slab)
    return np.array(edges)


@njit(cache=True, nogil=True)
def _slab_counts(
    words: NDArray[np.float32],
    layout: Layout,
    motion: NDArray[np.float32],
    edges: NDArray[np.float32],
    region: NDArray[np.float64],
) -> NDArray[np.int64]:
    step, at_x, at_y, at_z = layout
    slabs = len(edges) - 1
    counts = np.zeros(slabs, np.int64)
    first, last = edges[0], edges[slabs]
    scale = np.float32(slabs) / (last - first)
    everywhere = region[0] == -np.inf and region[1] == np.inf and region[2] == -np.inf and region[3] == np.inf
    tile = np.empty(256, np.float32)
    for start in range(0, len(words) // step, 256):
        stop = min(len(words) // step, start + 256)
        if step == 4 and at_x == 0 and at_y == 1 and at_z == 2:
            _tile_rows(words[4 * start : 4 * stop], 4, 0, 1, 2, motion[2], tile)
        else:
            _tile_rows(words[step * start : step * stop], step, at_x, at_y, at_z, motion[2], tile)
        for i in range(stop - start):
            z = tile[i]
            if not (z >= first and z <= last):
                continue
            if not everywhere:
                base = step * (start + i)
                x = _row(words, base + at_x, base + at_y, base + at_z, motion[0])
                y = _row(words, base + at_x, base + at_y, base + at_z, motion[1])
                if not (x >= region[0] and x <= region[1] and y >= region[2] and y <= region[3]):
                    continue
            k: int = min(slabs - 1, int((z - first) * scale))
            while z < edges[k]:  # the quotient rounds; the edges decide
                k -= 1
            while k < slabs - 1 and z >= edges[k + 1]:
                k += 1
            counts[k] += 1
            if k > 0 and z == edges[k]:
                counts[k - 1] += 1
    return counts


@njit(cache=True, nogil=True)
def _tile_rows(
    tile: NDArray[np.float32],
    step: int,
    at_x: int,
    at_y: int,
    at_z: int,
    row: NDArray[np.float32],
    out: NDArray[np.float32],
) -> None:
    a, b, c, d = row[0], row[1], row[2], row[3]
    for i in range(len(tile) // step):
        out[i] = a * tile[step * i + at_x] + b * tile[step * i + at_y] + c * tile[step * i + at_z] + d


@njit(cache=True, nogil=True)
def _row(words: NDArray[np.float32], x: int, y: int, z: int, row: NDArray[np.float32]) -> Any:
    return row[0] * words[x] + row[1] * words[y] + row[2] * words[z] + row[3]


@njit(cache=True, nogil=True)
def _slab_moments(
    words: NDArray[np.float32],
    layout: Layout,
    motion: NDArray[np.float32],
    limits: NDArray[np.float64],
    middle: float,
) -> NDArray[np.float64]:
    """(10,) count and first and second moments about (0, 0, middle) of the points within x, y, z limits (6,)."""
    step, at_x, at_y, at_z = layout
    sums = np.zeros(10)
    low, high = np.float32(limits[4]), np.float32(limits[5])
    tile = np.empty(256, np.float32)
    for start in range(0, len(words) // step, 256):
        stop = min(len(words) // step, start + 256)
        if step == 4 and at_x == 0 and at_y == 1 and at_z == 2:
            _tile_rows(words[4 * start : 4 * stop], 4, 0, 1, 2, motion[2], tile)
        else:
            _tile_rows(words[step * start : step * stop], step, at_x, at_y, at_z, motion[2], tile)
        for i in range(stop - start):
            if tile[i] >= low and tile[i] <= high:
                base = step * (start + i)
                x = float(_row(words, base + at_x, base + at_y, base + at_z, motion[0]))
                y = float(_row(words, base + at_x, base + at_y, base + at_z, motion[1]))
                z = tile[i] - middle
                if x >= limits[0] and x <= limits[1] and y >= limits[2] and y <= limits[3]:
                    sums[0] += 1
                    sums[1] += x
                    sums[2] += y
                    sums[3] += z
                    sums[4] += x * x
                    sums[5] += x * y
                    sums[6] += x * z
                    sums[7] += y * y
                    sums[8] += y * z
                    sums[9] += z * z
    return sums


def warm_up() -> None:
    """Compile the kernels of this file."""
    points = words_of(np.array([[0, 0, 1], [1, 0, 1], [0, 1, 1]], np.float32))
    motion = np.eye(3, 4, dtype=np.float32)
    everywhere = np.array(EVERYWHERE)
    _slab_counts(points.words, points.layout, motion, np.array([0.0, 1.0, 2.0], np.float32), everywhere)
    _slab_moments(points.words, points.layout, motion, np.array([*EVERYWHERE, 0.0, 2.0]), 1.0)
