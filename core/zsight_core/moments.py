"""Count, centroid and covariance of points near a plane, and the plane's normal from them in closed form."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from zsight_core.jit import njit
from zsight_core.tile import TILE, load_tile, new_tile

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from zsight_core.words import Layout

__all__ = ["add_moments_near_plane", "covariance", "moments_near_plane", "plane_of_sums", "principal_axes", "warm_up"]


@njit(cache=True, nogil=True)
def moments_near_plane(
    words: NDArray[np.float32], layout: Layout, plane: NDArray[np.float64], tolerance: float
) -> NDArray[np.float64]:
    """Sums over the points with |n.p - d| <= tolerance, taken about the plane's point nearest to the origin.

    Args:
        words: float32, flat.
        layout: words a point, words of x, y, z.
        plane: (4,) nx, ny, nz, d.
        tolerance: metres; infinity takes every finite point.

    Returns:
        (10,) count, sums of x y z, of xx xy xz yy yz zz, all relative to n d.
    """
    total = np.zeros(10)
    tile = new_tile()
    for start in range(0, len(words) // layout[0], TILE):
        load_tile(words, layout, -1, start, tile)
        add_moments_near_plane(tile, plane, tolerance, total)
    return total


@njit(cache=True, nogil=True, fastmath={"reassoc", "nsz", "contract"})  # a sum in any order is as good; NaNs are kept
def add_moments_near_plane(
    tile: NDArray[np.float32], plane: NDArray[np.float64], tolerance: float, total: NDArray[np.float64]
) -> None:
    """Add the sums of one tile to those (10,) of `moments_near_plane`."""
    nx, ny, nz = np.float32(plane[0]), np.float32(plane[1]), np.float32(plane[2])
    px, py, pz = np.float32(plane[0] * plane[3]), np.float32(plane[1] * plane[3]), np.float32(plane[2] * plane[3])
    limit = np.float32(min(tolerance, 3.4e38))  # a point that is not finite lies farther off than this, or NaN
    zero = np.float32(0)
    n = sx = sy = sz = np.float64(0)
    sxx = sxy = sxz = syy = syz = szz = np.float64(
        0
    )  # in float64: the variance across a plane is a small difference of these
    for i in range(TILE):
        x, y, z = tile[0, i] - px, tile[1, i] - py, tile[2, i] - pz
        inside = abs(nx * x + ny * y + nz * z) <= limit
        x = x if inside else zero
        y = y if inside else zero
        z = z if inside else zero
        a, b, c = np.float64(x), np.float64(y), np.float64(z)  # to numba, float(x) would stay float32
        n += 1.0 if inside else 0.0
        sx += a
        sy += b
        sz += c
        sxx += a * a
        sxy += a * b
        sxz += a * c
        syy += b * b
        syz += b * c
        szz += c * c
    total[0] += n
    total[1] += sx
    total[2] += sy
    total[3] += sz
    total[4] += sxx
    total[5] += sxy
    total[6] += sxz
    total[7] += syy
    total[8] += syz
    total[9] += szz


@njit(cache=True, nogil=True)
def covariance(sums: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Centroid (3,), relative to the origin of the sums, and covariance (3, 3) out of (10,) sums with a count > 0."""
    n = sums[0]
    centroid = sums[1:4] / n
    spread = np.empty((3, 3))
    k = 4
    for row in range(3):
        for column in range(row, 3):
            spread[row, column] = sums[k] / n - centroid[row] * centroid[column]
            spread[column, row] = spread[row, column]
            k += 1
    return centroid, spread


@njit(cache=True, nogil=True)
def principal_axes(spread: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Variances (3,), ascending, and unit axes (3, 3), one a column, of a symmetric matrix (3, 3).

    Jacobi rotations: for 3 x 3 as fast as the cubic's closed form and, unlike it, exact where two roots lie close.
    """
    a = spread.copy()
    axes = np.eye(3)
    for _ in range(12):
        off = abs(a[0, 1]) + abs(a[0, 2]) + abs(a[1, 2])
        if off <= 1e-18 * (abs(a[0, 0]) + abs(a[1, 1]) + abs(a[2, 2])):
            break
        for p in range(2):
            for q in range(p + 1, 3):
                if a[p, q] == 0.0:
                    continue
                theta = (a[q, q] - a[p, p]) / (2.0 * a[p, q])
                t = math.copysign(1.0, theta) / (abs(theta) + math.sqrt(theta * theta + 1.0))
                c = 1.0 / math.sqrt(t * t + 1.0)
                s = t * c
                for k in range(3):
                    akp, akq = a[k, p], a[k, q]
                    a[k, p], a[k, q] = c * akp - s * akq, s * akp + c * akq
                for k in range(3):
                    apk, aqk = a[p, k], a[q, k]
                    a[p, k], a[q, k] = c * apk - s * aqk, s * apk + c * aqk
                for k in range(3):
                    vkp, vkq = axes[k, p], axes[k, q]
                    axes[k, p], axes[k, q] = c * vkp - s * vkq, s * vkp + c * vkq
    variances = np.array([a[0, 0], a[1, 1], a[2, 2]])
    order = np.argsort(variances)
    return variances[order], np.ascontiguousarray(axes[:, order])


@njit(cache=True, nogil=True)
def plane_of_sums(sums: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The plane of least squares through points with these (10,) sums about the origin.

    Returns:
        (4,) nx, ny, nz, d with the normal turned towards the origin; and the variances (3,) along the normal and
        along the minor and major axis in the plane.
    """
    centroid, spread = covariance(sums)
    variances, axes = principal_axes(spread)
    plane = np.empty(4)
    plane[:3] = axes[:, 0]
    plane[3] = axes[0, 0] * centroid[0] + axes[1, 0] * centroid[1] + axes[2, 0] * centroid[2]
    return (-plane if plane[3] > 0.0 else plane), variances


def warm_up() -> None:
    """Compile the kernels of this file."""
    sums = moments_near_plane(np.eye(3, 4, dtype=np.float32).ravel(), (4, 0, 1, 2), np.array([0.0, 0, 1, 0]), math.inf)
    plane_of_sums(sums)
