"""Fewer points of a cloud for the eye: every so manieth, no holes."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from zsight_core.points import Points, is_organised, xyz

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["thin"]


def thin(points: Points, most: int) -> tuple[Points, NDArray[np.float32]]:
    """At most so many points of a cloud, evenly taken, without holes.

    Args:
        points: (H, W); of an image whole rows and columns are left out, of another cloud single points.
        most: points at most, at least 1.

    Returns:
        Points (M,), and their coordinates (M, 3), metres.
    """
    if is_organised(points):
        some = points
        down, across = 1, 1
        while some.size > most:
            down, across = (down + 1, across) if down < across else (down, across + 1)
            some = points[::down, ::across]
    else:
        some = points[:, :: max(1, math.ceil(points.size / most))]
    coordinates = xyz(some).reshape(-1, 3)
    whole = np.isfinite(coordinates).all(axis=1)
    return some.reshape(-1)[whole], coordinates[whole]
