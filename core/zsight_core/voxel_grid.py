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

_CROWD = 2**24
"""More points in a voxel, and the sum of a colour channel might not fit 32 bits."""

_HOLE = -(2**31)
_FAR = 2**30
"""Stand in for the x number of a voxel: the point is a hole; the point lies out of reach."""


def voxel_grid(points: Points, leaf: float | tuple[float, float, float], out: Points | None = None) -> Points:
    """Average the points of each voxel.

    A point belongs to the voxel floor(x / leaf), floor(y / leaf), floor(z / leaf), reckoned in float32 so that the set
    of voxels is PCL's; a point with a coordinate that is not finite, or over 10^30 m, belongs to none. Colours are
    averaged channel by channel and truncated, as PCL does; every other numeric field is averaged too, integers
    truncated. Sums are kept in integers, so that the result does not depend on the order of the points; the place of
    a point is resolved to 2 micrometres, or to leaf / 2^21 where that is coarser.

    Method: neighbours in a scan mostly share their voxel. A run of them is summed by differences of running sums; a
    bit per voxel of the bounding box then numbers the occupied voxels in order, without hashing or sorting.

    Args:
        points: (H, W).
        leaf: edge of a voxel, or its edges along x, y and z; metres.
        out: room for the result, contiguous, of the same dtype; ignored where the cloud has further fields.

    Returns:
        (1, M) points of the input's dtype in PCL's order of voxels: x runs fastest, z slowest.

    Raises:
        GeometryError: an edge is not above zero, or a point lies 2^20 voxels or more from the origin (the sum of its
            distances along x, y and z), or over 2^24 points share a voxel.
        PointsError: not a cloud.
    """
    cloud = words_of(points)
    edges = _edges(leaf)
    steps, longest = _fineness(float(edges.max()))
    grid = np.empty(4, np.float32)
    grid[:3], grid[3] = np.float32(1) / edges, steps
    cells = scratch("voxel cells", (cloud.count + TILE, 4), np.int32)
    sums = scratch("voxel sums", (cloud.count + TILE, 2), np.uint64)
    runs = _runs(cloud.words, cloud.layout, cloud.colour, grid, longest, cells, sums)
    if runs < 0:
        raise GeometryError(_overflow(cloud.words, cloud.layout, leaf))
    cells, sums = cells[:runs], sums[:runs]
    voxel, count = _numbered(cells, cloud.words.nbytes)
    totals, corners = scratch("voxel totals", (count, 6), np.uint64), scratch("voxel corners", (count, 2), np.int64)
    _totals(voxel, cells.view(np.int64), sums, totals, corners)
    if cloud.count > _CROWD and totals[:, 3].max() > _CROWD:
        raise GeometryError(f"leaf {leaf} m gathers over 2^24 points in one voxel; use a smaller one")
    colour = colour_field(points)
    packed = XYZRGB if colour else XYZ
    fits = out is not None and out.dtype == packed == points.dtype and out.flags.c_contiguous and out.size >= count
    averaged = out.reshape(1, -1)[:, :count] if out is not None and fits else np.empty((1, count), packed)
    doubles = edges.astype(np.float64)
    _emit(totals.view(np.int64), corners.view(np.int32), doubles, steps, record_words(averaged), colour is not None)
    return (
        averaged
        if points.dtype == packed
        else _with_fields(points, averaged, cells[:, 3], (sums[:, 1] >> 58).astype(np.int64), voxel)
    )


def _edges(leaf: float | tuple[float, float, float]) -> NDArray[np.float32]:
    edges = np.empty(3, np.float32)
    edges[:] = leaf
    if not all(0 < edge < math.inf for edge in edges.tolist()):
        raise GeometryError(f"leaf is {leaf} m; expected one length above zero, or three")
    return edges


def _fineness(edge: float) -> tuple[float, int]:
    """Steps into which the edge of a voxel is divided, and how many places may then be summed up in 21 bits.

    65535 steps, and more for voxels over 13 cm, so that a step is at most 2 micrometres up to an edge of 4 m.
    """
    longest = 32
    while longest > 1 and edge * longest > 2e-6 * 2**21:
        longest //= 2
    return 2.0**21 / longest - 1.0, longest


def _overflow(words: NDArray[np.float32], layout: Layout, leaf: float | tuple[float, float, float]) -> str:
    rows = words.reshape(-1, layout[0])[:, list(layout[1:])]
    farthest = float(np.abs(rows[np.isfinite(rows).all(axis=1)]).max())
    return f"leaf {leaf} m is too small for coordinates up to {farthest:g} m: at most 2^20 voxels from the origin"


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
    grid: NDArray[np.float32],
    longest: int,
    cells: NDArray[np.int32],
    sums: NDArray[np.uint64],
) -> int:
    """Find the runs of successive points that share a voxel.

    Args:
        words: the cloud.
        layout: of the words.
        colour: word of the packed colour, -1 without.
        grid: (4,) one by the edges of a voxel, and into how many steps an edge is divided.
        longest: points in a run at most, a power of two up to 32.
        cells: gets, a run a row, the number of the voxel along x, y and z, and the first point of the run.
        sums: gets the sums of places, as `_locate` packs them, and of colours, as `_spread_colours` does.

    Returns:
        How many runs there are; -1 where a point is out of reach.
    """
    count = len(words) // layout[0]
    tile = new_tile()
    cell = np.empty((3, TILE), np.int32)
    starts = np.empty(TILE, np.uint8)
    numbers = np.empty((2, TILE), np.uint64)
    ends = np.zeros((TILE + 1, 2), np.uint64)
    used = 0
    for start in range(0, count, TILE):
        load_tile(words, layout, colour, start, tile)
        _locate(tile, grid, cell, numbers[0].view(np.uint32))
        if not _mark_starts(cell, longest, starts):
            continue
        _spread_colours(tile[3].view(np.uint32), numbers[1].view(np.uint32))
        runs = _run_ends(numbers, starts, ends)
        used = _append(cell, ends, runs, start, cells, sums, used)
        if used < 0:
            break
    return used


@njit(cache=True, nogil=True)
def _locate(
    tile: NDArray[np.float32], grid: NDArray[np.float32], cell: NDArray[np.int32], places: NDArray[np.uint32]
) -> None:
    """Voxel numbers of the points of a tile, and the place of each in its voxel: x | y << 21 | z << 42, in steps."""
    ix, iy, iz, steps = grid[0], grid[1], grid[2], grid[3]
    reach, infinite, zero = np.float32(_REACH), np.float32(np.inf), np.float32(0)
    hole, far = np.float32(_HOLE), np.float32(_FAR)
    for i in range(TILE):
        x, y, z = tile[0, i] * ix, tile[1, i] * iy, tile[2, i] * iz
        floor_x, floor_y, floor_z = np.floor(x), np.floor(y), np.floor(z)
        distance = abs(floor_x) + abs(floor_y) + abs(floor_z)  # NaN at a hole
        near = distance < reach
        gone = far if distance < infinite else hole
        cell[0, i] = np.int32(floor_x if near else gone)
        cell[1, i] = np.int32(floor_y if near else zero)
        cell[2, i] = np.int32(floor_z if near else zero)
        x, y, z = (x - floor_x) * steps, (y - floor_y) * steps, (z - floor_z) * steps
        tile[0, i] = x if near else zero
        tile[1, i] = y if near else zero
        tile[2, i] = z if near else zero
    for i in range(TILE):
        place_y = np.uint32(np.int32(tile[1, i]))
        places[2 * i] = np.uint32(np.int32(tile[0, i])) | (place_y << np.uint32(21))
        places[2 * i + 1] = (place_y >> np.uint32(11)) | (np.uint32(np.int32(tile[2, i])) << np.uint32(10))


@njit(cache=True, nogil=True)
def _spread_colours(bits: NDArray[np.uint32], colours: NDArray[np.uint32]) -> None:
    """Room for 32 times each channel, and a count of points: blue | green << 13 | red << 32 | alpha << 45 | 1 << 58."""
    for i in range(TILE):
        packed = bits[i]
        colours[2 * i] = (packed & np.uint32(0xFF)) | ((packed & np.uint32(0xFF00)) << np.uint32(5))
        high = ((packed >> np.uint32(16)) & np.uint32(0xFF)) | ((packed >> np.uint32(24)) << np.uint32(13))
        colours[2 * i + 1] = high | np.uint32(1 << 26)


@njit(cache=True, nogil=True)
def _mark_starts(cell: NDArray[np.int32], longest: int, starts: NDArray[np.uint8]) -> bool:
    """1 where a run begins; False where the whole tile is a hole."""
    for i in range(1, TILE):
        changed = (cell[0, i] != cell[0, i - 1]) | (cell[1, i] != cell[1, i - 1]) | (cell[2, i] != cell[2, i - 1])
        starts[i] = changed
    starts[0] = cell[0, 0] != _HOLE
    some = np.uint64(0)
    for eight in starts.view(np.uint64):
        some |= eight
    for i in range(0, TILE, longest):
        starts[i] = 1
    return bool(some != 0)


@njit(cache=True, nogil=True)
def _run_ends(numbers: NDArray[np.uint64], starts: NDArray[np.uint8], ends: NDArray[np.uint64]) -> Any:
    """Running sums at the end of each run, in rows 1, 2, ... of `ends`; returns how many runs there are.

    Every point writes its sums to the row of its run, and the last ones stay: no branch that could be mispredicted.
    Carries from one packed number into the next do not harm, the difference of two sums is again exact. (Unsigned,
    because a signed index would be checked for counting from the end.)
    """
    places = colours = np.uint64(0)
    run = np.uint64(0)
    for i in range(TILE):
        run += np.uint64(starts[i])
        places += numbers[0, i]
        colours += numbers[1, i]
        ends[run, 0] = places
        ends[run, 1] = colours
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
    last, first = np.uint64(used), np.uint64(0)
    far = False
    for run in range(np.uint64(runs)):
        x = cell[0, first]
        far |= x == _FAR
        after = run + np.uint64(1)
        colours = ends[after, 1] - ends[run, 1]
        cells[last, 0] = x
        cells[last, 1] = cell[1, first]
        cells[last, 2] = cell[2, first]
        cells[last, 3] = start + first
        sums[last, 0] = ends[after, 0] - ends[run, 0]
        sums[last, 1] = colours
        last += np.uint64(x != _HOLE)
        first += colours >> np.uint64(58)
    return np.int64(-1) if far else np.int64(last)  # type: ignore[return-value]  # int() would keep it unsigned


def _numbered(cells: NDArray[np.int32], room: int) -> tuple[NDArray[np.uint32], int]:
    """Number of each run's voxel among the occupied ones in order, uint32 (R,), and how many are occupied.

    A map of one bit a voxel is used while it takes at most `room` bytes; a wider cloud is sorted instead.
    """
    number = scratch("voxel numbers", (len(cells),), np.uint32)
    if len(cells) == 0:
        return number, 0
    low, size = _extent(cells)
    voxels = math.prod(float(edge) for edge in size.tolist())
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
    cells: NDArray[np.int64],
    sums: NDArray[np.uint64],
    totals: NDArray[np.uint64],
    corners: NDArray[np.int64],
) -> None:
    """Add the runs up, into (M, 6) x, y, z, points, blue | red << 32, green | alpha << 32; and copy each voxel's cell.

    Args:
        voxel: number of each run's voxel.
        cells: as `_runs` gives them, two int32 in one.
        sums: as `_runs` gives them.
        totals: gets the sums.
        corners: (M, 2) gets the cells.
    """
    totals[:] = 0
    place, channels = np.uint64(2**21 - 1), np.uint64(0x00001FFF00001FFF)
    for run in range(len(voxel)):
        here = voxel[run]
        places, colours = sums[run, 0], sums[run, 1]
        totals[here, 0] += places & place
        totals[here, 1] += (places >> np.uint64(21)) & place
        totals[here, 2] += places >> np.uint64(42)
        totals[here, 3] += colours >> np.uint64(58)
        totals[here, 4] += colours & channels
        totals[here, 5] += (colours >> np.uint64(13)) & channels
        corners[here, 0] = cells[run, 0]
        corners[here, 1] = cells[run, 1]


@njit(cache=True, nogil=True, error_model="numpy")  # no voxel is empty, and a test for it would cost a tenth
def _emit(
    totals: NDArray[np.int64],
    corners: NDArray[np.int32],
    edges: NDArray[np.float64],
    steps: float,
    words: NDArray[np.float32],
    coloured: bool,
) -> None:
    """Write the averages, one voxel after the other, into 16-byte points."""
    bits = words.view(np.uint32)
    half = 0.5 / steps  # a place was cut off to the step below
    tiny = 2.0**-34  # lifts a quotient that rounding left just below a whole number; others lie 1 / points below it
    low = 0xFFFFFFFF
    for voxel in range(len(totals)):
        share = 1.0 / totals[voxel, 3]
        fine = share / steps
        words[4 * voxel] = np.float32((corners[voxel, 0] + (totals[voxel, 0] * fine + half)) * edges[0])
        words[4 * voxel + 1] = np.float32((corners[voxel, 1] + (totals[voxel, 1] * fine + half)) * edges[1])
        words[4 * voxel + 2] = np.float32((corners[voxel, 2] + (totals[voxel, 2] * fine + half)) * edges[2])
        even, odd = totals[voxel, 4], totals[voxel, 5]
        blue, red = np.int64((even & low) * share + tiny), np.int64(((even >> 32) & low) * share + tiny)
        green, alpha = np.int64((odd & low) * share + tiny), np.int64(((odd >> 32) & low) * share + tiny)
        packed = blue | (green << 8) | (red << 16) | (alpha << 24)
        bits[4 * voxel + 3] = packed if coloured else 0


def warm_up() -> None:
    """Compile the kernels of this file."""
    points = np.zeros((8, 16), XYZRGB)
    points["x"], points["y"] = np.meshgrid(np.arange(16), np.arange(8))
    voxel_grid(points, 0.5)
