"""Points sorted into the cells of a grid, so that what lies near a point is found without looking at all."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numba import njit

from zsight_core.errors import GeometryError
from zsight_core.words import words_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from zsight_core.words import Layout, Words

__all__ = ["NeighbourGrid", "block_around", "cell_at", "cell_key", "cell_of", "grid_of", "warm_up"]

_REACH = 2**20
"""Cell numbers along an axis lie in -REACH .. REACH-1, so that three of them fit one 64-bit key."""


@dataclass(frozen=True)
class NeighbourGrid:
    """Cells in the order of their first point; 16 bytes a point are held.

    ``xyz`` float32 (N, 3), cell after cell; ``order`` int32 (N,) which of the points given each of them is; ``starts``
    int32 (C + 1,) where each cell begins; ``keys`` int64 (C,) `cell_key` of each; ``table`` int32, an open hash table
    of cell numbers, -1 where free, its length a power of two; ``edge`` metres.
    """

    xyz: NDArray[np.float32]
    order: NDArray[np.int32]
    starts: NDArray[np.int32]
    keys: NDArray[np.int64]
    table: NDArray[np.int32]
    edge: float

    @property
    def cells(self) -> int:
        """How many cells hold a point."""
        return len(self.keys)


def grid_of(cloud: Words, edge: float, mask: NDArray[np.bool_] | None = None) -> NeighbourGrid:
    """Sort the finite points of a cloud into cells.

    Args:
        cloud: points.
        edge: of a cell, metres.
        mask: (N,) the points that take part; None: all.

    Raises:
        GeometryError: a point lies 2^20 cells or more from the origin.
    """
    chosen = np.ones(1, np.bool_) if mask is None else mask
    room = np.empty((cloud.count, 3), np.float32)
    cell = room.reshape(-1)[: cloud.count].view(
        np.int32
    )  # in the same memory: nobody needs it once points are gathered
    keys, table = _cells_of(cloud.words, cloud.layout, 1.0 / edge, chosen, cell)
    if len(keys) == 1 and keys[0] < 0:
        raise GeometryError(f"cells of {edge} m are too small for coordinates so far from the origin; use larger ones")
    starts, order = _order(cell, len(keys))
    xyz = room[: len(order)]
    _gather(cloud.words, cloud.layout, order, xyz)
    return NeighbourGrid(xyz, order, starts, keys, table, edge)


@njit(cache=True, nogil=True)
def cell_key(x: int, y: int, z: int) -> int:
    """One number for a cell, x fastest."""
    return ((z + _REACH) << 42) | ((y + _REACH) << 21) | (x + _REACH)


@njit(cache=True, nogil=True)
def cell_of(coordinate: float, inverse: float) -> int:
    """Number of a cell along an axis; `inverse` of the edge."""
    return int(np.floor(coordinate * inverse))


@njit(cache=True, nogil=True)
def cell_at(keys: NDArray[np.int64], table: NDArray[np.int32], key: int) -> int:
    """The cell with this key, -1 where it holds no point."""
    return int(table[_place(keys, table, key)])


@njit(cache=True, nogil=True)
def block_around(
    xyz: NDArray[np.float32],
    starts: NDArray[np.int32],
    keys: NDArray[np.int64],
    table: NDArray[np.int32],
    cell: int,
    room: NDArray[np.float32],
) -> tuple[NDArray[np.float32], int]:
    """The points of a cell and of the 26 cells around it side by side: (3, M) of which the first so many count.

    Args:
        xyz: points of the `NeighbourGrid`.
        starts: its beginnings of cells.
        keys: its keys.
        table: its table.
        cell: number of the cell in the middle.
        room: (3, M) of the last call, or anything: used again if it is large enough.
    """
    around = np.empty(27, np.int64)
    count = 0
    for step in range(27):
        x, y, z = step % 3 - 1, step // 3 % 3 - 1, step // 9 - 1
        around[step] = cell_at(keys, table, keys[cell] + x + (y << 21) + (z << 42))
        if around[step] >= 0:
            count += starts[around[step] + 1] - starts[around[step]]
    if count > room.shape[1]:
        room = np.empty((3, 2 * count), np.float32)
    used = 0
    for near in around:
        if near >= 0:
            for i in range(starts[near], starts[near + 1]):
                room[0, used], room[1, used], room[2, used] = xyz[i, 0], xyz[i, 1], xyz[i, 2]
                used += 1
    return room, count


@njit(cache=True, nogil=True)
def _place(keys: NDArray[np.int64], table: NDArray[np.int32], key: int) -> int:
    """Where the key stands in the table, or the free place where it belongs."""
    mask = len(table) - 1
    place: int = int(np.int64((np.uint64(key) * np.uint64(0x9E3779B97F4A7C15)) >> np.uint64(33))) & mask
    while table[place] >= 0 and keys[table[place]] != key:
        place = (place + 1) & mask
    return place


@njit(cache=True, nogil=True)
def _cells_of(
    words: NDArray[np.float32], layout: Layout, inverse: float, mask: NDArray[np.bool_], cell: NDArray[np.int32]
) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
    """Keys of the cells, and the table; a single key of -1 where a point is out of reach.

    `cell` (N,) gets the cell of each point, -1 for one that takes no part. A mask of one element goes for all points.
    """
    step, at_x, at_y, at_z = layout
    capacity = 1024
    while capacity < len(cell) // 4:  # mostly enough: what grows leaves holes in memory that nothing fits in
        capacity *= 2
    keys, table = np.empty(capacity, np.int64), np.full(2 * capacity, -1, np.int32)
    used = 0
    before, at = -1, np.int32(-1)
    for i in range(len(cell)):
        cell[i] = -1
        px, py, pz = words[step * i + at_x], words[step * i + at_y], words[step * i + at_z]
        if not (mask[i if len(mask) > 1 else 0] and math.isfinite(px) and math.isfinite(py) and math.isfinite(pz)):
            continue
        x, y, z = np.floor(px * inverse), np.floor(py * inverse), np.floor(pz * inverse)
        if not abs(x) + abs(y) + abs(z) < _REACH:
            return np.full(1, -1, np.int64), table
        key = cell_key(int(x), int(y), int(z))
        if key != before:
            if used == capacity:
                capacity *= 2
                more = np.empty(capacity, np.int64)
                more[:used] = keys
                keys, table = more, np.full(2 * capacity, -1, np.int32)
                for known in range(used):
                    table[_place(keys, table, keys[known])] = known
            place = _place(keys, table, key)
            if table[place] < 0:
                table[place] = used
                keys[used] = key
                used += 1
            before, at = key, table[place]
        cell[i] = at
    return keys[:used], table


@njit(cache=True, nogil=True)
def _order(cell: NDArray[np.int32], cells: int) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Where each cell begins, and which point stands where."""
    starts = np.zeros(cells + 1, np.int32)
    for i in range(len(cell)):
        if cell[i] >= 0:
            starts[cell[i] + 1] += 1
    for c in range(cells):
        starts[c + 1] += starts[c]
    free = starts[:-1].copy()
    order = np.empty(starts[-1], np.int32)
    for i in range(len(cell)):
        if cell[i] >= 0:
            order[free[cell[i]]] = i
            free[cell[i]] += 1
    return starts, order


@njit(cache=True, nogil=True)
def _gather(words: NDArray[np.float32], layout: Layout, order: NDArray[np.int32], xyz: NDArray[np.float32]) -> None:
    """Write the points in this order to (N, 3)."""
    step, at_x, at_y, at_z = layout
    for k in range(len(order)):
        base = step * order[k]
        xyz[k, 0], xyz[k, 1], xyz[k, 2] = words[base + at_x], words[base + at_y], words[base + at_z]


def warm_up() -> None:
    """Compile the kernels of this file."""
    grid = grid_of(words_of(np.zeros((2, 3), np.float32)), 1.0)
    cell_at(grid.keys, grid.table, cell_key(0, 0, 0))
    cell_of(0.5, 1.0)
    block_around(grid.xyz, grid.starts, grid.keys, grid.table, 0, np.empty((3, 0), np.float32))
