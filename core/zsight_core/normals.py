"""Normals of any cloud, from the points around each point."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from zsight_core.errors import GeometryError
from zsight_core.jit import njit
from zsight_core.neighbour_grid import block_around, grid_of
from zsight_core.take import array_for
from zsight_core.words import words_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from zsight_core.points import Points

__all__ = ["normals", "warm_up"]


def normals(
    cloud: Points | NDArray[np.floating[Any]], radius: float, out: NDArray[np.float32] | None = None
) -> NDArray[np.float32]:
    """Unit normals, towards the origin, of the planes of least squares through the points around each point.

    Method: as PCL's NormalEstimation with a radius: the axis of least variance of all points within it. Points are
    sorted into cells as wide as the radius, so that those in question stand side by side in memory. An organised cloud
    has its normals ten times faster from `image_normals`.

    Args:
        cloud: Points (H, W) or coordinates (N, 3), metres.
        radius: metres.
        out: room for the result, contiguous.

    Returns:
        float32 (H, W, 3); NaN at holes, and where fewer than 3 points (itself included) lie within the radius or all
        of them on a line.

    Raises:
        GeometryError: radius not above zero, or so small that the grid overflows.
        PointsError: `out` does not fit.
    """
    if not (math.isfinite(radius) and radius > 0):
        raise GeometryError(f"radius is {radius} m; expected a length above zero")
    words = words_of(cloud)
    found = array_for((*words.shape, 3), np.float32, out)
    found[:] = np.nan
    grid = grid_of(words, radius)
    _normals(grid.xyz, grid.starts, grid.keys, grid.order, radius, found.reshape(-1, 3))
    return found


@njit(cache=True, nogil=True)
def _normals(
    xyz: NDArray[np.float32],
    starts: NDArray[np.int32],
    keys: NDArray[np.int64],
    index: NDArray[np.int32],
    radius: float,
    out: NDArray[np.float32],
) -> None:
    limit = np.float32(radius) * np.float32(radius)
    room, sums, normal = np.empty((3, 1024), np.float32), np.empty(10), np.empty(3)
    rows = np.zeros(9, np.int64)
    for cell in range(len(keys)):
        room, count = block_around(xyz, starts, keys, cell, rows, room)
        for i in range(starts[cell], starts[cell + 1]):
            _sums_within(room[0, :count], room[1, :count], room[2, :count], xyz[:, i], limit, sums)
            if sums[0] < 3 or not _least_axis(sums, normal):
                continue
            away = normal[0] * xyz[0, i] + normal[1] * xyz[1, i] + normal[2] * xyz[2, i] > 0
            for axis in range(3):
                out[index[i], axis] = -normal[axis] if away else normal[axis]


@njit(cache=True, nogil=True, fastmath={"reassoc", "nsz", "contract"})  # a sum in any order is as good
def _sums_within(
    x: NDArray[np.float32],
    y: NDArray[np.float32],
    z: NDArray[np.float32],
    point: NDArray[np.float32],
    limit: Any,
    sums: NDArray[np.float64],
) -> None:
    """Count, and first and second moments about the point, of the points within a squared distance of it."""
    px, py, pz, zero = point[0], point[1], point[2], np.float32(0)
    n = sx = sy = sz = sxx = sxy = sxz = syy = syz = szz = zero
    for i in range(len(x)):
        dx, dy, dz = x[i] - px, y[i] - py, z[i] - pz
        near = np.float32(1) if dx * dx + dy * dy + dz * dz <= limit else zero
        n += near
        sx += near * dx
        sy += near * dy
        sz += near * dz
        sxx += near * dx * dx
        sxy += near * dx * dy
        sxz += near * dx * dz
        syy += near * dy * dy
        syz += near * dy * dz
        szz += near * dz * dz
    sums[0], sums[1], sums[2], sums[3] = n, sx, sy, sz
    sums[4], sums[5], sums[6], sums[7], sums[8], sums[9] = sxx, sxy, sxz, syy, syz, szz


@njit(cache=True, nogil=True)
def _least_axis(sums: NDArray[np.float64], axis: NDArray[np.float64]) -> bool:
    """The unit axis (3,) of least variance of points with these (10,) sums; False where they lie on a line.

    The least root of the characteristic polynomial by Newton's method, which from 0 on rises to it and never passes
    it; then the axis is normal to the rows of the matrix less that root.
    """
    n = sums[0]
    mx, my, mz = sums[1] / n, sums[2] / n, sums[3] / n
    xx, xy, xz = sums[4] / n - mx * mx, sums[5] / n - mx * my, sums[6] / n - mx * mz
    yy, yz, zz = sums[7] / n - my * my, sums[8] / n - my * mz, sums[9] / n - mz * mz
    trace = xx + yy + zz
    minors = xx * yy - xy * xy + xx * zz - xz * xz + yy * zz - yz * yz
    if not minors > 1e-12 * trace * trace:
        return False
    determinant = xx * (yy * zz - yz * yz) - xy * (xy * zz - yz * xz) + xz * (xy * yz - yy * xz)
    root = 0.0
    for _ in range(30):
        slope = (3.0 * root - 2.0 * trace) * root + minors
        step = (((root - trace) * root + minors) * root - determinant) / slope if slope > 0 else 0.0
        root -= step
        if abs(step) <= 1e-12 * trace:
            break
    xx, yy, zz = xx - root, yy - root, zz - root
    best = 0.0
    for pair in range(3):
        if pair == 0:
            a, b, c = xy * yz - xz * yy, xz * xy - xx * yz, xx * yy - xy * xy
        elif pair == 1:
            a, b, c = xy * zz - xz * yz, xz * xz - xx * zz, xx * yz - xy * xz
        else:
            a, b, c = yy * zz - yz * yz, yz * xz - xy * zz, xy * yz - yy * xz
        length = a * a + b * b + c * c
        if length > best:
            best = length
            axis[0], axis[1], axis[2] = a, b, c
    axis /= math.sqrt(best) if best > 0 else 1.0
    return best > 0


def warm_up() -> None:
    """Compile the kernels of this file."""
    normals(np.array([[0, 0, 1], [1, 0, 1], [0, 1, 1]], np.float32), 2.0)
