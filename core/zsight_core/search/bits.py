"""Oriented bits of a scene: bits of steep surface, and bits of the rims of level tops, each with the way it faces."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from zsight_core.jit import njit

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from zsight_core.wholes import Cells

__all__ = ["CLASS_WIDTH", "KINDS", "RIM", "STEEP_CELL", "Bits", "bits_of", "warm_up"]

CLASSES = 12
"""Steps from looking up to looking down."""

CLASS_WIDTH = np.pi / CLASSES
"""Radians; bits of surface are compared by steepness in classes of this width."""

RIM = CLASSES
"""Kind of a bit of a rim; other kinds are classes of steepness."""

KINDS = CLASSES + 1

LEVEL_CELL = 0.85
"""Least upward part of the normal of a cell of a top."""

STEEP_CELL = 0.3
"""Least level part of a normal from which the way it faces is known."""

RIM_WINDOW = 3
"""Cells to each side from which the way a rim faces is taken."""


class Bits(NamedTuple):
    """Oriented bits in the frame of the support they stand over."""

    points: NDArray[np.float64]
    """(N, 3) metres."""
    azimuth: NDArray[np.float64]
    """(N,) radians; the level way a bit faces."""
    ways: NDArray[np.float64]
    """(N, 2) cosine and sine of azimuth."""
    kind: NDArray[np.int8]
    """(N,) class of steepness, or RIM."""
    support: NDArray[np.int8]
    """(N,)"""
    cell: NDArray[np.int32]
    """(N,) number of the cell it was seen in."""

    def only(self, chosen: NDArray[np.bool_]) -> Bits:
        """Those that are chosen (N,)."""
        ways, kind, support = self.ways[chosen], self.kind[chosen], self.support[chosen]
        return Bits(self.points[chosen], self.azimuth[chosen], ways, kind, support, self.cell[chosen])


def bits_of(cells: Cells, grid: NDArray[np.int32], depth: NDArray[np.float32], gates: NDArray[np.float64]) -> Bits:
    """Bits of the cells of a scene.

    Args:
        cells: cells of the smooth patches.
        grid: (R, C) number of the cell at each place, or -1.
        depth: (R, C) of the cells, metres.
        gates: (N,) metres by which two cells of one level top may differ in height.
    """
    return Bits(*_bits(cells.row, cells.column, cells.points, cells.normals, cells.support, grid, depth, gates))


def warm_up() -> None:
    """Compile the kernels (or load them from their cache)."""
    place, point = np.zeros(1, np.int64), np.zeros((1, 3))
    _bits(
        place,
        place,
        point,
        point,
        np.zeros(1, np.int8),
        np.zeros((1, 1), np.int32),
        np.ones((1, 1), np.float32),
        np.ones(1),
    )


@njit(cache=True, nogil=True, error_model="numpy")
def _bits(  # noqa: C901  one compiled loop over cells; splitting it would pass a dozen arrays around
    row: NDArray[np.int64],
    column: NDArray[np.int64],
    points: NDArray[np.float64],
    normals: NDArray[np.float64],
    support: NDArray[np.int8],
    grid: NDArray[np.int32],
    depth: NDArray[np.float32],
    gates: NDArray[np.float64],
) -> tuple[
    NDArray[np.float64],
    NDArray[np.float64],
    NDArray[np.float64],
    NDArray[np.int8],
    NDArray[np.int8],
    NDArray[np.int32],
]:
    """The fields of Bits."""
    total = len(row)
    where, azimuth, ways = np.empty((2 * total, 3)), np.empty(2 * total), np.empty((2 * total, 2))
    kind, over, cell = np.empty(2 * total, np.int8), np.empty(2 * total, np.int8), np.empty(2 * total, np.int32)
    count = 0
    for i in range(total):
        nx, ny, nz = normals[i, 0], normals[i, 1], normals[i, 2]
        if (row[i] + column[i]) % 2 == 0 and nx * nx + ny * ny > STEEP_CELL * STEEP_CELL:
            where[count] = points[i]
            azimuth[count] = np.arctan2(ny, nx)
            length = np.sqrt(nx * nx + ny * ny)
            ways[count, 0], ways[count, 1] = nx / length, ny / length
            kind[count] = min(CLASSES - 1, int(np.arccos(min(1.0, max(-1.0, nz))) / CLASS_WIDTH))
            over[count], cell[count] = support[i], i
            count += 1
        if nz < LEVEL_CELL:
            continue
        r, c = row[i], column[i]
        ends = False
        for k in range(4):
            j, q = r + (1, -1, 0, 0)[k], c + (0, 0, 1, -1)[k]
            if not (0 <= j < grid.shape[0] and 0 <= q < grid.shape[1]):
                continue
            other = grid[j, q]
            if other >= 0 and points[other, 2] > points[i, 2] - gates[i]:
                continue  # goes on, or something higher stands there or hides it
            if depth[j, q] > 0 and depth[j, q] < depth[r, c] - 0.01:
                continue
            ends = True
        if not ends:
            continue
        radius = (RIM_WINDOW + 0.5) ** 2 * _spacing(grid, points, gates, r, c)
        n, weight, sx, sy = 0, 0.0, 0.0, 0.0
        for j in range(max(0, r - RIM_WINDOW), min(grid.shape[0], r + RIM_WINDOW + 1)):
            for q in range(max(0, c - RIM_WINDOW), min(grid.shape[1], c + RIM_WINDOW + 1)):
                other = grid[j, q]
                if other >= 0 and abs(points[other, 2] - points[i, 2]) < gates[i]:
                    dx, dy = points[other, 0] - points[i, 0], points[other, 1] - points[i, 1]
                    near = 1.0 - (dx * dx + dy * dy) / radius  # as if seen from above through a round window
                    if near > 0:
                        n += 1
                        weight += near
                        sx += near * dx
                        sy += near * dy
        if n < 6 or sx * sx + sy * sy < (0.001 * weight) ** 2:
            continue
        where[count] = points[i]
        azimuth[count] = np.arctan2(-sy, -sx)
        length = np.sqrt(sx * sx + sy * sy)
        ways[count, 0], ways[count, 1] = -sx / length, -sy / length
        kind[count] = RIM
        over[count], cell[count] = support[i], i
        count += 1
    return where[:count], azimuth[:count], ways[:count], kind[:count], over[:count], cell[:count]


@njit(cache=True, nogil=True)
def _spacing(grid: NDArray[np.int32], points: NDArray[np.float64], gates: NDArray[np.float64], r: int, c: int) -> float:
    """Square of the metres to the nearest cell of its height beside a cell; next to nothing where there is none."""
    i, least = grid[r, c], np.inf
    for k in range(4):
        j, q = r + (1, -1, 0, 0)[k], c + (0, 0, 1, -1)[k]
        if 0 <= j < grid.shape[0] and 0 <= q < grid.shape[1] and grid[j, q] >= 0:
            other = grid[j, q]
            if abs(points[other, 2] - points[i, 2]) < gates[i]:
                least = min(least, (points[other, 0] - points[i, 0]) ** 2 + (points[other, 1] - points[i, 1]) ** 2)
    return least if least < np.inf else 1e-12
