"""Clusters: groups of points that hang together by steps no longer than a tolerance."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from zsight_core.disjoint_sets import root_of
from zsight_core.errors import GeometryError, PointsError
from zsight_core.jit import njit
from zsight_core.neighbour_grid import grid_of
from zsight_core.tile import TILE, load_tile, new_tile
from zsight_core.words import words_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from zsight_core.plane import Plane
    from zsight_core.points import Points
    from zsight_core.words import Layout, Words

__all__ = ["clusters_above", "euclidean_clusters", "image_clusters", "warm_up"]


def euclidean_clusters(
    cloud: Points | NDArray[np.floating[Any]],
    tolerance: float,
    least: int = 1,
    most: int | None = None,
    mask: NDArray[np.bool_] | None = None,
) -> NDArray[np.int32]:
    """Groups of points in which each is at most `tolerance` from another: the partition of PCL's Euclidean clustering.

    Method: in a grid of cells of tolerance / sqrt(3), all points of a cell belong together; cells are joined (union
    and find) where two of their points lie near enough, and are compared only while they are not yet joined.

    Args:
        cloud: Points (H, W) or coordinates (N, 3), metres; holes belong to no cluster.
        tolerance: longest step, metres.
        least: smaller groups are left out.
        most: larger groups are left out; None: no limit.
        mask: (H, W), the points that take part; None: all.

    Returns:
        int32 (H, W): number of each point's cluster, the largest (of equal ones the one that begins earlier) is 0; -1
        for a point in none.

    Raises:
        GeometryError: tolerance not above zero, or so small that the grid overflows.
        PointsError: the mask does not fit.
    """
    words = words_of(cloud)
    if mask is not None and (mask.shape != words.shape or mask.dtype != np.bool_):
        raise PointsError(f"mask has shape {mask.shape} and type {mask.dtype}; expected {words.shape} and bool")
    _require_step(tolerance)
    chosen = None if mask is None else np.ascontiguousarray(mask).reshape(-1)
    return _labelled(words, chosen, tolerance, least, most)


def clusters_above(
    points: Points,
    plane: Plane,
    low: float,
    high: float,
    tolerance: float,
    least: int = 1,
    most: int | None = None,
) -> NDArray[np.int32]:
    """`euclidean_clusters` of the points that stand low..high metres above the plane, towards the camera.

    Raises:
        GeometryError: low > high; tolerance not above zero.
    """
    if not low <= high:
        raise GeometryError(f"heights are {low} to {high} m; expected the lower one first")
    _require_step(tolerance)
    words = words_of(points)
    chosen = np.empty(words.count, np.bool_)
    _mark_between(words.words, words.layout, plane.coefficients(), np.float32(low), np.float32(high), chosen)
    return _labelled(words, chosen, tolerance, least, most)


def image_clusters(
    points: Points, mask: NDArray[np.bool_], gap: float, least: int = 1, most: int | None = None
) -> NDArray[np.int32]:
    """Connected components of an organised cloud: neighbours left and right, above and below, at most `gap` apart.

    Far cheaper than `euclidean_clusters`, and what is apart in the image stays apart.

    Args:
        points: (H, W), metres.
        mask: (H, W), the points that take part.
        gap: longest step from pixel to pixel, metres.
        least: smaller groups are left out.
        most: larger groups are left out; None: no limit.

    Returns:
        int32 (H, W) as of `euclidean_clusters`.

    Raises:
        PointsError: the mask does not fit.
        GeometryError: gap not above zero.
    """
    words = words_of(points)
    if mask.shape != words.shape or mask.dtype != np.bool_:
        raise PointsError(f"mask has shape {mask.shape} and type {mask.dtype}; expected {words.shape} and bool")
    _require_step(gap)
    root = _image_roots(words.words, words.layout, words.shape[1], np.ascontiguousarray(mask).reshape(-1), gap)
    return _numbered(root, least, words.count if most is None else most).reshape(words.shape)


def _require_step(length: float) -> None:
    if not (math.isfinite(length) and length > 0):
        raise GeometryError(f"longest step is {length} m; expected a length above zero")


def _labelled(
    cloud: Words, chosen: NDArray[np.bool_] | None, tolerance: float, least: int, most: int | None
) -> NDArray[np.int32]:
    """Cluster the chosen points (N,)."""
    grid = grid_of(cloud, tolerance / math.sqrt(3.0), chosen)
    root_of_cell = _joined(grid.xyz, grid.starts, grid.keys, tolerance)
    root = _roots_of_points(root_of_cell, grid.starts, grid.order, cloud.count)
    del grid
    return _numbered(root, least, cloud.count if most is None else most).reshape(cloud.shape)


def _rows() -> NDArray[np.int64]:
    """Steps in key to the 13 rows of cells along x (half of those around) that can hold a point near, nearest first."""
    z, y = (axis.ravel() - 2 for axis in np.indices((5, 5)))
    far = np.maximum(np.abs(y) - 1, 0) ** 2 + np.maximum(np.abs(z) - 1, 0) ** 2
    nearest_first = np.argsort(far * 100 + y**2 + z**2, kind="stable")
    steps = (y << 21) + (z << 42)
    return steps[nearest_first[steps[nearest_first] >= 0]]


_ROWS = _rows()


@njit(cache=True, nogil=True)
def _mark_between(
    words: NDArray[np.float32],
    layout: Layout,
    plane: NDArray[np.float64],
    low: Any,
    high: Any,
    chosen: NDArray[np.bool_],
) -> None:
    """Mark the points low..high above the plane."""
    nx, ny, nz, d = np.float32(plane[0]), np.float32(plane[1]), np.float32(plane[2]), np.float32(plane[3])
    tile, inside = new_tile(), np.empty(TILE, np.bool_)
    for start in range(0, len(chosen), TILE):
        load_tile(words, layout, -1, start, tile)
        for i in range(TILE):
            height = nx * tile[0, i] + ny * tile[1, i] + nz * tile[2, i] - d
            inside[i] = (height >= low) & (height <= high)
        rest = chosen[start : start + TILE]
        rest[:] = inside[: len(rest)]


@njit(cache=True, nogil=True)
def _joined(
    xyz: NDArray[np.float32],
    starts: NDArray[np.int32],
    keys: NDArray[np.int64],
    tolerance: float,
) -> NDArray[np.int32]:
    """Root of each cell after joining all cells that hold points within the tolerance of each other."""
    cells = len(keys)
    parent = np.arange(cells).astype(np.int32)
    boxes = _boxes(xyz, starts)
    limit = np.float32(tolerance) * np.float32(tolerance)
    for step in _ROWS:
        first = 0
        for here in range(cells):
            low, high = keys[here] + (step - 2 if step else 1), keys[here] + step + 2
            while first < cells and keys[first] < low:
                first += 1
            there = first
            while there < cells and keys[there] <= high:
                mine, other = root_of(parent, here), root_of(parent, there)
                if (
                    mine != other
                    and _box_gap(boxes[here], boxes[there]) <= limit
                    and _touch(
                        xyz, starts[here], starts[here + 1], starts[there], starts[there + 1], boxes[there], limit
                    )
                ):
                    parent[max(mine, other)] = min(mine, other)
                there += 1
    for cell in range(cells):
        parent[cell] = root_of(parent, cell)
    return parent


@njit(cache=True, nogil=True)
def _boxes(xyz: NDArray[np.float32], starts: NDArray[np.int32]) -> NDArray[np.float32]:
    """Bounding box of the points of each cell: (C, 6) low x y z, high x y z."""
    boxes = np.empty((len(starts) - 1, 6), np.float32)
    for cell in range(len(boxes)):
        for axis in range(3):
            low = high = xyz[axis, starts[cell]]
            for i in range(starts[cell] + 1, starts[cell + 1]):
                low, high = min(low, xyz[axis, i]), max(high, xyz[axis, i])
            boxes[cell, axis], boxes[cell, 3 + axis] = low, high
    return boxes


@njit(cache=True, nogil=True)
def _box_gap(a: NDArray[np.float32], b: NDArray[np.float32]) -> Any:
    """Squared distance of two boxes."""
    zero = np.float32(0)
    x = max(zero, a[0] - b[3], b[0] - a[3])
    y = max(zero, a[1] - b[4], b[1] - a[4])
    z = max(zero, a[2] - b[5], b[2] - a[5])
    return x * x + y * y + z * z


@njit(cache=True, nogil=True)
def _touch(
    xyz: NDArray[np.float32], first: int, last: int, other_first: int, other_last: int, box: Any, limit: Any
) -> bool:
    """True where a point of one stretch lies within the limit (squared) of a point of the other, which `box` bounds."""
    zero = np.float32(0)
    for i in range(first, last):
        x, y, z = xyz[0, i], xyz[1, i], xyz[2, i]
        gap_x = max(zero, box[0] - x, x - box[3])
        gap_y = max(zero, box[1] - y, y - box[4])
        gap_z = max(zero, box[2] - z, z - box[5])
        if gap_x * gap_x + gap_y * gap_y + gap_z * gap_z > limit:
            continue
        for j in range(other_first, other_last):
            dx, dy, dz = x - xyz[0, j], y - xyz[1, j], z - xyz[2, j]
            if dx * dx + dy * dy + dz * dz <= limit:
                return True
    return False


@njit(cache=True, nogil=True)
def _roots_of_points(
    root_of_cell: NDArray[np.int32],
    starts: NDArray[np.int32],
    order: NDArray[np.int32],
    count: int,
) -> NDArray[np.int32]:
    """For each of `count` points the root of its cluster, any number below `count`, -1 without."""
    root = np.full(count, -1, np.int32)
    for cell in range(len(root_of_cell)):
        for place in range(starts[cell], starts[cell + 1]):
            root[order[place]] = root_of_cell[cell]
    return root


@njit(cache=True, nogil=True)
def _image_roots(
    words: NDArray[np.float32], layout: Layout, width: int, mask: NDArray[np.bool_], gap: float
) -> NDArray[np.int32]:
    """Root pixel of each pixel's component, -1 outside the mask and at holes."""
    step, at_x, at_y, at_z = layout
    parent = np.empty(len(mask), np.int32)
    limit = np.float32(gap) * np.float32(gap)
    for i in range(len(mask)):
        x, y, z = words[step * i + at_x], words[step * i + at_y], words[step * i + at_z]
        parent[i] = i if mask[i] and math.isfinite(x) and math.isfinite(y) and math.isfinite(z) else -1
        if parent[i] < 0:
            continue
        for back in (1, width):
            j = i - back
            if j < 0 or parent[j] < 0 or (back == 1 and i % width == 0):
                continue
            dx, dy, dz = x - words[step * j + at_x], y - words[step * j + at_y], z - words[step * j + at_z]
            if dx * dx + dy * dy + dz * dz <= limit:
                mine, other = root_of(parent, i), root_of(parent, j)
                parent[max(mine, other)] = min(mine, other)
    root = np.full(len(mask), -1, np.int32)
    for i in range(len(mask)):
        if parent[i] >= 0:
            root[i] = root_of(parent, i)
    return root


@njit(cache=True, nogil=True)
def _numbered(root: NDArray[np.int32], least: int, most: int) -> NDArray[np.int32]:
    """Roots to cluster numbers, the largest first; too small and too large ones to -1."""
    bound = root.max() + 1 if len(root) else 0
    sizes = np.zeros(bound, np.int32)
    first = np.full(bound, -1, np.int32)
    used = 0
    found = np.empty(bound, np.int32)
    for i in range(len(root)):
        if root[i] >= 0:
            if first[root[i]] < 0:
                first[root[i]] = i
                found[used] = root[i]
                used += 1
            sizes[root[i]] += 1
    order = np.argsort(-sizes[found[:used]], kind="mergesort")
    number = np.full(bound, -1, np.int32)
    clusters = 0
    for k in order:
        if least <= sizes[found[k]] <= most:
            number[found[k]] = clusters
            clusters += 1
    for i in range(len(root)):
        if root[i] >= 0:
            root[i] = number[root[i]]
    return root


def warm_up() -> None:
    """Compile the kernels of this file."""
    from zsight_core.plane import plane_through
    from zsight_core.points import from_xyz

    points = from_xyz(np.zeros((2, 2, 3)))
    euclidean_clusters(points, 0.1)
    clusters_above(points, plane_through([0, 0, 1], [0, 0, 1]), 0.5, 2.0, 0.1)
    image_clusters(points, np.ones((2, 2), np.bool_), 0.1)
