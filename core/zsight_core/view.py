"""A cloud as its sensor saw it: one depth image, a pinhole, and the place of both in the cloud's frame."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from zsight_core.errors import PointsError
from zsight_core.jit import njit
from zsight_core.words import Layout, Words, words_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from zsight_core.points import Points

__all__ = ["View", "see", "warm_up"]

FARTHEST = 60.0
"""Metres; a median range beyond this is taken for another unit."""

VIRTUAL_PIXELS = 300_000
"""An unorganised cloud is drawn into an image of at most this many pixels."""

STRAY = 0.005
"""Share of the points on each side that say nothing of how far a cloud reaches: sensors see some where nothing is."""

_OPTICAL_AXES = (
    np.diag([1.0, 1.0, 1.0]),  # optical: x right, y down, z forward
    np.diag([1.0, -1.0, -1.0]),  # graphics: x right, y up, z backward
    np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]]),  # body: x forward, y left, z up
)


@dataclass(frozen=True, eq=False)
class View:
    """A depth image with its pinhole.

    The optical frame has z forward, x right and y down. Pixel (u, v) looks along ((u - cx) / fx, (v - cy) / fy, 1).
    """

    depth: NDArray[np.float32]
    """(H, W) metres along the optical axis; 0 where nothing was measured."""
    fx: float
    fy: float
    cx: float
    cy: float
    T_cloud_optical: NDArray[np.float64]
    """(4, 4); the identity for a cloud in an optical frame."""
    pixel: NDArray[np.int32] | None = None
    """For a cloud that is no image: (N,) pixel number of each point, or -1; None where pixel and point are one."""

    @property
    def pinhole(self) -> tuple[float, float, float, float]:
        """Focal lengths and centre fx, fy, cx, cy, pixels."""
        return self.fx, self.fy, self.cx, self.cy


def see(points: Points) -> View:
    """The view that a cloud was taken from, read off the cloud itself.

    An organised cloud is a pinhole image in one of the usual axis conventions; its focal lengths and centre follow from
    a straight-line fit of x / z over the columns and y / z over the rows. Any other cloud is drawn into a virtual
    image: from its origin where all points lie before it, else from high above its xy plane, z taken as up.

    Args:
        points: (H, W) cloud, metres.

    Returns:
        The view.

    Raises:
        PointsError: no finite point, or lengths that are not metres.
    """
    words = words_of(points)
    if words.count == 0:
        raise PointsError(f"cloud has shape {points.shape}; expected (height, width) with at least one point")
    if words.shape[0] > 1:
        for R in _OPTICAL_AXES:
            view = _as_pinhole(words, R)
            if view is not None:
                return _checked(view)
    return _checked(_as_virtual(_coordinates(words, np.arange(words.count))))


def warm_up() -> None:
    """Compile the kernels (or load them from their cache)."""
    _depth_of(np.ones(16, np.float32), (4, 0, 1, 2), np.array([0.0, 0.0, 1.0]), 2, 2)
    _draw(np.ones((2, 3)), 1.0, 1.0, 0.0, 0.0, 2, 2)


def _checked(view: View) -> View:
    seen = view.depth[::16, ::16]
    seen = seen[seen > 0]
    if seen.size == 0:
        seen = view.depth[view.depth > 0]
    if seen.size == 0:
        raise PointsError("cloud has no finite point; nothing can be seen in it")
    median = float(np.median(seen))
    if median > FARTHEST:
        raise PointsError(
            f"median range is {median:.0f} m; expected metres, these look like millimetres: divide by 1000"
        )
    return view


def _coordinates(words: Words, points: NDArray[np.int64]) -> NDArray[np.float32]:
    """x, y, z (..., 3) of the points with these numbers."""
    step, *axes = words.layout
    return np.stack([words.words[points * step + axis] for axis in axes], axis=-1)


def _as_pinhole(words: Words, R_optical_cloud: NDArray[np.float64]) -> View | None:
    height, width = words.shape
    rows = np.linspace(0, height - 1, min(height, 30)).astype(np.int64)
    columns = np.linspace(0, width - 1, min(width, 40)).astype(np.int64)
    v, u = np.meshgrid(rows, columns, indexing="ij")
    with np.errstate(invalid="ignore"):  # infinite points are holes
        sample = _coordinates(words, v * width + u).astype(np.float64) @ R_optical_cloud.T
    seen = np.isfinite(sample).all(axis=-1) & (np.abs(sample[..., 2]) > 1e-6)
    if seen.sum() < 12 or (sample[..., 2][seen] > 0).mean() < 0.99:
        return None
    seen &= sample[..., 2] > 0
    x, y = sample[seen][:, 0] / sample[seen][:, 2], sample[seen][:, 1] / sample[seen][:, 2]
    across, down = _line(u[seen], x), _line(v[seen], y)
    if across is None or down is None:
        return None
    fx, cx = 1 / across[0], -across[1] / across[0]
    fy, cy = 1 / down[0], -down[1] / down[0]
    off = np.maximum(np.abs(x * fx + cx - u[seen]), np.abs(y * fy + cy - v[seen]))
    if not (fx > 0 and fy > 0) or (off > 0.3).mean() > 0.05:
        return None
    T = np.eye(4)
    T[:3, :3] = R_optical_cloud.T
    axis = np.ascontiguousarray(R_optical_cloud[2])
    return View(_depth_of(words.words, words.layout, axis, height, width), fx, fy, cx, cy, T)


def _line(at: NDArray[np.int64], value: NDArray[np.float64]) -> tuple[float, float] | None:
    """Slope and intercept of value over at, or None where there is no slope."""
    spread = at - at.mean()
    power = float(spread @ spread)
    if power < 1e-9:
        return None
    slope = float(spread @ value) / power
    return None if abs(slope) < 1e-9 else (slope, float(value.mean() - slope * at.mean()))


def _as_virtual(cloud: NDArray[np.float32]) -> View:
    finite = np.isfinite(cloud).all(axis=1)
    if not finite.any():
        raise PointsError("cloud has no finite point; nothing can be seen in it")
    sample = cloud[finite][:: max(1, int(finite.sum()) // 20_000)].astype(np.float64)
    T = np.eye(4)
    for R in _OPTICAL_AXES[:2]:
        ahead = sample @ R.T
        if ((ahead[:, 2] > 0.1) & (np.abs(ahead[:, :2]) < 2 * ahead[:, 2:]).all(axis=1)).mean() > 1 - STRAY:
            T[:3, :3] = R.T
            break
    else:
        T = _from_above(sample)
    ahead = (sample - T[:3, 3]) @ T[:3, :3]
    ahead = ahead[ahead[:, 2] > 0]
    low, high = _reach(ahead[:, :2] / ahead[:, 2:])
    span = np.maximum(high - low, 1e-3)
    low, span = low - 0.02 * span, 1.04 * span
    pixels = min(float(finite.sum()) * 0.8, VIRTUAL_PIXELS)
    focal = float(np.sqrt(pixels / (span[0] * span[1])))
    width, height = (int(length) for length in np.ceil(np.clip(span * focal, 8, 4096)))
    seen = ((cloud - T[:3, 3]) @ T[:3, :3]).astype(np.float64)
    depth, pixel = _draw(seen, focal, focal, float(-low[0] * focal), float(-low[1] * focal), width, height)
    return View(depth, focal, focal, float(-low[0] * focal), float(-low[1] * focal), T, pixel)


def _reach(rays: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Least and greatest x and y (2,) of rays (N, 2); a few that are far from all others do not count."""
    low, high = np.quantile(rays, STRAY, axis=0), np.quantile(rays, 1 - STRAY, axis=0)
    beyond = (high - low) / 4
    return np.maximum(rays.min(axis=0), low - beyond), np.minimum(rays.max(axis=0), high + beyond)


def _from_above(sample: NDArray[np.float64]) -> NDArray[np.float64]:
    """T_cloud_optical of a camera that looks down on the cloud from far enough to see nearly straight rays."""
    low, high = np.quantile(sample, STRAY, axis=0), np.quantile(sample, 1 - STRAY, axis=0)
    T = np.eye(4)
    T[:3, :3] = np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]])
    T[:3, 3] = [*((low + high)[:2] / 2), high[2] + 2 * max(high[0] - low[0], high[1] - low[1], 0.5)]
    return T


@njit(cache=True, nogil=True)
def _depth_of(
    words: NDArray[np.float32], layout: Layout, axis: NDArray[np.float64], height: int, width: int
) -> NDArray[np.float32]:
    """Distance along axis; 0 where not finite or not positive."""
    step, at_x, at_y, at_z = layout
    depth = np.empty((height, width), np.float32)
    a, b, c = np.float32(axis[0]), np.float32(axis[1]), np.float32(axis[2])
    zero, huge = np.float32(0), np.float32(3e38)
    for v in range(height):
        line = words[v * width * step :]
        row = depth[v]
        if a == 0 and b == 0 and c == 1:  # the usual case needs no x and y
            for u in range(width):
                row[u] = line[u * step + at_z]
        else:
            for u in range(width):
                row[u] = a * line[u * step + at_x] + b * line[u * step + at_y] + c * line[u * step + at_z]
        for u in range(width):  # a loop of its own, that the compiler can do several pixels at a time
            z = row[u]
            row[u] = z if (z > zero) & (z < huge) else zero
    return depth


@njit(cache=True, nogil=True)
def _draw(
    seen: NDArray[np.float64], fx: float, fy: float, cx: float, cy: float, width: int, height: int
) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """Nearest depth a pixel, and the pixel of each point."""
    depth = np.zeros((height, width), np.float32)
    pixel = np.full(len(seen), -1, np.int32)
    for i in range(len(seen)):
        x, y, z = seen[i, 0], seen[i, 1], seen[i, 2]
        if not 0 < z < np.inf:
            continue
        u, v = int(np.floor(fx * x / z + cx + 0.5)), int(np.floor(fy * y / z + cy + 0.5))
        if 0 <= u < width and 0 <= v < height:
            pixel[i] = v * width + u
            if depth[v, u] == 0 or z < depth[v, u]:
                depth[v, u] = z
    return depth, pixel
