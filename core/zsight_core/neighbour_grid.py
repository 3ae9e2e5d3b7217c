"""Points sorted into the cells of a grid, so that what lies near a point is found without looking at all."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from zsight_core.errors import GeometryError
from zsight_core.jit import njit
from zsight_core.words import words_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from zsight_core.words import Layout, Words

__all__ = ["NeighbourGrid", "block_around", "cell_key", "grid_of", "warm_up"]

_REACH = 2**20
"""Cell numbers along an axis lie in -REACH .. REACH-1, so that three of them fit one 64-bit key."""

_FEWEST = 256
"""Cells for which there is room at first."""


@dataclass(frozen=True)
class NeighbourGrid:
    """Cells in ascending order of their keys, which is that of rows along x; 16 bytes a point and 12 a cell are held.

    ``xyz`` float32 (3, N), cell after cell; ``order`` int32 (N,) which of the points given each of them is; ``starts``
    int32 (C + 1,) where each cell begins; ``keys`` int64 (C,) `cell_key` of each; ``edge`` metres.
    """

    xyz: NDArray[np.float32]
    order: NDArray[np.int32]
    starts: NDArray[np.int32]
    keys: NDArray[np.int64]
    edge: float

    @property
    def cells(self) -> int:
        """How many cells hold a point."""
        return len(self.keys)


def grid_of(cloud: Words, edge: float, mask: NDArray[np.bool_] | None = None) -> NeighbourGrid:
    """Sort the finite points of a cloud into cells, those of a cell in the cloud's order.

    Method: a hash table numbers the cells as they come; their keys are sorted, and the points counted and put in place.
    What is needed on the way stands in the memory that the points get at last, mostly.

    Args:
        cloud: points.
        edge: of a cell, metres.
        mask: (N,) the points that take part; None: all.

    Raises:
        GeometryError: a point lies 2^20 cells or more from the origin.
    """
    chosen = np.ones(1, np.bool_) if mask is None else mask
    room = np.empty(3 * cloud.count, np.float32)
    cell = room[: cloud.count].view(np.int32)
    members = cloud.count if mask is None else int(np.count_nonzero(mask))
    found, table = _room_for_cells(members // 2, room[cloud.count + cloud.count % 2 :])
    used, found, table = _cells_of(cloud.words, cloud.layout, 1.0 / edge, chosen, cell, found, table)
    if used < 0:
        raise GeometryError(f"cells of {edge} m are too small for coordinates so far from the origin; use larger ones")
    keys = np.sort(found[:used])
    starts, order = _order(cell, found, keys, table)
    xyz = room[: 3 * len(order)].reshape(3, -1)
    _gather(cloud.words, cloud.layout, order, xyz)
    return NeighbourGrid(xyz, order, starts, keys, edge)


def _room_for_cells(wanted: int, spare: NDArray[np.float32]) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
    """Keys of about so many cells and a hash table of twice the places, a power of two; in spare memory if it holds."""
    cells = max(1 << max(wanted.bit_length() - 1, 0), _FEWEST)
    if 4 * cells > len(spare):
        return np.empty(cells, np.int64), np.empty(2 * cells, np.int32)
    return spare[: 2 * cells].view(np.int64), spare[2 * cells : 4 * cells].view(np.int32)


@njit(cache=True, nogil=True)
def cell_key(x: int, y: int, z: int) -> int:
    """One number for a cell, x fastest."""
    return ((z + _REACH) << 42) | ((y + _REACH) << 21) | (x + _REACH)


@njit(cache=True, nogil=True)
def block_around(
    xyz: NDArray[np.float32],
    starts: NDArray[np.int32],
    keys: NDArray[np.int64],
    cell: int,
    rows: NDArray[np.int64],
    room: NDArray[np.float32],
) -> tuple[NDArray[np.float32], int]:
    """The points of a cell and of the 26 cells around it side by side: (3, M) of which the first so many count.

    Three cells that follow each other along x follow each other in memory, and where the nine rows around one cell
    begin is at or behind where those around an earlier cell do.

    Args:
        xyz: points of the `NeighbourGrid`.
        starts: its beginnings of cells.
        keys: its keys.
        cell: number of the cell in the middle; no earlier one than that of the last call.
        rows: (9,) of the last call, or zeros: the first cell of each row.
        room: (3, M) of the last call, or anything: used again if it is large enough.
    """
    ends = np.empty(9, np.int64)
    count = 0
    for row in range(9):
        first = keys[cell] - 1 + ((row % 3 - 1) << 21) + ((row // 3 - 1) << 42)
        near = rows[row]
        while near < len(keys) and keys[near] < first:
            near += 1
        rows[row] = near
        while near < len(keys) and keys[near] <= first + 2:
            near += 1
        ends[row] = near
        count += starts[near] - starts[rows[row]]
    if count > room.shape[1]:
        room = np.empty((3, 2 * count), np.float32)
    used = 0
    for row in range(9):
        start, end = starts[rows[row]], starts[ends[row]]
        for axis in range(3):
            for i in range(end - start):
                room[axis, used + i] = xyz[axis, start + i]
        used += end - start
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
    words: NDArray[np.float32],
    layout: Layout,
    inverse: float,
    mask: NDArray[np.bool_],
    cell: NDArray[np.int32],
    keys: NDArray[np.int64],
    table: NDArray[np.int32],
) -> tuple[int, NDArray[np.int64], NDArray[np.int32]]:
    """How many cells there are, -1 where a point is out of reach; their keys as they come; the table.

    `cell` (N,) gets the cell of each point, -1 for one that takes no part. A mask of one element goes for all points.
    """
    step, at_x, at_y, at_z = layout
    table[:] = -1
    used = 0
    before, at = -1, np.int32(-1)
    for i in range(len(cell)):
        cell[i] = -1
        px, py, pz = words[step * i + at_x], words[step * i + at_y], words[step * i + at_z]
        if not (mask[i if len(mask) > 1 else 0] and math.isfinite(px) and math.isfinite(py) and math.isfinite(pz)):
            continue
        x, y, z = np.floor(px * inverse), np.floor(py * inverse), np.floor(pz * inverse)
        if not abs(x) + abs(y) + abs(z) < _REACH:
            return -1, keys, table
        key = cell_key(int(x), int(y), int(z))
        if key != before:
            if used == len(keys):
                more = np.empty(2 * used, np.int64)
                more[:used] = keys
                keys, table = more, np.full(4 * used, -1, np.int32)
                _enter(keys, used, table)
            place = _place(keys, table, key)
            if table[place] < 0:
                table[place] = used
                keys[used] = key
                used += 1
            before, at = key, table[place]
        cell[i] = at
    return used, keys, table


@njit(cache=True, nogil=True)
def _enter(keys: NDArray[np.int64], count: int, table: NDArray[np.int32]) -> None:
    """Put the number of each of the first keys into an empty table."""
    for known in range(count):
        table[_place(keys, table, keys[known])] = known


@njit(cache=True, nogil=True)
def _order(
    cell: NDArray[np.int32], found: NDArray[np.int64], keys: NDArray[np.int64], table: NDArray[np.int32]
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Where each cell begins, and which point stands where, in the order of the sorted keys.

    Overwritten are `cell`, the keys as they were `found`, and the table.
    """
    while len(table) >= 4 * len(keys) and len(table) > 1:
        table = table[: len(table) // 2]
    table[:] = -1
    _enter(keys, len(keys), table)
    for c in range(len(keys)):
        found[c] = table[_place(keys, table, found[c])]
    starts = np.zeros(len(keys) + 2, np.int32)  # two places late: each wanders to the next while its cell is filled
    for i in range(len(cell)):
        if cell[i] >= 0:
            cell[i] = found[cell[i]]
            starts[cell[i] + 2] += 1
    for c in range(1, len(keys) + 1):
        starts[c + 1] += starts[c]
    order = np.empty(starts[-1], np.int32)
    for i in range(len(cell)):
        if cell[i] >= 0:
            order[starts[cell[i] + 1]] = i
            starts[cell[i] + 1] += 1
    return starts[:-1], order


@njit(cache=True, nogil=True)
def _gather(words: NDArray[np.float32], layout: Layout, order: NDArray[np.int32], xyz: NDArray[np.float32]) -> None:
    """Write the points in this order to (3, N)."""
    step, at_x, at_y, at_z = layout
    for k in range(len(order)):
        base = step * order[k]
        xyz[0, k], xyz[1, k], xyz[2, k] = words[base + at_x], words[base + at_y], words[base + at_z]


def warm_up() -> None:
    """Compile the kernels of this file."""
    grid = grid_of(words_of(np.zeros((2, 3), np.float32)), 1.0)
    cell_key(0, 0, 0)
    block_around(grid.xyz, grid.starts, grid.keys, 0, np.zeros(9, np.int64), np.empty((3, 0), np.float32))
