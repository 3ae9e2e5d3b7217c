"""A cloud read tile by tile: the x, y, z of 256 points side by side, so that one instruction works on many of them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from zsight_core.jit import njit

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from zsight_core.words import Layout

__all__ = ["TILE", "lies_packed", "load_tile", "new_tile", "warm_up"]

TILE = 256
"""Points in a tile: 4 KB, a small part of the nearest cache."""


@njit(cache=True, nogil=True)
def new_tile() -> NDArray[np.float32]:
    """Room for a tile: float32 (4, TILE), rows x, y, z and the fourth word of the layout (a colour)."""
    return np.empty((4, TILE), np.float32)


@njit(cache=True, nogil=True)
def lies_packed(words: NDArray[np.float32], layout: Layout, start: int) -> bool:
    """True where a full tile of points from `start` on lies there in rows of four words, x, y, z the first of them."""
    packed = layout[0] == 4 and layout[1] == 0 and layout[2] == 1 and layout[3] == 2
    return packed and 4 * (start + TILE) <= len(words)


@njit(cache=True, nogil=True)
def load_tile(words: NDArray[np.float32], layout: Layout, colour: int, start: int, tile: NDArray[np.float32]) -> None:
    """Fill the tile with the points from `start` on; behind the last point with holes.

    Row 3 gets word `colour` of each point, its bits as they are; with a negative `colour` anything.

    Taking all four words of a packed point at once is what lets the compiler turn rows into columns in registers, at
    the speed of the memory; reading three of them, or one after the other, is two to five times slower.
    """
    step, at_x, at_y, at_z = layout
    at_w = max(colour, 0)
    if lies_packed(words, layout, start) and (colour == 3 or colour < 0):
        first = np.uint64(4 * start)  # places, not a part of the array: that would count who refers to it, every tile
        for i in range(np.uint64(TILE)):
            k = first + np.uint64(4) * i
            tile[0, i] = words[k]
            tile[1, i] = words[k + np.uint64(1)]
            tile[2, i] = words[k + np.uint64(2)]
            tile[3, i] = words[k + np.uint64(3)]
        return
    length = min(TILE, len(words) // step - start)
    first = np.uint64(step * start)
    x, y, z, w = np.uint64(at_x), np.uint64(at_y), np.uint64(at_z), np.uint64(at_w)
    for i in range(np.uint64(length)):
        k = first + np.uint64(step) * i
        tile[0, i] = words[k + x]
        tile[1, i] = words[k + y]
        tile[2, i] = words[k + z]
        tile[3, i] = words[k + w]
    for i in range(length, TILE):
        tile[0, i] = np.nan
        tile[1, i] = np.nan
        tile[2, i] = np.nan
        tile[3, i] = np.float32(0)


def warm_up() -> None:
    """Compile the kernels of this file."""
    load_tile(np.zeros(16, np.float32), (4, 0, 1, 2), 3, 0, new_tile())
