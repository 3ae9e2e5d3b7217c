"""Clouds of depth cameras as what was measured: a 16-bit depth image and colours, in a third of the bytes."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from zsight_core import depth_image
from zsight_core.jit import njit
from zsight_core.pinhole import Pinhole
from zsight_core.points import XYZ, XYZRGB, has_colour, is_organised

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from zsight_core.points import Points

__all__ = ["SCALES", "code", "decode", "warm_up"]

SCALES = (0.0001, 0.00025)
"""Metres a unit: up to 6.5 m, up to 16 m."""


def code(points: Points, pinhole: Pinhole) -> tuple[NDArray[np.uint16], NDArray[np.uint8] | None, float] | None:
    """The depth image and the colours of a cloud.

    Args:
        points: (H, W), XYZ or XYZRGB, in the camera's optical frame, metres.
        pinhole: the camera, without distortion.

    Returns:
        Depth (H, W), 0 where nothing was measured; colour (H, W, 3), red green blue, None without; metres a unit. None
        where the cloud would not come back within one unit on every axis: it is not that camera's, was moved, or
        holds more than these.
    """
    if not is_organised(points) or points.dtype not in (XYZ, XYZRGB) or not points.flags.c_contiguous:
        return None
    if points.shape != (pinhole.height, pinhole.width) or pinhole.distortion is not None:
        return None
    words = points.view(np.dtype("<f4")).reshape(*points.shape, 4)
    depth = np.empty(points.shape, np.uint16)
    colour = np.empty((*points.shape, 3), np.uint8)
    for scale in SCALES:
        worst = _quantised(words, pinhole.fx, pinhole.fy, pinhole.cx, pinhole.cy, scale, depth)
        if worst <= scale:
            if not has_colour(points):
                return depth, None, scale
            return (depth, colour, scale) if _unpacked(words.view(np.uint32), colour) else None
    return None


def decode(depth: NDArray[np.uint16], colour: NDArray[np.uint8] | None, pinhole: Pinhole, scale: float) -> Points:
    """The cloud (H, W) of a coded one; coded again it gives the same depth."""
    return depth_image.to_points(depth, pinhole, depth_scale=scale, colour=colour)


@njit(cache=True, nogil=True)
def _quantised(
    words: NDArray[np.float32], fx: float, fy: float, cx: float, cy: float, scale: float, depth: NDArray[np.uint16]
) -> float:
    """Fill the depth; the largest error of any coordinate, metres, infinite where the cloud is no depth image's."""
    worst = 0.0
    largest = 65535 * scale
    for v in range(words.shape[0]):
        ray_y = (v - cy) / fy
        for u in range(words.shape[1]):
            x, y, z = words[v, u, 0], words[v, u, 1], words[v, u, 2]
            if np.isnan(z):
                if not (np.isnan(x) and np.isnan(y)):
                    return np.inf
                depth[v, u] = 0
                continue
            if not 0.5 * scale < z < largest:
                return np.inf
            unit = int(z / scale + 0.5)
            depth[v, u] = unit
            back = unit * scale
            error = max(abs(z - back), abs(x - (u - cx) / fx * back), abs(y - ray_y * back))
            if not error <= scale:
                return np.inf
            worst = max(worst, error)
    return worst


@njit(cache=True, nogil=True)
def _unpacked(words: NDArray[np.uint32], colour: NDArray[np.uint8]) -> bool:
    """Fill the colours; false where a pixel has more than red, green and blue."""
    for v in range(words.shape[0]):
        for u in range(words.shape[1]):
            packed = words[v, u, 3]
            if packed >> 24:
                return False
            colour[v, u, 0] = packed >> 16
            colour[v, u, 1] = packed >> 8 & 255
            colour[v, u, 2] = packed & 255
    return True


def warm_up() -> None:
    """Compile the kernels, or load them from the cache."""
    for dtype in (XYZ, XYZRGB):
        code(np.zeros((2, 2), dtype), Pinhole(2, 2, 1.0, 1.0, 0.5, 0.5))
    points = np.zeros((2, 2), XYZRGB)
    points["z"] = 1.0
    code(points, Pinhole(2, 2, 1e9, 1e9, 0.5, 0.5))
