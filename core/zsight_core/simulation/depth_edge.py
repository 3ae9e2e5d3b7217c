"""Where depth jumps between neighbouring pixels: there real sensors see neither surface well."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from zsight_core.jit import njit

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["JUMP", "depth_around", "warm_up"]

JUMP = 0.02  # of the depth: neighbours farther apart than this lie on different surfaces


def depth_around(depth: NDArray[np.float64]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Least and greatest depth of each pixel and its four neighbours.

    Args:
        depth: (H, W), metres; NaN is a hole.

    Returns:
        Two images (H, W), metres, holes left out; inf and -inf where all five are holes.
    """
    least = np.empty(depth.shape, dtype=np.float32)
    greatest = np.empty(depth.shape, dtype=np.float32)
    _depth_around(depth, least, greatest)
    return least, greatest


def warm_up() -> None:
    """Compile the kernel of this module, or load it from the cache."""
    depth_around(np.ones((2, 2)))


@njit(cache=True, nogil=True)
def _depth_around(depth: Any, least: Any, greatest: Any) -> None:
    height, width = depth.shape
    for v in range(height):
        for u in range(width):
            low, high = np.inf, -np.inf
            for dv, du in ((0, 0), (-1, 0), (1, 0), (0, -1), (0, 1)):
                row, column = min(max(v + dv, 0), height - 1), min(max(u + du, 0), width - 1)
                z = depth[row, column]
                if z < low:  # never true of NaN
                    low = z
                if z > high:
                    high = z
            least[v, u], greatest[v, u] = low, high
