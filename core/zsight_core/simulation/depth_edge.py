"""Where depth jumps between neighbouring pixels: there real sensors see neither surface well."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

__all__ = ["JUMP", "depth_around"]

JUMP = 0.02  # of the depth: neighbours farther apart than this lie on different surfaces


@njit(cache=True, nogil=True, inline="always")
def depth_around(depth: Any, v: int, u: int) -> tuple[float, float]:
    """Least and greatest depth of a pixel and its four neighbours, leaving out holes; (inf, -inf) if all are holes."""
    height, width = depth.shape
    least, greatest = np.inf, -np.inf
    for dv, du in ((0, 0), (-1, 0), (1, 0), (0, -1), (0, 1)):
        if 0 <= v + dv < height and 0 <= u + du < width:
            z = depth[v + dv, u + du]
            if z < least:
                least = z
            if z > greatest:
                greatest = z
    return least, greatest
