"""Voxel grid: one averaged point for every occupied cube of space."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from numba import njit

from zsight_core.errors import GeometryError
from zsight_core.points import XYZ, XYZRGB, Points
from zsight_core.scratch import scratch
from zsight_core.tile import TILE, load_tile, new_tile
from zsight_core.words import colour_field, record_words, words_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from zsight_core.words import Layout

__all__ = ["voxel_grid", "warm_up"]

_REACH = 2**20
"""Voxel numbers along an axis lie in -REACH .. REACH-1, so that three of them fit one 64-bit key."""

_HOLE = -(2**31)
_FAR = 2**30
"""Stand in for the x number of a voxel: the point is a hole; the point lies out of reach."""

_FINE = 2**24
"""A place within a voxel is counted in steps of leaf / FINE, as fine as float32; the sum of a tile fits 32 bits."""


def voxel_grid(points: Points, leaf: float | tuple[float, float, float], out: Points | None = None) -> Points:
    """Average the points of each voxel.

    A point belongs to the voxel floor(x / leaf), floor(y / leaf), floor(z / leaf), reckoned in float32 so that the set
    of voxels is PCL's; a point with a coordinate that is not finite belongs to none. Colours are averaged channel by
    channel and truncated, as PCL does; every other numeric field is averaged too, integers truncated. Sums are kept
    in integers, so that the result does not depend on the order of the points; places are resolved to leaf / 2^24.

    Method: neighbours in a scan mostly share their voxel. A run of them is summed by differences of running sums; a
    bit per voxel of the bounding box then numbers the occupied voxels in order, without hashing or sorting.

    Args:
        points: (H, W).
        leaf: edge of a voxel, or its edges along x, y and z; metres.
        out: room for the result, contiguous, of the same dtype; ignored where the cloud has further fields.

    Returns:
        (1, M) points of the input's dtype in PCL's order of voxels: x runs fastest, z slowest.

    Raises:
        GeometryError: an edge is not above zero, or a coordinate lies 2^20 voxels or more from the origin.
        PointsError: not a cloud.
    """
    cloud = words_of(points)
    edges = _edges(leaf)
    cells = scratch("voxel cells", (cloud.count + TILE, 4), np.int32)
    sums = scratch("voxel sums", (cloud.count + TILE, 3), np.uint64)
    runs = _runs(cloud.words, cloud.layout, cloud.colour, np.float32(1) / edges, cells, sums)
    if runs < 0:
        raise GeometryError(_overflow(cloud.words, cloud.layout, leaf))
    cells, sums = cells[:runs], sums[:runs]
    voxel, count = _numbered(cells, cloud.words.nbytes)
    totals, corners = scratch("voxel totals", (count, 8), np.int64), scratch("voxel corners", (count, 3), np.int32)
    _totals(voxel, cells, sums, totals, corners)
    colour = colour_field(points)
    packed = XYZRGB if colour else XYZ
    fits = out is not None and out.dtype == packed == points.dtype and out.flags.c_contiguous and out.size >= count
    averaged = out.reshape(1, -1)[:, :count] if out is not None and fits else np.empty((1, count), packed)
    _emit(totals, corners, edges.astype(np.float64), record_words(averaged), colour is not None)
    return (
        averaged
        if points.dtype == packed
        else _with_fields(points, averaged, cells[:, 3], (sums[:, 1] >> 40).astype(np.int64), voxel)
    )


def _edges(leaf: float | tuple[float, float, float]) -> NDArray[np.float32]:
    edges = np.empty(3, np.float32)
    edges[:] = leaf
    if not all(0 < edge < math.inf for edge in edges.tolist()):
        raise GeometryError(f"leaf is {leaf} m; expected one length above zero, or three")
    return edges


def _overflow(words: NDArray[np.float32], layout: Layout, leaf: float | tuple[float, float, float]) -> str:
    rows = words.reshape(-1, layout[0])[:, list(layout[1:])]
    farthest = float(np.abs(rows[np.isfinite(rows).all(axis=1)]).max())
    return f"leaf {leaf} m is too small for coordinates up to {farthest:g} m: at most 2^20 voxels on either side of 0"


def _with_fields(
    points: Points, averaged: Points, first: NDArray[np.int32], length: NDArray[np.int64], voxel: NDArray[np.uint32]
) -> Points:
    """The averaged coordinates and colours in the input's dtype, with its further fields averaged as well."""
    result = np.zeros(averaged.shape, points.dtype)
    for axis in "xyz":
        result[axis] = averaged[axis]
    colour = colour_field(points)
    if colour:
        result[colour] = np.ascontiguousarray(averaged["rgb"]).view(points.dtype[colour].newbyteorder("="))
    index = np.repeat(first - np.cumsum(length) + length, length) + np.arange(length.sum())
    voxel_of_point = np.repeat(voxel, length).astype(np.int64)
    count = np.bincount(voxel_of_point, minlength=averaged.size)
    for name in [name for name in points.dtype.names or () if name not in ("x", "y", "z", colour)]:
        values = points[name].reshape(points.size, -1)[index].astype(np.float64)
        means = [np.bincount(voxel_of_point, weights=column, minlength=averaged.size) / count for column in values.T]
        result[name] = np.stack(means, axis=-1).reshape(result[name].shape)
    return result


@njit(cache=True, nogil=True)
def _runs(
    words: NDArray[np.float32],
    layout: Layout,
    colour: int,
    inverse: NDArray[np.float32],
    cells: NDArray[np.int32],
    sums: NDArray[np.uint64],
) -> int:
    """Find all runs of successive points that share a voxel, at most a tile long.

    Args:
        words: the cloud.
        layout: of the words.
        colour: word of the packed colour, -1 without.
        inverse: (3,) one by the edges of a voxel.
        cells: gets, a run a row, the number of the voxel along x, y and z, and the first point of the run.
        sums: gets the places in the voxel x | y << 32; z | points << 40; colours as `_split_colours` lays them.

    Returns:
        How many runs there are; -1 where a point is out of reach.
    """
    count = len(words) // layout[0]
    tile = new_tile()
    bits = tile[3].view(np.uint32)
    cell = np.empty((3, TILE), np.int32)
    starts = np.empty(TILE, np.uint8)
    numbers = np.empty((3, TILE), np.uint64)
    halves = numbers.view(np.uint32)
    ends = np.zeros((TILE + 1, 3), np.uint64)
    used = 0
    for start in range(0, count, TILE):
        load_tile(words, layout, colour, start, tile)
        _cells(tile, inverse, cell)
        if not _mark_starts(cell, starts):
            continue
        _split_places(tile, halves[0], halves[1])
        _split_colours(bits, halves[2])
        runs = _run_ends(numbers, starts, ends)
        used = _append(cell, ends, runs, start, cells, sums, used)
        if used < 0:
            break
    return used


@njit(cache=True, nogil=True)
def _cells(tile: NDArray[np.float32], inverse: NDArray[np.float32], cell: NDArray[np.int32]) -> None:
    """Voxel numbers of the points of a tile; their coordinates become places in the voxel, 0 .. FINE - 1."""
    ix, iy, iz = inverse[0], inverse[1], inverse[2]
    reach, fine, infinite = np.float32(_REACH), np.float32(_FINE), np.float32(np.inf)
    hole, far, zero = np.float32(_HOLE), np.float32(_FAR), np.float32(0)
    for i in range(TILE):
        finite = (abs(tile[0, i]) < infinite) & (abs(tile[1, i]) < infinite) & (abs(tile[2, i]) < infinite)
        x, y, z = tile[0, i] * ix, tile[1, i] * iy, tile[2, i] * iz
        floor_x, floor_y, floor_z = np.floor(x), np.floor(y), np.floor(z)
        near = (abs(floor_x) < reach) & (abs(floor_y) < reach) & (abs(floor_z) < reach)
        gone = far if finite else hole
        cell[0, i] = np.int32(floor_x if near else gone)
        cell[1, i] = np.int32(floor_y if near else zero)
        cell[2, i] = np.int32(floor_z if near else zero)
        x, y, z = (x - floor_x) * fine, (y - floor_y) * fine, (z - floor_z) * fine
        tile[0, i] = x if near else zero
        tile[1, i] = y if near else zero
        tile[2, i] = z if near else zero


@njit(cache=True, nogil=True)
def _split_places(tile: NDArray[np.float32], xy: NDArray[np.uint32], z: NDArray[np.uint32]) -> None:
    """Two numbers to a 64-bit integer, so that one addition sums both: x | y << 32 and z | 1 << 40."""
    for i in range(TILE):
        xy[2 * i] = np.int32(tile[0, i])
        xy[2 * i + 1] = np.int32(tile[1, i])
    for i in range(TILE):
        z[2 * i] = np.int32(tile[2, i])
        z[2 * i + 1] = 256


@njit(cache=True, nogil=True)
def _split_colours(bits: NDArray[np.uint32], colours: NDArray[np.uint32]) -> None:
    """Four channels 16 bits apart, enough for the sums of a tile: blue, red, green, alpha from the lowest up."""
    for i in range(TILE):
        colours[2 * i] = bits[i] & np.uint32(0xFF00FF)
        colours[2 * i + 1] = (bits[i] >> np.uint32(8)) & np.uint32(0xFF00FF)


@njit(cache=True, nogil=True)
def _mark_starts(cell: NDArray[np.int32], starts: NDArray[np.uint8]) -> bool:
    """1 where a point's voxel differs from that of the point before; False where the tile is one hole."""
    starts[0] = cell[0, 0] != _HOLE
    for i in range(1, TILE):
        changed = (cell[0, i] != cell[0, i - 1]) | (cell[1, i] != cell[1, i - 1]) | (cell[2, i] != cell[2, i - 1])
        starts[i] = changed
    any_start = np.uint64(0)
    for eight in starts.view(np.uint64):
        any_start |= eight
    starts[0] = 1
    return bool(any_start != 0)


@njit(cache=True, nogil=True)
def _run_ends(numbers: NDArray[np.uint64], starts: NDArray[np.uint8], ends: NDArray[np.uint64]) -> Any:
    """Running sums at the end of each run, in rows 1, 2, ... of `ends`; returns how many runs there are.

    Every point writes its sum to the row of its run, and the last one stays: no branch that could be mispredicted.
    (Unsigned, because a signed index would be checked for counting from the end.)
    """
    a = b = c = np.uint64(0)
    run = np.uint64(0)
    for i in range(TILE):
        run += np.uint64(starts[i])
        a += numbers[0, i]
        b += numbers[1, i]
        c += numbers[2, i]
        ends[run, 0] = a
        ends[run, 1] = b
        ends[run, 2] = c
    return run


@njit(cache=True, nogil=True)
def _append(
    cell: NDArray[np.int32],
    ends: NDArray[np.uint64],
    runs: Any,
    start: int,
    cells: NDArray[np.int32],
    sums: NDArray[np.uint64],
    used: int,
) -> int:
    """Add the runs of a tile that are not holes to those of the cloud; returns how many there are then, -1: too far."""
    last = np.uint64(used)
    far = False
    for run in range(np.uint64(runs)):
        first = ends[run, 1] >> np.uint64(40)
        x = cell[0, first]
        far |= x == _FAR
        cells[last, 0] = x
        cells[last, 1] = cell[1, first]
        cells[last, 2] = cell[2, first]
        cells[last, 3] = start + first
        after = run + np.uint64(1)
        sums[last, 0] = ends[after, 0] - ends[run, 0]
        sums[last, 1] = ends[after, 1] - ends[run, 1]
        sums[last, 2] = ends[after, 2] - ends[run, 2]
        last += np.uint64(x != _HOLE)
    return np.int64(-1) if far else np.int64(last)  # type: ignore[return-value]  # int() would keep it unsigned under numba


def _numbered(cells: NDArray[np.int32], room: int) -> tuple[NDArray[np.uint32], int]:
    """Number of each run's voxel among the occupied ones in order, uint32 (R,), and how many are occupied.

    A map of one bit a voxel is used while it takes at most `room` bytes; a wider cloud is sorted instead.
    """
    number = scratch("voxel numbers", (len(cells),), np.uint32)
    if len(cells) == 0:
        return number, 0
    low, size = _extent(cells)
    voxels = float(np.prod(size, dtype=np.float64))
    if voxels > min(8.0 * max(room, 2**20), 2.0**31 - 64):
        return number, _number_by_sorting(cells, number)
    length = int(voxels) // 64 + 1
    occupied = scratch("voxel map", (length,), np.uint64, zeroed=True)
    before = scratch("voxel ranks", (length,), np.uint32)
    touched = scratch("voxel parts", (length // 64 + 1,), np.uint8, zeroed=True)
    return number, _number_by_map(cells, low, size, number, occupied, before, touched)


@njit(cache=True, nogil=True)
def _extent(cells: NDArray[np.int32]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Least voxel numbers (3,), and how many there are up to the greatest (3,)."""
    low_x = high_x = cells[0, 0]
    low_y = high_y = cells[0, 1]
    low_z = high_z = cells[0, 2]
    for run in range(len(cells)):
        x, y, z = cells[run, 0], cells[run, 1], cells[run, 2]
        low_x, low_y, low_z = min(low_x, x), min(low_y, y), min(low_z, z)
        high_x, high_y, high_z = max(high_x, x), max(high_y, y), max(high_z, z)
    size = np.array([high_x - low_x + 1, high_y - low_y + 1, high_z - low_z + 1], dtype=np.int64)
    return np.array([low_x, low_y, low_z], dtype=np.int64), size


@njit(cache=True, nogil=True)
def _number_by_map(
    cells: NDArray[np.int32],
    low: NDArray[np.int64],
    size: NDArray[np.int64],
    number: NDArray[np.uint32],
    occupied: NDArray[np.uint64],
    before: NDArray[np.uint32],
    touched: NDArray[np.uint8],
) -> int:
    """Rank the voxels by a map of one bit for each voxel of the box; returns how many are occupied.

    `touched` has a mark for every 64 words of the map and tells which parts of it need no look. Both are zero before
    and after.
    """
    six, low_bits, one = np.uint32(6), np.uint32(63), np.uint64(1)
    size_x, size_y = size[0], size[1]
    for run in range(len(cells)):
        rows = (cells[run, 1] - low[1]) + size_y * (cells[run, 2] - low[2])
        number[run] = (cells[run, 0] - low[0]) + size_x * rows
    for run in range(len(number)):
        word = number[run] >> six
        occupied[word] |= one << np.uint64(number[run] & low_bits)
        touched[word >> six] = 1
    total = 0
    for part in range(len(touched)):
        if touched[part]:
            for word in range(64 * part, min(64 * part + 64, len(occupied))):
                before[word] = total
                total += int(_ones(occupied[word]))
    for run in range(len(number)):
        word = number[run] >> six
        lower = (one << np.uint64(number[run] & low_bits)) - one
        number[run] = before[word] + _ones(occupied[word] & lower)
    for part in range(len(touched)):
        if touched[part]:
            occupied[64 * part : 64 * part + 64] = 0
            touched[part] = 0
    return total


@njit(cache=True, nogil=True)
def _number_by_sorting(cells: NDArray[np.int32], number: NDArray[np.uint32]) -> int:
    keys = np.empty(len(cells), np.int64)
    for run in range(len(keys)):
        x, y, z = np.int64(cells[run, 0]), np.int64(cells[run, 1]), np.int64(cells[run, 2])
        keys[run] = ((z + _REACH) << 42) | ((y + _REACH) << 21) | (x + _REACH)
    voxels = np.unique(keys)
    number[:] = np.searchsorted(voxels, keys)
    return len(voxels)


@njit(cache=True, nogil=True)
def _ones(bits: Any) -> Any:
    """How many bits of a 64-bit word are set (Warren, Hacker's Delight, 2002)."""
    bits = bits - ((bits >> np.uint64(1)) & np.uint64(0x5555555555555555))
    bits = (bits & np.uint64(0x3333333333333333)) + ((bits >> np.uint64(2)) & np.uint64(0x3333333333333333))
    bits = (bits + (bits >> np.uint64(4))) & np.uint64(0x0F0F0F0F0F0F0F0F)
    return (bits * np.uint64(0x0101010101010101)) >> np.uint64(56)


@njit(cache=True, nogil=True)
def _totals(
    voxel: NDArray[np.uint32],
    cells: NDArray[np.int32],
    sums: NDArray[np.uint64],
    totals: NDArray[np.int64],
    corners: NDArray[np.int32],
) -> None:
    """Add the runs up, into (M, 8) x, y, z, points, blue, green, red, alpha; and (M, 3) the number of each voxel."""
    totals[:] = 0
    half, word = np.uint64(32), np.uint64(0xFFFFFFFF)
    quarter, channel = np.uint64(16), np.uint64(0xFFFF)
    for run in range(len(voxel)):
        here = voxel[run]
        xy, z, colours = sums[run, 0], sums[run, 1], sums[run, 2]
        totals[here, 0] += np.int64(xy & word)
        totals[here, 1] += np.int64(xy >> half)
        totals[here, 2] += np.int64(z & word)
        totals[here, 3] += np.int64(z >> np.uint64(40))
        totals[here, 4] += np.int64(colours & channel)
        totals[here, 5] += np.int64((colours >> half) & channel)
        totals[here, 6] += np.int64((colours >> quarter) & channel)
        totals[here, 7] += np.int64(colours >> np.uint64(48))
        corners[here, 0] = cells[run, 0]
        corners[here, 1] = cells[run, 1]
        corners[here, 2] = cells[run, 2]


@njit(cache=True, nogil=True)
def _emit(
    totals: NDArray[np.int64],
    corners: NDArray[np.int32],
    edges: NDArray[np.float64],
    words: NDArray[np.float32],
    coloured: bool,
) -> None:
    """Write the averages, one voxel after the other, into 16-byte points."""
    bits = words.view(np.uint32)
    tiny = 2.0**-34  # lifts a quotient that rounding left just below a whole number; others lie 1 / points below it
    for voxel in range(len(totals)):
        total, corner = totals[voxel], corners[voxel]
        share = 1.0 / total[3]
        fine = share / _FINE
        words[4 * voxel] = np.float32((corner[0] + total[0] * fine) * edges[0])
        words[4 * voxel + 1] = np.float32((corner[1] + total[1] * fine) * edges[1])
        words[4 * voxel + 2] = np.float32((corner[2] + total[2] * fine) * edges[2])
        blue, green = np.uint32(total[4] * share + tiny), np.uint32(total[5] * share + tiny)
        red, alpha = np.uint32(total[6] * share + tiny), np.uint32(total[7] * share + tiny)
        packed = blue | (green << np.uint32(8)) | (red << np.uint32(16)) | (alpha << np.uint32(24))
        bits[4 * voxel + 3] = packed if coloured else np.uint32(0)


def warm_up() -> None:
    """Compile the kernels of this file."""
    points = np.zeros((8, 16), XYZRGB)
    points["x"], points["y"] = np.meshgrid(np.arange(16), np.arange(8))
    voxel_grid(points, 0.5)
