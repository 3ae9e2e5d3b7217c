"""The book's search for a table: the fullest of many thin horizontal slabs, and the plane fitted to one slab."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from zsight_core.errors import GeometryError
from zsight_core.jit import njit
from zsight_core.moments import add_moments_near_plane, covariance, principal_axes
from zsight_core.plane import Plane, plane_through
from zsight_core.points import XYZ
from zsight_core.tile import TILE, load_tile, new_tile
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
    slabs = len(edges) - 1
    counts = np.zeros((4, slabs + 1), np.int64)  # neighbours mostly fall into one slab: four counters do not wait
    tile = new_tile()
    heights = np.empty(TILE, np.float32)
    slab = np.empty(TILE, np.uint32)
    for start in range(0, len(words) // layout[0], TILE):
        load_tile(words, layout, -1, start, tile)
        _heights(tile, motion, region, heights)
        inside, doubtful = _slabs(heights, edges, slab)
        if inside == 0:
            continue
        if doubtful > 0:
            _settle(heights, edges, slab, counts)
        for i in range(0, TILE, 4):
            counts[0, slab[i]] += 1
            counts[1, slab[i + 1]] += 1
            counts[2, slab[i + 2]] += 1
            counts[3, slab[i + 3]] += 1
    total: NDArray[np.int64] = counts.sum(axis=0)[:slabs]
    return total


@njit(cache=True, nogil=True)
def _heights(
    tile: NDArray[np.float32], motion: NDArray[np.float32], limits: NDArray[np.float64], heights: NDArray[np.float32]
) -> None:
    """World height of each point of a tile, NaN outside the region: x low, x high, y low, y high."""
    a, b, c, d = motion[2, 0], motion[2, 1], motion[2, 2], motion[2, 3]
    for i in range(TILE):
        heights[i] = a * tile[0, i] + b * tile[1, i] + c * tile[2, i] + d
    if limits[0] > -np.inf or limits[1] < np.inf or limits[2] > -np.inf or limits[3] < np.inf:
        for i in range(TILE):
            x = motion[0, 0] * tile[0, i] + motion[0, 1] * tile[1, i] + motion[0, 2] * tile[2, i] + motion[0, 3]
            y = motion[1, 0] * tile[0, i] + motion[1, 1] * tile[1, i] + motion[1, 2] * tile[2, i] + motion[1, 3]
            inside = (x >= limits[0]) & (x <= limits[1]) & (y >= limits[2]) & (y <= limits[3])
            heights[i] = heights[i] if inside else np.float32(np.nan)


@njit(cache=True, nogil=True)
def _slabs(heights: NDArray[np.float32], edges: NDArray[np.float32], slab: NDArray[np.uint32]) -> tuple[int, int]:
    """Number of the slab of each height, the number of slabs for a height in none.

    Returns:
        How many heights lie in a slab; and how many so near an edge that the quotient's rounding may deceive.
    """
    last = len(edges) - 1
    low, high, none = edges[0], edges[last], np.float32(last)
    scale = none / (high - low)
    near = np.float32(1e-6) * none + np.float32(4e-7) * scale * max(abs(low), abs(high))
    inside = doubtful = np.int32(0)
    for i in range(TILE):
        within = (heights[i] >= low) & (heights[i] <= high)
        place = (heights[i] - low) * scale
        floor = np.floor(place)
        doubt = within & ((place - floor < near) | (place - floor > np.float32(1) - near))
        slab[i] = np.int32(floor if within else none)
        inside += np.int32(1) if within else np.int32(0)
        doubtful += np.int32(1) if doubt else np.int32(0)
    return int(inside), int(doubtful)


@njit(cache=True, nogil=True)
def _settle(
    heights: NDArray[np.float32], edges: NDArray[np.float32], slab: NDArray[np.uint32], counts: NDArray[np.int64]
) -> None:
    """Let the edges decide; a height on an edge goes to the slab above and counts in the one below as well."""
    last = len(edges) - 1
    for i in range(TILE):
        if not (heights[i] >= edges[0] and heights[i] <= edges[last]):
            continue
        k = min(int(slab[i]), last - 1)
        while k > 0 and heights[i] < edges[k]:
            k -= 1
        while k < last - 1 and heights[i] >= edges[k + 1]:
            k += 1
        slab[i] = k
        if k > 0 and heights[i] == edges[k]:
            counts[0, k - 1] += 1


@njit(cache=True, nogil=True)
def _slab_moments(
    words: NDArray[np.float32], layout: Layout, motion: NDArray[np.float32], limits: NDArray[np.float64], middle: float
) -> NDArray[np.float64]:
    """(10,) count and first and second moments about (0, 0, middle) of the points within x, y, z limits (6,)."""
    sums = np.zeros(10)
    tile = new_tile()
    world = new_tile()
    region = limits.astype(np.float32)
    slab = np.array([0.0, 0.0, 1.0, middle])
    for start in range(0, len(words) // layout[0], TILE):
        load_tile(words, layout, -1, start, tile)
        if _into_slab(tile, motion, region, world):
            add_moments_near_plane(world, slab, np.inf, sums)
    return sums


@njit(cache=True, nogil=True)
def _into_slab(
    tile: NDArray[np.float32], motion: NDArray[np.float32], limits: NDArray[np.float32], world: NDArray[np.float32]
) -> bool:
    """World coordinates of the points within the limits, holes for the others; False where all are."""
    count = np.int32(0)
    for i in range(TILE):
        x, y, z = tile[0, i], tile[1, i], tile[2, i]
        wx = motion[0, 0] * x + motion[0, 1] * y + motion[0, 2] * z + motion[0, 3]
        wy = motion[1, 0] * x + motion[1, 1] * y + motion[1, 2] * z + motion[1, 3]
        wz = motion[2, 0] * x + motion[2, 1] * y + motion[2, 2] * z + motion[2, 3]
        inside = (wx >= limits[0]) & (wx <= limits[1]) & (wy >= limits[2]) & (wy <= limits[3])
        inside &= (wz >= limits[4]) & (wz <= limits[5])
        world[0, i] = wx if inside else np.float32(np.nan)
        world[1, i] = wy
        world[2, i] = wz
        count += np.int32(1) if inside else np.int32(0)
    return bool(count > 0)


def warm_up() -> None:
    """Compile the kernels of this file."""
    points = words_of(np.array([[0, 0, 1], [1, 0, 1], [0, 1, 1]], np.float32))
    motion = np.eye(3, 4, dtype=np.float32)
    slab_counts(np.zeros((1, 2), XYZ), np.eye(4), np.array([0.0, 1.0, 2.0]))
    _slab_moments(points.words, points.layout, motion, np.array([*EVERYWHERE, 0.0, 2.0]), 1.0)
