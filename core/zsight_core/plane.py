"""Planes: fitted to points in spite of outliers, the points near them, and a frame upon them.

The convention is the book's (Newman, chapter 8): the unit normal faces the camera, which stands in the origin of the
cloud's frame, and a point p of the plane has n.p = distance; the distance is therefore negative.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from zsight_core.errors import GeometryError
from zsight_core.jit import njit
from zsight_core.moments import covariance, moments_near_plane, principal_axes
from zsight_core.points import XYZ
from zsight_core.take import append_marked, array_for, room_for, take, trimmed, units_of
from zsight_core.tile import TILE, lies_packed, load_tile, new_tile
from zsight_core.words import words_of

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from zsight_core.points import Points
    from zsight_core.words import Layout, Words

__all__ = [
    "Plane",
    "PlaneFit",
    "fit_robust",
    "frame_on_plane",
    "heights",
    "inliers",
    "plane_through",
    "ransac_plane",
    "select",
    "warm_up",
]

_SAMPLE = 2048
"""Points on which hypotheses are tried; the standard error of their inlier ratio is about 1 %."""

_NOISE_FLOOR = 1e-4
"""Least tolerance, metres: below it lie the roundings of float32 coordinates some metres away."""


_ON_A_LINE = -1
"""In place of a count of points: all of them lie on one line."""


@dataclass(frozen=True)
class Plane:
    """The points p with normal . p = distance.

    ``normal`` (3,) float64, of unit length, facing the camera; ``distance`` metres, the book's negative signed
    distance of the plane: <= 0 for a normal that faces the origin.
    """

    normal: NDArray[np.float64]
    distance: float

    def coefficients(self) -> NDArray[np.float64]:
        """(4,) float64: nx, ny, nz, distance."""
        return np.array([*self.normal, self.distance])


@dataclass(frozen=True)
class PlaneFit:
    """A plane, to how many points it was fitted, and the root mean square of their distances from it, metres."""

    plane: Plane
    inliers: int
    rms: float


def plane_through(normal: ArrayLike, point: ArrayLike) -> Plane:
    """The plane with this normal (3,), of any length and sign, through the point (3,); turned to face the origin.

    Raises:
        GeometryError: the normal has no length.
    """
    direction = np.asarray(normal, dtype=np.float64)
    length = float(np.linalg.norm(direction))
    if not (math.isfinite(length) and length > 0):
        raise GeometryError(f"normal is {direction}; expected a vector of finite length above zero")
    direction = direction / length
    distance = float(direction @ np.asarray(point, dtype=np.float64))
    return Plane(-direction, -distance) if distance > 0 else Plane(direction, distance)


def fit_robust(
    cloud: Points | NDArray[np.floating[Any]], tolerance: float = 0.01, *, seed: int = 0, iterations: int = 500
) -> PlaneFit:
    """The plane of a patch that may also hold part of an object.

    A sample consensus with truncated squared distances finds the plane (MSAC, Torr and Zisserman 2000); then the noise
    is measured on its own inliers (median absolute distance) and the plane is refitted by moments to the points within
    2.5 standard deviations, so that the foot of an object that stands on the plane does not tilt it.

    Args:
        cloud: Points (H, W) or coordinates (N, 3), metres; holes are passed over.
        tolerance: the farthest that noise carries a point of the plane off it, metres.
        seed: of the sampling; equal seeds give equal planes.
        iterations: at most so many hypotheses.

    Raises:
        GeometryError: fewer than 3 points, or all on one line.
    """
    return _fitted(words_of(cloud), tolerance, seed, iterations, robust=True)


def ransac_plane(
    cloud: Points | NDArray[np.floating[Any]], threshold: float, *, seed: int = 0, iterations: int = 1000
) -> PlaneFit:
    """The plane with most points within `threshold`, by MSAC with refit.

    Args:
        cloud: Points (H, W) or coordinates (N, 3), metres; holes are passed over.
        threshold: a point is an inlier up to this distance, metres.
        seed: of the sampling; equal seeds give equal planes.
        iterations: at most so many hypotheses; it stops earlier once a better one is unlikely (0.1 %).

    Raises:
        GeometryError: threshold not above zero; fewer than 3 points, or all on one line.
    """
    return _fitted(words_of(cloud), threshold, seed, iterations, robust=False)


def heights(
    cloud: Points | NDArray[np.floating[Any]], plane: Plane, out: NDArray[np.float32] | None = None
) -> NDArray[np.float32]:
    """Signed distance of each point from the plane, metres, positive towards the camera: float32 (H, W), holes NaN.

    Raises:
        PointsError: `out`, room for the result, does not fit.
    """
    words = words_of(cloud)
    found = array_for(words.shape, np.float32, out)
    _heights(words.words, words.layout, plane.coefficients(), found.reshape(-1))
    return found


def inliers(
    cloud: Points | NDArray[np.floating[Any]], plane: Plane, tolerance: float, out: NDArray[np.bool_] | None = None
) -> NDArray[np.bool_]:
    """Mask (H, W) of the points with |n.p - d| <= tolerance, metres; False at holes.

    Raises:
        GeometryError: tolerance is negative or NaN.
        PointsError: `out`, room for the result, does not fit.
    """
    _require_tolerance(tolerance)
    words = words_of(cloud)
    found = array_for(words.shape, np.bool_, out)
    _near(words.words, words.layout, plane.coefficients(), np.float32(tolerance), found.reshape(-1))
    return found


def select(points: Points, plane: Plane, tolerance: float, out: Points | None = None) -> Points:
    """The points within tolerance of the plane: (1, M), all fields as they are, in the cloud's order.

    Args:
        points: (H, W).
        plane: in the cloud's frame.
        tolerance: greatest distance, metres.
        out: room for the result, contiguous, as many points as the cloud has; the result is then a view of it.

    Raises:
        GeometryError: tolerance is negative or NaN.
    """
    _require_tolerance(tolerance)
    cloud, units = words_of(points), units_of(points)
    room = room_for(points, points.size, out) if points.dtype.itemsize == 16 and units is not None else None
    target = None if room is None else units_of(room)
    if room is None or units is None or target is None:
        return take(points, inliers(points, plane, tolerance), out)
    limit = np.float32(tolerance)
    return trimmed(room, _take_near(cloud.words, cloud.layout, plane.coefficients(), limit, units, target), out)


def frame_on_plane(plane: Plane, point: ArrayLike) -> NDArray[np.float64]:
    """T_camera_plane (4, 4): a frame on the plane, as the book builds it from a selected patch.

    The origin is `point` (3,) (the patch's centroid), metres, dropped onto the plane; z is the normal; x is the
    camera's x axis laid into the plane; y = z cross x. Where the normal runs along the camera's x axis (within 0.06
    degrees), the camera's y axis is laid into the plane for y instead.
    """
    z = plane.normal
    x = np.array([1.0, 0.0, 0.0]) - z[0] * z
    if np.linalg.norm(x) < 1e-3:
        x = np.cross(np.array([0.0, 1.0, 0.0]), z)
    x = x / np.linalg.norm(x)
    p = np.asarray(point, dtype=np.float64)
    T = np.eye(4)
    T[:3, 0], T[:3, 1], T[:3, 2] = x, np.cross(z, x), z
    T[:3, 3] = p - (float(z @ p) - plane.distance) * z
    return T


def _fitted(cloud: Words, threshold: float, seed: int, iterations: int, *, robust: bool) -> PlaneFit:
    if not (math.isfinite(threshold) and threshold > 0):
        raise GeometryError(f"threshold is {threshold} m; expected a length above zero")
    plane, count, variance = _fit(cloud.words, cloud.layout, threshold, seed, iterations, robust)
    if count == _ON_A_LINE:
        raise GeometryError("all points lie on one line; a plane needs three that do not")
    if not plane.any():
        raise GeometryError(f"{count} points are not enough for a plane; expected at least 3")
    return PlaneFit(Plane(plane[:3], float(plane[3])), count, math.sqrt(max(variance, 0.0)))


def _require_tolerance(tolerance: float) -> None:
    if not tolerance >= 0:
        raise GeometryError(f"tolerance is {tolerance} m; expected zero or more")


@njit(cache=True, nogil=True)
def _fit(
    words: NDArray[np.float32], layout: Layout, threshold: float, seed: int, iterations: int, robust: bool
) -> tuple[NDArray[np.float64], int, float]:
    """The best of many planes through three points each, refitted to its share of the sample, then of the cloud.

    Returns:
        (4,) nx, ny, nz, d, zeros where there is none; to how many points it is fitted, `_ON_A_LINE` where they lie on
        one; their variance across it.
    """
    sample = _sample(words, layout, seed, _SAMPLE)
    if len(sample) < 3:
        return np.zeros(4), len(sample), 0.0
    best = _msac(sample, threshold, seed, iterations)
    if not best.any():
        return best, _ON_A_LINE, 0.0
    best, count, variance = _refit(sample.reshape(-1), (4, 0, 1, 2), _facing(best), threshold, 4)
    if count == _ON_A_LINE:
        return best, count, variance
    if not robust:
        return _refit(words, layout, best, threshold, 1)
    return _refit(words, layout, best, min(threshold, _noise_limit(words, layout, best, threshold)), 2)


@njit(cache=True, nogil=True)
def _facing(plane: NDArray[np.float64]) -> NDArray[np.float64]:
    """The same plane with the normal towards the origin."""
    return -plane if plane[3] > 0.0 else plane


@njit(cache=True, nogil=True)
def _noise_limit(words: NDArray[np.float32], layout: Layout, plane: NDArray[np.float64], tolerance: float) -> float:
    """2.5 standard deviations of the plane's own points, from the median of their distances."""
    sample = _sample(words, layout, 1, 2 * _SAMPLE)
    near, used = np.empty(len(sample)), 0
    for i in range(len(sample)):
        distance = abs(plane[0] * sample[i, 0] + plane[1] * sample[i, 1] + plane[2] * sample[i, 2] - plane[3])
        if distance <= tolerance:
            near[used] = distance
            used += 1
    sigma = 1.4826 * np.median(near[:used]) if used else 0.0
    return max(2.5 * sigma, _NOISE_FLOOR)


@njit(cache=True, nogil=True)
def _refit(
    words: NDArray[np.float32], layout: Layout, plane: NDArray[np.float64], tolerance: float, rounds: int
) -> tuple[NDArray[np.float64], int, float]:
    """Fit by moments to the points near the plane, and again to those near the new one; what `_fit` returns."""
    count, variance = 0, 0.0
    for _ in range(rounds):
        sums = moments_near_plane(words, layout, plane, tolerance)
        if sums[0] < 3:
            break
        centroid, spread = covariance(sums)
        variances, axes = principal_axes(spread)
        if variances[1] <= 1e-12 * variances[2]:
            return plane, _ON_A_LINE, 0.0
        centroid += plane[:3] * plane[3]
        new = np.empty(4)
        new[:3] = axes[:, 0]
        new[3] = axes[0, 0] * centroid[0] + axes[1, 0] * centroid[1] + axes[2, 0] * centroid[2]
        plane, count, variance = _facing(new), int(sums[0]), variances[0]
    return plane, count, variance


@njit(cache=True, nogil=True)
def _random(state: int) -> int:
    """The next of a sequence of 63-bit numbers (splitmix64, Steele et al. 2014), the same on every machine."""
    z = np.uint64(state) * np.uint64(0x9E3779B97F4A7C15)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return int((z ^ (z >> np.uint64(31))) >> np.uint64(1))


@njit(cache=True, nogil=True)
def _sample(words: NDArray[np.float32], layout: Layout, seed: int, size: int) -> NDArray[np.float32]:
    """About `size` finite points (K, 4) x y z 0, one at random out of each of `size` equal stretches of the cloud."""
    step, at_x, at_y, at_z = layout
    count = len(words) // step
    sample = np.zeros((min(size, count), 4), np.float32)
    used, high = 0, 0
    for k in range(len(sample)):
        low, high = high, (k + 1) * count // len(sample)
        for attempt in range(4):
            i = low  # of one point there is nothing to choose
            if high - low > 1:
                i += _random((seed + 1) * 0x100000 + 4 * k + attempt) % (high - low)
            x, y, z = words[step * i + at_x], words[step * i + at_y], words[step * i + at_z]
            if math.isfinite(x) and math.isfinite(y) and math.isfinite(z):
                sample[used, 0], sample[used, 1], sample[used, 2] = x, y, z
                used += 1
                break
    if used < min(64, len(sample)):
        return _finite(words, layout)
    return sample[:used]


@njit(cache=True, nogil=True)
def _finite(words: NDArray[np.float32], layout: Layout) -> NDArray[np.float32]:
    """Finite points (K, 4) x y z 0, at most 65536 of them: for clouds that are nearly all holes."""
    step, at_x, at_y, at_z = layout
    found = np.zeros((65536, 4), np.float32)
    used = 0
    for i in range(len(words) // step):
        x, y, z = words[step * i + at_x], words[step * i + at_y], words[step * i + at_z]
        if math.isfinite(x) and math.isfinite(y) and math.isfinite(z) and used < len(found):
            found[used, 0], found[used, 1], found[used, 2] = x, y, z
            used += 1
    return found[:used]


@njit(cache=True, nogil=True)
def _msac(sample: NDArray[np.float32], threshold: float, seed: int, iterations: int) -> NDArray[np.float64]:
    """The plane nx, ny, nz, d through three points of the sample whose truncated squared distances sum up least.

    Hypotheses are tried on all points, 64 at a time, and given up once they cost more than the best so far.
    """
    count = len(sample)
    columns = np.full((3, (count + 63) // 64 * 64), np.inf, np.float32)
    for i in range(count):
        columns[0, i], columns[1, i], columns[2, i] = sample[i, 0], sample[i, 1], sample[i, 2]
    best = np.zeros(4)
    best_cost = np.inf
    limit = np.float32(threshold * threshold)
    needed = float(iterations)
    k = 0
    while k < needed:
        state = (seed + 1) * 0x10000000 + 3 * k
        k += 1
        plane = _through(
            sample[_random(state) % count], sample[_random(state + 1) % count], sample[_random(state + 2) % count]
        )
        if not plane.any():
            continue
        cost = 0.0
        for start in range(0, columns.shape[1], 64):
            cost += _cost(columns, start, plane, limit)
            if cost >= best_cost:
                break
        if cost < best_cost:
            best_cost = cost
            best[:] = plane
            chance = max(1.0 - cost / (float(limit) * columns.shape[1]), 1e-3) ** 3
            if chance > 0.999:
                break
            needed = min(needed, max(math.log(1e-3) / math.log(1.0 - chance), 20.0))
    return best


@njit(cache=True, nogil=True)
def _through(a: NDArray[np.float32], b: NDArray[np.float32], c: NDArray[np.float32]) -> NDArray[np.float64]:
    """nx, ny, nz, d of the plane through three points; zeros where they lie on a line."""
    plane = np.zeros(4)
    ux, uy, uz = float(b[0]) - a[0], float(b[1]) - a[1], float(b[2]) - a[2]
    vx, vy, vz = float(c[0]) - a[0], float(c[1]) - a[1], float(c[2]) - a[2]
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    length = math.sqrt(nx * nx + ny * ny + nz * nz)
    longest = max(ux * ux + uy * uy + uz * uz, vx * vx + vy * vy + vz * vz)
    if length > 1e-6 * longest and longest > 0.0:
        plane[0], plane[1], plane[2] = nx / length, ny / length, nz / length
        plane[3] = plane[0] * a[0] + plane[1] * a[1] + plane[2] * a[2]
    return plane


@njit(cache=True, nogil=True, fastmath={"reassoc", "nsz", "contract"})  # a sum in any order is as good
def _cost(columns: NDArray[np.float32], start: int, plane: NDArray[np.float64], limit: Any) -> Any:
    """Truncated squared distances of 64 points, summed up; a point at infinity costs the limit."""
    nx, ny, nz, d = np.float32(plane[0]), np.float32(plane[1]), np.float32(plane[2]), np.float32(plane[3])
    cost = np.float32(0)
    for i in range(start, start + 64):
        e = nx * columns[0, i] + ny * columns[1, i] + nz * columns[2, i] - d
        cost += e * e if e * e < limit else limit  # noqa: FURB136  min() lets the NaN of a padding point through
    return cost


@njit(cache=True, nogil=True)
def _heights(words: NDArray[np.float32], layout: Layout, plane: NDArray[np.float64], out: NDArray[np.float32]) -> None:
    tile, above = new_tile(), np.empty(TILE, np.float32)
    for start in range(0, len(out), TILE):
        load_tile(words, layout, -1, start, tile)
        _tile_heights(tile, plane, above)
        rest = out[start : start + TILE]
        rest[:] = above[: len(rest)]


@njit(cache=True, nogil=True)
def _near(
    words: NDArray[np.float32], layout: Layout, plane: NDArray[np.float64], limit: Any, out: NDArray[np.bool_]
) -> None:
    tile, near = new_tile(), np.empty(TILE, np.bool_)
    for start in range(0, len(out), TILE):
        _mark_near(words, layout, start, tile, plane, limit, near)
        rest = out[start : start + TILE]
        rest[:] = near[: len(rest)]


@njit(cache=True, nogil=True)
def _take_near(
    words: NDArray[np.float32],
    layout: Layout,
    plane: NDArray[np.float64],
    limit: Any,
    units: NDArray[np.complex128],
    out: NDArray[np.complex128],
) -> int:
    """Copy the points near the plane; returns how many they are."""
    tile, near = new_tile(), np.empty(TILE, np.uint8)
    eights, used = near.view(np.uint64), 0
    for start in range(0, len(units), TILE):
        _mark_near(words, layout, start, tile, plane, limit, near)
        used = append_marked(units, start, near, eights, out, used)
    return used


@njit(cache=True, nogil=True)
def _tile_heights(tile: NDArray[np.float32], plane: NDArray[np.float64], above: NDArray[np.float32]) -> None:
    nx, ny, nz, d = np.float32(plane[0]), np.float32(plane[1]), np.float32(plane[2]), np.float32(plane[3])
    for i in range(TILE):
        above[i] = nx * tile[0, i] + ny * tile[1, i] + nz * tile[2, i] - d


@njit(cache=True, nogil=True)
def _mark_near(
    words: NDArray[np.float32],
    layout: Layout,
    start: int,
    tile: NDArray[np.float32],
    plane: NDArray[np.float64],
    limit: Any,
    near: NDArray[Any],
) -> None:
    """True or 1 for each point of the tile from `start` on that lies within the limit of the plane.

    A full tile of packed points is read where it is, which takes no longer than reading it does; others go by `tile`.
    The fourth word of a point chooses between two limits that are the same: of rows that are read in part the compiler
    would do the last ones of each tile one by one.
    """
    nx, ny, nz, d = np.float32(plane[0]), np.float32(plane[1]), np.float32(plane[2]), np.float32(plane[3])
    if lies_packed(words, layout, start):
        first, same_limit = np.uint64(4 * start), limit if limit >= 0 else d
        for i in range(np.uint64(TILE)):
            k = first + np.uint64(4) * i
            x, y, z, w = words[k], words[k + np.uint64(1)], words[k + np.uint64(2)], words[k + np.uint64(3)]
            near[i] = abs(nx * x + ny * y + nz * z - d) <= (limit if w > d else same_limit)
        return
    load_tile(words, layout, -1, start, tile)
    for i in range(TILE):
        near[i] = abs(nx * tile[0, i] + ny * tile[1, i] + nz * tile[2, i] - d) <= limit


def warm_up() -> None:
    """Compile the kernels of this file."""
    xyz = np.array([[0, 0, 1], [1, 0, 1], [0, 1, 1], [1, 1, 1]], np.float32)
    plane = fit_robust(xyz).plane
    ransac_plane(xyz, 0.01)
    heights(xyz, plane)
    inliers(xyz, plane, 0.01)
    select(np.zeros((1, 2), XYZ), plane, 0.01)
    take(np.zeros((1, 2), [("x", "<f4")]), np.ones((1, 2), np.bool_))
