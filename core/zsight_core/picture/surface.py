"""A cloud seen from an eye: neighbours of an organised cloud are joined to a surface, other points become discs."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.spatial import cKDTree

from zsight_core.colour_map import graded, spread
from zsight_core.jit import njit
from zsight_core.points import Points, colours, from_xyz, has_colour, is_organised, xyz

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from zsight_core.picture.eye import Projection

__all__ = ["paint", "warm_up"]

JUMP = 0.018  # of the depth: neighbours farther apart are not joined
SLANT = 8.0  # nor those more than this many pixel widths apart
RIM = -1e-3  # share by which a triangle reaches over its edge, so that rounding leaves no crack
SMALLEST_DISC, LARGEST_DISC = 0.8, 12.0  # pixels


def paint(points: Points, projection: Projection, image: NDArray[np.uint8], depth: NDArray[np.float32]) -> None:
    """Draw a cloud.

    Args:
        points: (H, W), any field layout with x, y, z; coloured by depth where it has no rgb.
        projection: eye and image size.
        image: (rows, columns, 3) changed in place.
        depth: (rows, columns), metres from the eye, infinite where nothing is drawn yet; changed in place.
    """
    coordinates = xyz(points)
    colour = colours(points) if has_colour(points) else _by_depth(coordinates)
    T = projection.T_eye_points
    seen = np.empty((*points.shape, 3), dtype=np.float32)
    _project(np.ascontiguousarray(coordinates), T, projection.focal, projection.width, projection.height, seen)
    alone = np.ones(points.shape, dtype=np.bool_)
    if is_organised(points):
        step = _step_of_image(coordinates)
        _join(coordinates, seen, colour, step, alone, image, depth)
        spacing = step * float(np.nanmedian(np.abs(coordinates[::4, ::4, 2]))) if np.isfinite(seen).any() else 0.0
    else:
        spacing = _spacing(coordinates.reshape(-1, 3))
    _discs(seen, colour, alone, 0.7 * spacing * projection.focal, image, depth)


def warm_up() -> None:
    """Compile the kernels of this module, or load them from the cache, on a cloud of each layout."""
    from zsight_core.picture.eye import Eye, Projection

    v, u = np.mgrid[0:4, 0:4]
    grid = np.stack([u * 0.01, v * 0.01, np.ones((4, 4))], axis=-1)
    projection = Projection.of(Eye(np.eye(4)), 16, 16)
    for cloud in (from_xyz(grid, np.zeros((4, 4, 3), np.uint8)), from_xyz(grid), from_xyz(grid.reshape(-1, 3))):
        paint(cloud, projection, np.zeros((16, 16, 3), np.uint8), np.full((16, 16), np.inf, np.float32))


def _by_depth(coordinates: NDArray[np.float32]) -> NDArray[np.uint8]:
    """For clouds without colour: from the nearest to the farthest point."""
    z = coordinates[..., 2]
    return graded(z, *spread(z))


def _step_of_image(coordinates: NDArray[np.float32]) -> float:
    """Distance of neighbours in an image over their depth, which is one over the focal length."""
    rows = coordinates[:: max(1, len(coordinates) // 40)]
    step = np.abs(np.diff(rows[..., 0], axis=1)) / np.abs(rows[:, 1:, 2])
    finite = step[np.isfinite(step)]
    return float(np.median(finite)) if finite.size else 0.002


def _spacing(xyz_flat: NDArray[np.float32]) -> float:
    """Median distance of a sample of points to their next neighbour, metres."""
    finite = xyz_flat[np.isfinite(xyz_flat).all(axis=1)]
    if len(finite) < 3:
        return 0.005
    sample = finite[:: max(1, len(finite) // 300)]
    distances, _ = cKDTree(finite).query(sample, k=[2])  # the first neighbour of a point is the point
    return float(np.median(np.asarray(distances)))


@njit(cache=True, nogil=True)
def _project(coordinates: Any, T: Any, focal: float, width: int, height: int, seen: Any) -> None:
    """Columns, rows and depths of points; NaN behind the eye."""
    rows, columns = coordinates.shape[:2]
    half_width, half_height = (width - 1) / 2, (height - 1) / 2
    for v in range(rows):
        for u in range(columns):
            x, y, z = coordinates[v, u, 0], coordinates[v, u, 1], coordinates[v, u, 2]
            depth = T[2, 0] * x + T[2, 1] * y + T[2, 2] * z + T[2, 3]
            if not depth > 1e-3:
                seen[v, u, 0] = seen[v, u, 1] = seen[v, u, 2] = np.nan
                continue
            seen[v, u, 0] = focal * (T[0, 0] * x + T[0, 1] * y + T[0, 2] * z + T[0, 3]) / depth + half_width
            seen[v, u, 1] = focal * (T[1, 0] * x + T[1, 1] * y + T[1, 2] * z + T[1, 3]) / depth + half_height
            seen[v, u, 2] = depth


@njit(cache=True, nogil=True, inline="always")
def _neighbours(coordinates: Any, v: int, u: int, w: int, t: int, step: float) -> bool:
    z = abs(coordinates[v, u, 2])
    limit = max(JUMP * z, SLANT * step * z)
    dx = coordinates[v, u, 0] - coordinates[w, t, 0]
    dy = coordinates[v, u, 1] - coordinates[w, t, 1]
    dz = coordinates[v, u, 2] - coordinates[w, t, 2]
    return bool(dx * dx + dy * dy + dz * dz < limit * limit)


@njit(cache=True, nogil=True)
def _bridged(coordinates: Any, seen: Any, v: int, u: int, step: float) -> bool:
    """True where the four neighbours of a hole lie on one surface."""
    return (
        seen[v - 1, u, 2] > 0
        and seen[v + 1, u, 2] > 0
        and _neighbours(coordinates, v - 1, u, v, u - 1, step)
        and _neighbours(coordinates, v, u - 1, v + 1, u, step)
        and _neighbours(coordinates, v + 1, u, v, u + 1, step)
        and _neighbours(coordinates, v, u + 1, v - 1, u, step)
    )


@njit(cache=True, nogil=True)
def _triangle(seen: Any, colour: Any, a: Any, b: Any, c: Any, image: Any, depth: Any) -> None:
    """Fill one triangle, colours and inverse depths blended between its corners (pixel coordinates a, b, c)."""
    height, width = depth.shape
    ax, ay, az = seen[a[0], a[1], 0], seen[a[0], a[1], 1], seen[a[0], a[1], 2]
    bx, by, bz = seen[b[0], b[1], 0], seen[b[0], b[1], 1], seen[b[0], b[1], 2]
    cx, cy, cz = seen[c[0], c[1], 0], seen[c[0], c[1], 1], seen[c[0], c[1], 2]
    area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
    if not abs(area) > 1e-9:
        return
    left, right = int(max(np.ceil(min(ax, bx, cx)), 0.0)), int(min(np.floor(max(ax, bx, cx)), width - 1.0))
    top, bottom = int(max(np.ceil(min(ay, by, cy)), 0.0)), int(min(np.floor(max(ay, by, cy)), height - 1.0))
    share = np.float32(1) / area
    b_across, c_across = (cy - ay) * share, (ay - by) * share
    b_down, c_down = (ax - cx) * share, (bx - ax) * share
    for row in range(top, bottom + 1):
        wb_row, wc_row = (row - ay) * b_down - ax * b_across, (row - ay) * c_down - ax * c_across
        for column in range(left, right + 1):
            wb, wc = wb_row + column * b_across, wc_row + column * c_across
            wa = 1 - wb - wc
            if wa < RIM or wb < RIM or wc < RIM:
                continue
            z = wa * az + wb * bz + wc * cz
            if z < depth[row, column]:
                depth[row, column] = z
                for k in range(3):
                    mixed = wa * colour[a[0], a[1], k] + wb * colour[b[0], b[1], k] + wc * colour[c[0], c[1], k]
                    image[row, column, k] = np.uint8(min(max(mixed, 0.0), 255.0))


@njit(cache=True, nogil=True)
def _join(coordinates: Any, seen: Any, colour: Any, step: float, alone: Any, image: Any, depth: Any) -> None:
    """Fill the two triangles between each four pixels whose points lie near each other, and bridge single holes."""
    rows, columns = alone.shape
    for v in range(1, rows - 1):
        for u in range(1, columns - 1):
            if not seen[v, u, 2] > 0 and _bridged(coordinates, seen, v, u, step):
                above, below, left, right = (v - 1, u), (v + 1, u), (v, u - 1), (v, u + 1)
                _triangle(seen, colour, left, above, right, image, depth)
                _triangle(seen, colour, left, right, below, image, depth)
    for v in range(rows - 1):
        for u in range(columns - 1):
            rising = _neighbours(coordinates, v, u + 1, v + 1, u, step)  # false where one of them is a hole
            if not rising and not _neighbours(coordinates, v, u, v + 1, u + 1, step):
                continue
            first, second = ((v, u + 1), (v + 1, u)) if rising else ((v, u), (v + 1, u + 1))
            corners = ((v, u), (v + 1, u + 1)) if rising else ((v, u + 1), (v + 1, u))
            if not seen[first[0], first[1], 2] > 0 or not seen[second[0], second[1], 2] > 0:
                continue
            for corner in corners:
                if (
                    seen[corner[0], corner[1], 2] > 0
                    and _neighbours(coordinates, corner[0], corner[1], first[0], first[1], step)
                    and _neighbours(coordinates, corner[0], corner[1], second[0], second[1], step)
                ):
                    _triangle(seen, colour, corner, first, second, image, depth)
                    alone[corner[0], corner[1]] = False
                    alone[first[0], first[1]] = alone[second[0], second[1]] = False


@njit(cache=True, nogil=True)
def _discs(seen: Any, colour: Any, alone: Any, radius_times_depth: float, image: Any, depth: Any) -> None:
    """Fill a disc for each point that is part of no surface."""
    height, width = depth.shape
    rows, columns = alone.shape
    for v in range(rows):
        for u in range(columns):
            z = seen[v, u, 2]
            if not alone[v, u] or not z > 0:
                continue
            x, y = seen[v, u, 0], seen[v, u, 1]
            radius = min(max(radius_times_depth / z, SMALLEST_DISC), LARGEST_DISC)
            if not (-radius < x < width + radius and -radius < y < height + radius):
                continue
            for row in range(max(int(np.ceil(y - radius)), 0), min(int(np.floor(y + radius)), height - 1) + 1):
                for column in range(max(int(np.ceil(x - radius)), 0), min(int(np.floor(x + radius)), width - 1) + 1):
                    if (column - x) ** 2 + (row - y) ** 2 <= radius * radius and z < depth[row, column]:
                        depth[row, column] = z
                        for k in range(3):
                            image[row, column, k] = colour[v, u, k]
