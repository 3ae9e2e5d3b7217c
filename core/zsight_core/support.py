"""Support surfaces: the planes that objects stand on.

A plane n . p = d is seen by a pinhole as 1 / z = (n . ray) / d, which is linear over the image, and a structured-light
or stereo camera's noise is the same everywhere in 1 / z. So planes are fitted in inverse depth: one least squares, no
weights. The image is cut into blocks whose moments add up, so that any set of blocks is a fit.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from zsight_core.jit import njit
from zsight_core.transform import inverse

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from zsight_core.view import View

__all__ = ["Support", "find_supports", "outline_of", "warm_up"]

LARGEST_TILT = np.radians(12.0)
"""A support surface leans at most this much from horizontal, once the camera's pose is known."""

SMALLEST_AREA = 0.02
"""Square metres that must be seen of a support surface."""

FURNITURE_AREA = 0.10
"""Square metres from which a raised plane may be a surface of its own and not the top of an object."""

FURNITURE_HEIGHT = 0.35
"""Metres; a plane lower than this above another one, and within its outline, is the top of an object."""

KNOWN_WITHIN = 0.03
"""Metres between a surface and the height where it is said to be."""

MOST_SUPPORTS = 4
MOST_SEEDS = 60
LEAST_COSINE = float(np.cos(np.radians(25.0)))
"""A block of a plane is fitted with a normal at most this far off; blocks are small and noisy."""

SMALLEST_NOISE = 2e-6
"""1/m; the noise of inverse depth is never taken for less: float32 rounds at 1e-7."""


@dataclass(frozen=True, eq=False)
class Support:
    """A plane that objects stand on.

    The support frame has its origin at the centroid of what is seen of the surface, z along the normal (up), and x
    along the cloud's x axis as nearly as the plane allows.
    """

    normal: NDArray[np.float64]
    """(3,) unit normal toward the up side, in the cloud's frame."""
    distance: float
    """Metres; points p of the plane have normal . p = distance, in the cloud's frame."""
    T_camera_support: NDArray[np.float64]
    """(4, 4) the support frame in the cloud's frame."""
    outline: NDArray[np.float64]
    """(K, 2) convex polygon around what is seen, counter-clockwise, metres in the support frame."""
    area: float
    """Square metres within the outline."""
    inliers: int
    """Pixels on the plane."""
    rms: float
    """Metres; root mean square distance of the inliers along the normal."""
    covariance: NDArray[np.float64]
    """(3, 3) of height (m) and tilts about x and y (rad) at the support frame's origin."""
    height: float | None = None
    """Metres; world z of the origin where the camera's pose is known."""


def find_supports(
    view: View, *, up: NDArray[np.float64] | None, known_height: tuple[NDArray[np.float64], float] | None = None
) -> tuple[list[Support], float]:
    """Planes that objects may stand on, best first, and the noise of inverse depth.

    Args:
        view: what the camera saw.
        up: (3,) unit vector in the optical frame, or None where gravity is unknown.
        known_height: direction and offset (n, d) in the optical frame of the plane where the support surface is known
            to be; planes further than KNOWN_WITHIN from it are left out.

    Returns:
        Support surfaces, the highest of the large ones first, and the standard deviation of 1 / z, 1/m.
    """
    size = int(np.clip(view.depth.shape[1] // 80, 3, 8))
    moments, planes = _blocks(view.depth, *view.pinhole, size)
    noise = _noise_of(moments, planes)
    free = planes[..., 3] < max(3 * noise, 3e-5)
    seeds = _seeds(moments, free, noise, up)
    found: list[tuple[NDArray[np.float64], float]] = []
    while len(seeds) and len(found) < 2 * MOST_SUPPORTS:
        plane, members, area = _best_plane(moments, planes, free, seeds, noise, view, size, weigh=up is None)
        if area < SMALLEST_AREA:
            break
        free &= ~members
        found.append((plane, area))
        first = found[0][0]  # further surfaces are parallel to the first one
        cosines = seeds @ first / np.linalg.norm(seeds, axis=1) / np.linalg.norm(first)
        seeds = seeds[cosines > np.cos(np.radians(8.0))]
    return _choose(found, view, noise, size, known_height), noise


def outline_of(xy: NDArray[np.float64]) -> NDArray[np.float64]:
    """Convex hull (K, 2), counter-clockwise, of points (N, 2), by monotone chains (Andrew 1979)."""
    points = xy[np.lexsort((xy[:, 1], xy[:, 0]))]
    points = points[np.append((points[1:] != points[:-1]).any(axis=1), True)] if len(points) else points
    return _hull(points) if len(points) > 2 else points


def area_of(outline: NDArray[np.float64]) -> float:
    """Square metres within a polygon (K, 2)."""
    x, y = outline.T
    return float(abs(x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2)


def warm_up() -> None:
    """Compile the kernels (or load them from their cache)."""
    depth = np.ones((32, 32), np.float32)
    moments, planes = _blocks(depth, 50.0, 50.0, 16.0, 16.0, 8)
    plane = np.array([0.0, 0.0, 1.0])
    free = np.ones((4, 4), np.bool_)
    _votes(moments, planes, free, plane[np.newaxis], 0.01, 0.5, 50.0 * 50.0)
    _solved(_members(moments, planes, free, plane, 0.01, 0.5, 50.0 * 50.0)[0])
    _flat_squares(moments, free, 0.01)
    _refit(depth, 50.0, 50.0, 16.0, 16.0, plane, 0.1, 1)
    _hull(np.array([[0.0, 0.0], [0.5, 1.0], [1.0, 0.0]]))
    _gather(depth, 50.0, 50.0, 16.0, 16.0, plane, 0.1, 4)


def _noise_of(moments: NDArray[np.float64], planes: NDArray[np.float64]) -> float:
    """Standard deviation of 1 / z, 1/m: a low quantile of the residuals of all blocks, most of which are smooth."""
    pixels, residuals = moments[..., 0], planes[..., 3]
    residuals = residuals[(pixels >= 0.9 * pixels.max()) & (residuals < np.inf)]
    if not residuals.size:
        return SMALLEST_NOISE
    middle = int(0.35 * (residuals.size - 1))
    return max(float(np.partition(residuals, middle)[middle]), SMALLEST_NOISE)


def _best_plane(
    moments: NDArray[np.float64],
    planes: NDArray[np.float64],
    free: NDArray[np.bool_],
    seeds: NDArray[np.float64],
    noise: float,
    view: View,
    size: int,
    *,
    weigh: bool,
) -> tuple[NDArray[np.float64], NDArray[np.bool_], float]:
    """The plane that gathers most area of free blocks: the seeds vote, the best is refitted to its blocks."""
    gate = 3 * noise + 0.002
    per_pixel = size * size / (view.fx * view.fy)
    areas = _votes(moments, planes, free, seeds, gate, LEAST_COSINE, per_pixel)
    plane = seeds[int(np.argmax(areas * _plausibility(seeds) if weigh else areas))]
    for _ in range(3):
        sums, members, area = _members(moments, planes, free, plane, gate, LEAST_COSINE, per_pixel)
        refitted = _solve(sums)
        if refitted is None:
            return plane, members, 0.0
        plane = refitted
    return plane, members, area


def _seeds(
    moments: NDArray[np.float64], free: NDArray[np.bool_], noise: float, up: NDArray[np.float64] | None
) -> NDArray[np.float64]:
    """Planes (S, 3) of flat squares of 4 x 4 blocks, near horizontal where up is known; at most MOST_SEEDS of them."""
    seeds = _flat_squares(moments, free, 2 * noise + 0.001)
    if up is not None:
        normals = -seeds / np.linalg.norm(seeds, axis=1, keepdims=True)
        seeds = seeds[normals @ up > np.cos(LARGEST_TILT + np.radians(3.0))]
    else:
        seeds = seeds[_plausibility(seeds) > 0]
    return seeds[np.linspace(0, len(seeds) - 1, min(len(seeds), MOST_SEEDS)).astype(np.int64)]


def _plausibility(planes: NDArray[np.float64]) -> NDArray[np.float64]:
    """How likely (0..1) a plane carries objects when gravity is unknown: cameras are held upright and look down."""
    normals = -planes / np.linalg.norm(planes, axis=1, keepdims=True)
    upward = np.clip(-normals[:, 1], 0.0, 1.0)
    return np.where(upward > 0.2, 1.0, 0.3 + 3.5 * upward)


def _choose(
    found: list[tuple[NDArray[np.float64], float]],
    view: View,
    noise: float,
    size: int,
    known_height: tuple[NDArray[np.float64], float] | None,
) -> list[Support]:
    """Surfaces out of planes: parallel to the first one, large, and not the top of an object on another one."""
    chosen: list[Support] = []
    found_planes: list[NDArray[np.float64]] = []
    for plane, area in found:
        if any(_repeats(plane, other) or _is_low_and_small(plane, other, area) for other in found_planes):
            continue
        support = _support(plane, view, noise, size)
        if support is None or support.area < SMALLEST_AREA:
            continue
        found_planes.append(plane)
        if known_height is not None:
            centre = inverse(view.T_cloud_optical) @ support.T_camera_support[:, 3]
            if abs(known_height[0] @ centre[:3] - known_height[1]) > KNOWN_WITHIN:
                continue
        elif not all(_stands_apart(support, other, area) for other in chosen):
            continue
        chosen.append(support)
        if len(chosen) == MOST_SUPPORTS:
            break
    return _highest_first(chosen)


def _highest_first(supports: list[Support]) -> list[Support]:
    """A table before the floor it stands on, unless it is a small piece beside it."""
    if not supports:
        return supports
    most = max(support.inliers for support in supports)
    up = supports[0].normal

    def rank(support: Support) -> tuple[bool, float]:
        return support.inliers < 0.15 * most, -float(up @ support.T_camera_support[:3, 3])

    return sorted(supports, key=rank)


def _repeats(plane: NDArray[np.float64], other: NDArray[np.float64]) -> bool:
    """True for what noise and distortion leave over of a plane that was found before."""
    gap = abs(1 / np.linalg.norm(plane) - 1 / np.linalg.norm(other))
    return bool(gap < 0.02 and plane @ other > np.cos(np.radians(3.0)) * np.linalg.norm(plane) * np.linalg.norm(other))


def _is_low_and_small(plane: NDArray[np.float64], other: NDArray[np.float64], area: float) -> bool:
    """True for the top of an object, told before the costly fit to pixels."""
    above = 1 / np.linalg.norm(other) - 1 / np.linalg.norm(plane)
    return bool(0 < above < FURNITURE_HEIGHT and area < 0.8 * FURNITURE_AREA)


def _stands_apart(support: Support, other: Support, area: float) -> bool:
    """True for a surface parallel to the other one and either beside it or far above or below."""
    if support.normal @ other.normal < np.cos(np.radians(5.0)):
        return False
    centre = support.T_camera_support[:3, 3]
    above = float(other.normal @ centre - other.distance)
    if abs(above) < 0.012 or (above < 0 and area < 2 * SMALLEST_AREA):
        return False
    return not (0 < above < FURNITURE_HEIGHT and (area < FURNITURE_AREA or _within(centre, other)))


def _within(point: NDArray[np.float64], support: Support) -> bool:
    """True where the point (3,), cloud frame, stands over the outline."""
    xy = (inverse(support.T_camera_support) @ np.append(point, 1.0))[:2]
    corners = support.outline
    following = np.roll(corners, -1, axis=0)
    return bool((_cross(following - corners, xy - corners) >= 0).all())


def _support(plane: NDArray[np.float64], view: View, noise: float, size: int) -> Support | None:
    """The surface on a plane: refitted to pixels, framed, outlined."""
    for gate, step in ((4 * noise + 0.002, 3), (3 * noise + 2e-5, 2), (3 * noise + 2e-5, 1)):
        moments = _refit(view.depth, *view.pinhole, plane, gate, step)
        refitted = _solve(moments)
        if refitted is None or moments[0] < 50:
            return None
        plane = refitted
    spread = max(_residual(moments, plane), noise)
    points = _gather(view.depth, *view.pinhole, plane, 3 * noise + 2e-5, size)
    if len(points) < 3:
        return None
    normal, distance = _up_side(plane)
    T_optical_support = _frame(normal, distance, points.mean(axis=0), view)
    ends = points[_row_ends(points)]
    outline = outline_of((ends - T_optical_support[:3, 3]) @ T_optical_support[:3, :2])
    if len(outline) < 3:
        return None
    T = view.T_cloud_optical @ T_optical_support
    covariance = _covariance(moments, plane, spread, T_optical_support)
    rms = spread * float(np.mean(points[:, 2] ** 2)) * float(np.mean(np.abs(points @ normal / points[:, 2])))
    return Support(T[:3, 2], float(T[:3, 2] @ T[:3, 3]), T, outline, area_of(outline), int(moments[0]), rms, covariance)


def _cross(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Cross products (N,) of vectors (N, 2)."""
    product: NDArray[np.float64] = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    return product


def _row_ends(points: NDArray[np.float64]) -> NDArray[np.intp]:
    """First and last point of each image row; the hull needs no others."""
    row = points[:, 1] / points[:, 2]
    first = np.flatnonzero(np.diff(row, prepend=-np.inf) > 1e-9)
    return np.concatenate([first, np.append(first[1:] - 1, len(points) - 1)])


def _frame(
    normal: NDArray[np.float64], distance: float, centroid: NDArray[np.float64], view: View
) -> NDArray[np.float64]:
    """T_optical_support (4, 4)."""
    towards = view.T_cloud_optical[0, :3]  # the cloud's x axis in the optical frame
    x = towards - (towards @ normal) * normal
    if np.linalg.norm(x) < 0.3:
        towards = view.T_cloud_optical[1, :3]
        x = towards - (towards @ normal) * normal
    x /= np.linalg.norm(x)
    T = np.eye(4)
    T[:3, 0], T[:3, 2] = x, normal
    for a in range(3):  # the product of both; numpy's takes as long as a pass over the image
        b, c = (a + 1) % 3, (a + 2) % 3
        T[a, 1] = normal[b] * x[c] - normal[c] * x[b]
    T[:3, 3] = centroid - (normal @ centroid - distance) * normal
    return T


def _covariance(
    moments: NDArray[np.float64], plane: NDArray[np.float64], spread: float, T_optical_support: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Of height, tilt about x and tilt about y, from the normal equations in inverse depth."""
    information = _normal_matrix(moments)
    cov_plane = np.linalg.pinv(information) * spread**2
    length = float(np.linalg.norm(plane))
    normal, origin = T_optical_support[:3, 2], T_optical_support[:3, 3]
    # a change of the plane's three numbers moves the surface at p by -(change . p) / length along its normal
    sign = 1.0 if plane @ normal > 0 else -1.0
    rows = np.stack([-sign * origin, -sign * T_optical_support[:3, 1], sign * T_optical_support[:3, 0]]) / length
    covariance: NDArray[np.float64] = rows @ cov_plane @ rows.T
    return covariance


def _up_side(plane: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
    """Normal toward the camera and distance of the plane (A, B, C) with A x + B y + C z = 1."""
    length = float(np.linalg.norm(plane))
    return -plane / length, -1.0 / length


def _normal_matrix(moments: NDArray[np.float64]) -> NDArray[np.float64]:
    n, x, y, xx, xy, yy = moments[:6]
    return np.array([[xx, xy, x], [xy, yy, y], [x, y, n]])


def _solve(moments: NDArray[np.float64]) -> NDArray[np.float64] | None:
    """Plane (A, B, C) of summed moments; None where they do not determine one."""
    plane: NDArray[np.float64] = _solved(moments)
    return plane if np.isfinite(plane).all() and plane @ plane > 1e-6 else None


def _residual(moments: NDArray[np.float64], plane: NDArray[np.float64]) -> float:
    """Root mean square residual, 1/m."""
    left = moments[9] - plane @ moments[[7, 8, 6]]
    return float(np.sqrt(max(left, 0.0) / moments[0]))


@njit(cache=True, nogil=True, error_model="numpy")
def _solved(moments: NDArray[np.float64]) -> NDArray[np.float64]:
    """Plane (3,) of summed moments about their mean; not finite where they do not determine one."""
    n, plane = moments[0], np.full(3, np.nan)
    if n < 3:
        return plane
    x, y, w = moments[1] / n, moments[2] / n, moments[6] / n
    a, b, d = moments[3] / n - x * x, moments[4] / n - x * y, moments[5] / n - y * y
    p, q = moments[7] / n - x * w, moments[8] / n - y * w
    det = a * d - b * b  # of the matrix of moments, a share
    if abs(det) >= 1e-12:
        plane[0], plane[1] = (d * p - b * q) / det, (a * q - b * p) / det
        plane[2] = w - plane[0] * x - plane[1] * y
    return plane


@njit(cache=True, nogil=True, error_model="numpy")
def _hull(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Convex hull (K, 2), counter-clockwise, of points (N, 2) sorted by x, then y."""
    hull = np.empty((2 * len(points) + 1, 2))
    size, floor = 0, 0
    for turn in range(2):
        for k in range(len(points)):
            p = points[k] if turn == 0 else points[len(points) - 1 - k]
            while size - floor > 1:
                ax, ay = hull[size - 1, 0] - hull[size - 2, 0], hull[size - 1, 1] - hull[size - 2, 1]
                if ax * (p[1] - hull[size - 2, 1]) - ay * (p[0] - hull[size - 2, 0]) > 0:
                    break
                size -= 1
            hull[size] = p
            size += 1
        size -= 1  # the last point begins the other chain
        floor = size
    return hull[:size]


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"reassoc", "nsz", "contract"})  # sums in any order
def _blocks(
    depth: NDArray[np.float32], fx: float, fy: float, cx: float, cy: float, size: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Moments (R, C, 10): n x y xx xy yy w wx wy ww of rays (x, y) and w = 1 / z; planes (R, C, 4): A B C residual."""
    rows, columns = depth.shape[0] // size, depth.shape[1] // size
    moments = np.zeros((rows, columns, 10))
    planes = np.full((rows, columns, 4), np.inf)
    middle, per_u, one = (size - 1) / 2, 1.0 / fx, np.float32(1)
    for r in range(rows):
        for c in range(columns):
            # about the block's own centre and inverse depth, so that nothing cancels
            x0, y0 = ((c + 0.5) * size - 0.5 - cx) / fx, ((r + 0.5) * size - 0.5 - cy) / fy
            n, sx, sy, sxx, sxy, syy, sw, swx, swy, sww = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            for j in range(size):
                y = (r * size + j - cy) / fy - y0
                line = depth[r * size + j, c * size : (c + 1) * size]
                m, mx, mxx, mw, mwx = 0.0, 0.0, 0.0, 0.0, 0.0
                for i in range(size):  # no way out of it: the compiler does several pixels at a time
                    on = line[i] > 0
                    x = (i - middle) * per_u if on else 0.0
                    w = np.float64(one / line[i]) if on else 0.0
                    m += 1.0 if on else 0.0
                    mx += x
                    mxx += x * x
                    mw += w
                    mwx += w * x
                    sww += w * w
                n, sx, sxx, sw, swx = n + m, sx + mx, sxx + mxx, sw + mw, swx + mwx
                sy, sxy, syy, swy = sy + m * y, sxy + mx * y, syy + m * y * y, swy + mw * y
            if n * 2 < size * size:
                continue
            mx, my, mw = sx / n, sy / n, sw / n
            a, b, d = sxx - n * mx * mx, sxy - n * mx * my, syy - n * my * my
            p, q = swx - n * mx * mw, swy - n * my * mw
            det = a * d - b * b
            if det > 1e-3 * a * d:
                A, B = (d * p - b * q) / det, (a * q - b * p) / det
                left = sww - n * mw * mw - A * p - B * q
                planes[r, c, 0], planes[r, c, 1] = A, B
                planes[r, c, 2] = mw - A * (mx + x0) - B * (my + y0)
                planes[r, c, 3] = np.sqrt(max(left, 0.0) / max(n - 3, 1))
            m = moments[r, c]
            m[0], m[1], m[2] = n, sx + n * x0, sy + n * y0
            m[3] = sxx + 2 * x0 * sx + n * x0 * x0
            m[4] = sxy + x0 * sy + y0 * sx + n * x0 * y0
            m[5] = syy + 2 * y0 * sy + n * y0 * y0
            m[6], m[7], m[8], m[9] = sw, swx + x0 * sw, swy + y0 * sw, sww
    return moments, planes


@njit(cache=True, nogil=True, error_model="numpy")
def _flat_squares(moments: NDArray[np.float64], free: NDArray[np.bool_], gate: float) -> NDArray[np.float64]:
    """Planes (S, 3) of those squares of 4 x 4 blocks, half of them free, whose residual is below gate, 1/m."""
    rows, columns = moments.shape[0] // 4, moments.shape[1] // 4
    seeds = np.empty((rows * columns, 3))
    count = 0
    for r in range(rows):
        for c in range(columns):
            m = np.zeros(10)
            blocks = 0
            for j in range(4):
                for i in range(4):
                    if free[4 * r + j, 4 * c + i]:
                        blocks += 1
                        m += moments[4 * r + j, 4 * c + i]
            if blocks < 8:
                continue
            n = m[0]
            x, y, w = m[1] / n, m[2] / n, m[6] / n
            a, b, d = m[3] / n - x * x, m[4] / n - x * y, m[5] / n - y * y
            p, q = m[7] / n - x * w, m[8] / n - y * w
            det = a * d - b * b
            if det <= 1e-3 * a * d:
                continue
            A, B = (d * p - b * q) / det, (a * q - b * p) / det
            left = m[9] / n - w * w - A * p - B * q
            if left < gate * gate:
                seeds[count, 0], seeds[count, 1], seeds[count, 2] = A, B, w - A * x - B * y
                count += 1
    return seeds[:count]


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"reassoc", "nsz", "contract"})  # sums in any order
def _votes(
    moments: NDArray[np.float64],
    planes: NDArray[np.float64],
    free: NDArray[np.bool_],
    seeds: NDArray[np.float64],
    gate: float,
    least_cosine: float,
    per_pixel: float,
) -> NDArray[np.float64]:
    """Square metres of every second free block of every second row on each seed plane (S,)."""
    rows, columns = free.shape
    areas = np.zeros(len(seeds))
    blocks = np.empty((6, (rows // 2 + 1) * (columns // 2 + 1)))  # x, y, w and unit normal
    count = 0
    for r in range(0, rows, 2):
        for c in range(0, columns, 2):
            if free[r, c]:
                n, a, b, k = moments[r, c, 0], planes[r, c, 0], planes[r, c, 1], planes[r, c, 2]
                length = np.sqrt(a * a + b * b + k * k)
                blocks[0, count], blocks[1, count] = moments[r, c, 1] / n, moments[r, c, 2] / n
                blocks[2, count] = moments[r, c, 6] / n
                blocks[3, count], blocks[4, count], blocks[5, count] = a / length, b / length, k / length
                count += 1
    for s in range(len(seeds)):
        A, B, C = seeds[s, 0], seeds[s, 1], seeds[s, 2]
        length = np.sqrt(A * A + B * B + C * C)
        least, slant, area = least_cosine * length, 1.0 / length, 0.0
        for i in range(count):  # no way out of it: the compiler does several blocks at a time
            w, expected = blocks[2, i], A * blocks[0, i] + B * blocks[1, i] + C
            facing = blocks[3, i] * A + blocks[4, i] * B + blocks[5, i] * C
            on = (abs(w - expected) <= gate) & (facing >= least)
            area += 1.0 / (w * w * max(expected * slant, 0.1)) if on else 0.0
        areas[s] = area * per_pixel
    return areas


@njit(cache=True, nogil=True, error_model="numpy")
def _members(
    moments: NDArray[np.float64],
    planes: NDArray[np.float64],
    free: NDArray[np.bool_],
    plane: NDArray[np.float64],
    gate: float,
    least_cosine: float,
    per_pixel: float,
) -> tuple[NDArray[np.float64], NDArray[np.bool_], float]:
    """Summed moments (10,) of the free blocks on a plane, which they are, and their square metres."""
    rows, columns = free.shape
    sums, members, area = np.zeros(10), np.zeros((rows, columns), np.bool_), 0.0
    A, B, C = plane[0], plane[1], plane[2]
    length = np.sqrt(A * A + B * B + C * C)
    for r in range(rows):
        for c in range(columns):
            if not free[r, c]:
                continue
            n, a, b, k = moments[r, c, 0], planes[r, c, 0], planes[r, c, 1], planes[r, c, 2]
            w, expected = moments[r, c, 6] / n, (A * moments[r, c, 1] + B * moments[r, c, 2]) / n + C
            facing, least = A * a + B * b + C * k, least_cosine * length * np.sqrt(a * a + b * b + k * k)
            if abs(w - expected) > gate or facing < least:
                continue
            members[r, c] = True
            area += per_pixel / (w * w * max(expected / length, 0.1))
            for m in range(10):
                sums[m] += moments[r, c, m]
    return sums, members, area


@njit(
    cache=True, nogil=True, error_model="numpy", fastmath={"reassoc", "nsz", "contract"}
)  # sums in any order; no division check
def _refit(
    depth: NDArray[np.float32],
    fx: float,
    fy: float,
    cx: float,
    cy: float,
    plane: NDArray[np.float64],
    gate: float,
    step: int,
) -> NDArray[np.float64]:
    """Moments (10,) of the pixels of every step-th row and column whose inverse depth is within gate of the plane's."""
    m = np.zeros(10)
    A, B, C, one = plane[0], plane[1], plane[2], np.float32(1)
    for v in range(0, depth.shape[0], step):
        y = (v - cy) / fy
        n, sx, sxx, sw, swx, sww = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for u in range(0, depth.shape[1], step):
            x = (u - cx) / fx
            measured = np.float64(one / depth[v, u])  # in single precision, which is that of the depth
            on = abs(measured - (A * x + B * y + C)) < gate  # false for infinity, where nothing was measured
            w = measured if on else 0.0
            x = x if on else 0.0
            n += 1.0 if on else 0.0
            sx += x
            sxx += x * x
            sw += w
            swx += w * x
            sww += w * w
        m[0] += n
        m[1] += sx
        m[2] += n * y
        m[3] += sxx
        m[4] += sx * y
        m[5] += n * y * y
        m[6] += sw
        m[7] += swx
        m[8] += sw * y
        m[9] += sww
    return m


@njit(cache=True, nogil=True, error_model="numpy")
def _gather(
    depth: NDArray[np.float32],
    fx: float,
    fy: float,
    cx: float,
    cy: float,
    plane: NDArray[np.float64],
    gate: float,
    step: int,
) -> NDArray[np.float64]:
    """Points (N, 3), optical frame, metres, of every step-th pixel on the plane whose neighbours are on it too."""
    points = np.empty(((depth.shape[0] // step + 1) * (depth.shape[1] // step + 1), 3))
    count = 0
    for v in range(step // 2, depth.shape[0] - 1, step):
        for u in range(step // 2, depth.shape[1] - 1, step):
            on = 0
            for dv in range(-1, 2):
                for du in range(-1, 2):
                    if v + dv >= 0 and u + du >= 0:
                        z = depth[v + dv, u + du]
                        if z > 0:
                            x, y = (u + du - cx) / fx, (v + dv - cy) / fy
                            if abs(1.0 / z - (plane[0] * x + plane[1] * y + plane[2])) < gate:
                                on += 1
            if on >= 6 and depth[v, u] > 0:
                x, y = (u - cx) / fx, (v - cy) / fy
                z = 1.0 / (plane[0] * x + plane[1] * y + plane[2])
                points[count, 0], points[count, 1], points[count, 2] = x * z, y * z, z
                count += 1
    return points[:count]
