"""Corners and edges of boxes."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["corners_of", "edges_of"]


def corners_of(low: NDArray[np.floating], high: NDArray[np.floating]) -> NDArray[np.float64]:
    """(8, 3) of a box from its low and high corner (3,); bit i of the row number says which end of axis i."""
    rows = np.arange(8)[:, np.newaxis] >> np.arange(3) & 1
    return np.where(rows, high, low).astype(np.float64)


def edges_of(corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """(12, 2, 3) ends of the edges between the corners (8, 3) of a box."""
    return np.array([(corners[a], corners[b]) for a in range(8) for b in range(a) if (a ^ b).bit_count() == 1])
