"""Voxel grid: one averaged point for every occupied cube of space."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from numba import njit

from zsight_core.errors import GeometryError
from zsight_core.points import XYZ, XYZRGB, Points
from zsight_core.scratch import scratch
from zsight_core.take import room_for
from zsight_core.tile import TILE, load_tile, new_tile
from zsight_core.words import colour_field, record_words, words_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from zsight_core.words import Layout, Words

__all__ = ["voxel_grid", "warm_up"]

_REACH = 2**20
"""Voxel numbers along an axis lie in -REACH .. REACH-1, so that three of them fit one 64-bit key."""

_ROOM = 2**30
"""Places, in steps, lie in -ROOM .. ROOM-1; unsigned, with ROOM added, they are kept: others have bit 31 set."""

_CROWD = 2**24
"""More points in a voxel, and the sum of a colour channel might not fit 32 bits."""

_HOLE, _FAR = np.uint32(0xC0000000), np.uint32(0x80000000)
"""Stand in for a place: it is not finite; it is out of room."""


def voxel_grid(points: Points, leaf: float | tuple[float, float, float], out: Points | None = None) -> Points:
    """Average the points of each voxel.

    A point belongs to the voxel floor(x / leaf), floor(y / leaf), floor(z / leaf), reckoned in float32 so that the set
    of voxels is PCL's; a point with a coordinate that is not finite, or over 10^30 m, belongs to none. Colours are
    averaged channel by channel and truncated, as PCL does; every other numeric field is averaged too, integers
    truncated. Sums are kept in integers, so that the result does not depend on the order of the points; the place of
    a point is resolved to 2 micrometres, or to leaf / 2^21 or the farthest point's distance / 2^29 where that is
    coarser.

    Method: a point's place is a whole number of steps, 2^k to a voxel, so that its upper bits number the voxel and the
    lower ones say where in it the point lies. Neighbours in a scan mostly share their voxel. A run of them is summed by
    differences of running sums; a bit per voxel of the bounding box then numbers the occupied voxels in order, without
    hashing or sorting.

    Args:
        points: (H, W).
        leaf: edge of a voxel, or its edges along x, y and z; metres.
        out: room for the result, contiguous; ignored where the cloud is not of 16-byte points.

    Returns:
        (1, M) points of the input's dtype in PCL's order of voxels: x runs fastest, z slowest.

    Raises:
        GeometryError: an edge is not above zero, or a point lies 2^20 voxels or more from the origin (the sum of its
            distances along x, y and z), or over 2^24 points share a voxel.
        PointsError: not a cloud, or `out` does not fit.
    """
    cloud = words_of(points)
    edges = _edges(leaf)
    bits = _fineness(float(edges.max()))
    keys = scratch("voxel keys", (cloud.count + TILE,), np.uint64)
    runs = scratch("voxel runs", (cloud.count + TILE, 6), np.uint32)
    firsts = np.empty(0 if points.dtype in (XYZ, XYZRGB) else cloud.count + TILE, np.int32)
    box = np.empty((2, 3), np.uint32)
    used, far = _runs(cloud.words, cloud.layout, cloud.colour, _scale(edges, bits), bits, keys, runs, firsts, box)
    if far:
        bits = min(bits, _fineness_of_reach(cloud, edges, leaf))
        used, _ = _runs(cloud.words, cloud.layout, cloud.colour, _scale(edges, bits), bits, keys, runs, firsts, box)
    keys, runs = keys[:used], runs[:used]
    voxel, count = _numbered(keys, (box >> bits).astype(np.int64), cloud.words.nbytes)
    totals = scratch("voxel totals", (count, 6), np.uint64)
    _totals(voxel, keys, runs, bits, totals)
    if cloud.count > _CROWD and totals[:, 3].max() > _CROWD:
        raise GeometryError(f"leaf {leaf} m gathers over 2^24 points in one voxel; use a smaller one")
    colour = colour_field(points)
    packed = XYZRGB if colour else XYZ
    same = points.dtype == packed
    averaged = room_for(points, count, out)[:, :count] if same else np.empty((1, count), packed)
    _emit(totals.view(np.int64), edges.astype(np.float64) / 2.0**bits, record_words(averaged), colour is not None)
    if same:
        return averaged
    return _with_fields(points, averaged, firsts[:used], runs[:, 3].astype(np.int64), voxel)


def _edges(leaf: float | tuple[float, float, float]) -> NDArray[np.float32]:
    edges = np.empty(3, np.float32)
    edges[:] = leaf
    if not all(0 < edge < math.inf for edge in edges.tolist()):
        raise GeometryError(f"leaf is {leaf} m; expected one length above zero, or three")
    return edges


def _fineness(edge: float) -> int:
    """The edge of a voxel is divided into 2 to this power of steps: of 2 micrometres at most, up to an edge of 4 m."""
    bits = 16
    while bits < 21 and edge > 2e-6 * 2**bits:
        bits += 1
    return bits


def _fineness_of_reach(cloud: Words, edges: NDArray[np.float32], leaf: float | tuple[float, float, float]) -> int:
    """The finest at which the places of all points are within `_ROOM`."""
    rows = cloud.words.reshape(-1, cloud.layout[0])[:, list(cloud.layout[1:])]
    finite = rows[np.isfinite(rows).all(axis=1)].astype(np.float64)
    farthest = float((np.abs(finite) / edges).sum(axis=1).max(initial=0.0)) + 3
    if farthest >= _REACH:
        raise GeometryError(
            f"leaf {leaf} m is too small for coordinates up to {np.abs(finite).max():g} m: at most 2^20 voxels from "
            "the origin"
        )
    return math.floor(math.log2(_ROOM / farthest))


def _scale(edges: NDArray[np.float32], bits: int) -> NDArray[np.float32]:
    """Steps a metre (3,); a power of two times what PCL multiplies by, so that roundings are the same."""
    return np.float32(1) / edges * np.float32(2**bits)


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
    scale: NDArray[np.float32],
    bits: int,
    keys: NDArray[np.uint64],
    runs: NDArray[np.uint32],
    firsts: NDArray[np.int32],
    box: NDArray[np.uint32],
) -> tuple[int, bool]:
    """Find the runs of successive points that share a voxel.

    Works on rows of four words a point, as a packed cloud has them: turning them into columns costs more than it helps.

    Args:
        words: the cloud.
        layout: of the words.
        colour: word of the packed colour, -1 without.
        scale: (3,) steps a metre.
        bits: of the steps in a voxel.
        keys: (R,) gets the voxel of each run: the upper bits of its place, x | y << 21 | z << 42.
        runs: (R, 6) gets the sums of the lower bits of x, y and z, the number of points, and the sums of
            blue | green << 16 and of red | alpha << 16.
        firsts: gets the first point of each run, if it has room for them.
        box: (2, 3) gets the least and greatest places.

    Returns:
        How many runs there are; and whether a place is out of room: its point is left out like a hole.
    """
    count = len(words) // layout[0]
    packed = layout[0] == 4 and layout[1] == 0 and layout[2] == 1 and layout[3] == 2 and (colour == 3 or colour < 0)
    rows, scales = np.empty(4 * TILE, np.float32), np.zeros(4 * TILE, np.float32)
    coordinates, ones = np.zeros(4 * TILE, np.uint32), np.zeros(4 * TILE, np.uint32)
    for axis in range(3):
        scales[axis::4] = scale[axis]
        coordinates[axis::4] = 0xFFFFFFFF
    voxel, ones[3::4] = coordinates << np.uint32(bits), 1
    place, changed = np.empty(4 * TILE, np.uint32), np.empty(4 * TILE, np.uint32)
    ends = np.zeros(8 * (TILE + 1), np.uint32)
    box[0], box[1] = np.uint32(0xFFFFFFFF), 0
    used, far = 0, False
    for start in range(0, count, TILE):
        if packed and start + TILE <= count:
            tile = words[4 * start : 4 * (start + TILE)]
        else:
            _load_rows(words, layout, colour, start, rows)
            tile = rows
        _locate(tile, scales, coordinates, ones, place)
        if _compare(place, voxel, changed):
            found = _run_ends(place, tile.view(np.uint8), changed.view(np.uint64), ends)
            used, too_far = _append(place, ends, found, start, bits, keys, runs, firsts, box, used)
            far |= too_far
    return used, far


@njit(cache=True, nogil=True)
def _load_rows(words: NDArray[np.float32], layout: Layout, colour: int, start: int, rows: NDArray[np.float32]) -> None:
    """Rows x y z colour of the points of a tile; behind the last point holes."""
    tile = new_tile()
    load_tile(words, layout, colour, start, tile)
    for i in range(TILE):
        rows[4 * i], rows[4 * i + 1], rows[4 * i + 2], rows[4 * i + 3] = tile[0, i], tile[1, i], tile[2, i], tile[3, i]


@njit(cache=True, nogil=True)
def _locate(
    rows: NDArray[np.float32],
    scales: NDArray[np.float32],
    coordinates: NDArray[np.uint32],
    ones: NDArray[np.uint32],
    place: NDArray[np.uint32],
) -> None:
    """The places of the points of a tile, in steps, and 1 in the fourth word of each."""
    room, infinite = np.float32(_ROOM), np.float32(np.inf)
    hole, far = np.float32(-(2.0**31)), np.float32(_ROOM)  # `_HOLE` and `_FAR` with ROOM added
    for k in range(4 * TILE):
        steps = np.floor(rows[k] * scales[k])
        whole = np.int32(steps if abs(steps) < room else far if abs(steps) < infinite else hole)
        place[k] = ((np.uint32(whole) + np.uint32(_ROOM)) & coordinates[k]) | ones[k]


@njit(cache=True, nogil=True)
def _compare(place: NDArray[np.uint32], voxel: NDArray[np.uint32], changed: NDArray[np.uint32]) -> bool:
    """In which bits the voxel of a point differs from that before; False where the whole tile is a hole."""
    some = np.uint32(0)
    for k in range(4, 4 * TILE):
        differs = (place[k] ^ place[k - 4]) & voxel[k]
        changed[k] = differs
        some |= differs
    changed[:4] = 1
    return some != 0 or not (place[0] == _HOLE or place[1] == _HOLE or place[2] == _HOLE)


@njit(cache=True, nogil=True)
def _run_ends(
    place: NDArray[np.uint32], channels: NDArray[np.uint8], changed: NDArray[np.uint64], ends: NDArray[np.uint32]
) -> Any:
    """Running sums at the end of each run, in rows 1, 2, ... of 8 words; returns how many runs there are.

    Every point writes its sums to the row of its run, and the last ones stay: no branch that could be mispredicted. The
    sums overflow, which does not harm, as the difference of two is again exact. The eight are added at once. (Unsigned,
    because a signed index would be checked for counting from the end.)
    """
    x = y = z = n = blue = green = red = alpha = np.uint32(0)
    run, one = np.uint64(0), np.uint64(1)
    for i in range(np.uint64(TILE)):
        run += one if changed[np.uint64(2) * i] | changed[np.uint64(2) * i + one] else np.uint64(0)
        k, end, byte = np.uint64(4) * i, np.uint64(8) * run, np.uint64(16) * i + np.uint64(12)
        x += place[k]
        y += place[k + np.uint64(1)]
        z += place[k + np.uint64(2)]
        n += place[k + np.uint64(3)]
        blue += np.uint32(channels[byte])
        green += np.uint32(channels[byte + np.uint64(1)])
        red += np.uint32(channels[byte + np.uint64(2)])
        alpha += np.uint32(channels[byte + np.uint64(3)])
        ends[end] = x
        ends[end + np.uint64(1)] = y
        ends[end + np.uint64(2)] = z
        ends[end + np.uint64(3)] = n
        ends[end + np.uint64(4)] = blue
        ends[end + np.uint64(5)] = green
        ends[end + np.uint64(6)] = red
        ends[end + np.uint64(7)] = alpha
    return run


@njit(cache=True, nogil=True)
def _append(
    place: NDArray[np.uint32],
    ends: NDArray[np.uint32],
    found: Any,
    start: int,
    bits: int,
    keys: NDArray[np.uint64],
    runs: NDArray[np.uint32],
    firsts: NDArray[np.int32],
    box: NDArray[np.uint32],
    used: int,
) -> tuple[int, bool]:
    """Add the runs of a tile that are not holes to those of the cloud.

    Returns:
        How many there are then; and whether a place of the tile is out of room.
    """
    shift, inside = np.uint32(bits), np.uint32((1 << bits) - 1)
    last, first, valid = np.uint64(used), np.uint64(0), np.uint32(0x7FFFFFFF)
    far = False
    low_x, low_y, low_z, high_x, high_y, high_z = box[0, 0], box[0, 1], box[0, 2], box[1, 0], box[1, 1], box[1, 2]
    for run in range(np.uint64(found)):
        k, end = np.uint64(4) * first, np.uint64(8) * run
        x, y, z = place[k], place[k + np.uint64(1)], place[k + np.uint64(2)]
        n = ends[end + np.uint64(11)] - ends[end + np.uint64(3)]
        runs[last, 0] = ends[end + np.uint64(8)] - ends[end] - n * (x & ~inside)
        runs[last, 1] = ends[end + np.uint64(9)] - ends[end + np.uint64(1)] - n * (y & ~inside)
        runs[last, 2] = ends[end + np.uint64(10)] - ends[end + np.uint64(2)] - n * (z & ~inside)
        runs[last, 3] = n
        blue, green = (
            ends[end + np.uint64(12)] - ends[end + np.uint64(4)],
            ends[end + np.uint64(13)] - ends[end + np.uint64(5)],
        )
        red, alpha = (
            ends[end + np.uint64(14)] - ends[end + np.uint64(6)],
            ends[end + np.uint64(15)] - ends[end + np.uint64(7)],
        )
        runs[last, 4] = blue | (green << np.uint32(16))
        runs[last, 5] = red | (alpha << np.uint32(16))
        keys[last] = (
            np.uint64(x >> shift) | (np.uint64(y >> shift) << np.uint64(21)) | (np.uint64(z >> shift) << np.uint64(42))
        )
        if len(firsts):
            firsts[last] = start + first
        hole = (x | y | z) > valid
        far |= (x == _FAR) | (y == _FAR) | (z == _FAR)
        low_x, low_y, low_z = (low_x, low_y, low_z) if hole else (min(low_x, x), min(low_y, y), min(low_z, z))
        high_x, high_y, high_z = (high_x, high_y, high_z) if hole else (max(high_x, x), max(high_y, y), max(high_z, z))
        last += np.uint64(0) if hole else np.uint64(1)
        first += np.uint64(n)
    box[0, 0], box[0, 1], box[0, 2], box[1, 0], box[1, 1], box[1, 2] = low_x, low_y, low_z, high_x, high_y, high_z
    return np.int64(last), far  # type: ignore[return-value]  # int() would keep it unsigned


def _numbered(keys: NDArray[np.uint64], box: NDArray[np.int64], room: int) -> tuple[NDArray[np.uint32], int]:
    """Number of each run's voxel among the occupied ones in order, uint32 (R,), and how many are occupied.

    A map of one bit a voxel is used while it takes at most `room` bytes; a wider cloud is sorted instead.
    """
    number = scratch("voxel numbers", (len(keys),), np.uint32)
    if len(keys) == 0:
        return number, 0
    size = box[1] - box[0] + 1
    voxels = math.prod(float(edge) for edge in size.tolist())
    if voxels > min(8.0 * max(room, 2**20), 2.0**31 - 64):
        voxel, number[:] = np.unique(keys, return_inverse=True)
        return number, len(voxel)
    length = int(voxels) // 64 + 1
    occupied = scratch("voxel map", (length,), np.uint64, zeroed=True)
    before = scratch("voxel ranks", (length,), np.uint32)
    touched = scratch("voxel parts", (length // 64 + 1,), np.uint8, zeroed=True)
    return number, _number_by_map(keys, box[0], size, number, occupied, before, touched)


@njit(cache=True, nogil=True)
def _number_by_map(
    keys: NDArray[np.uint64],
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
    axis = np.int64(2 * _REACH - 1)
    size_x, size_y = size[0], size[1]
    least = low[0] + size_x * (low[1] + size_y * low[2])
    for run in range(len(keys)):
        key = np.int64(keys[run])
        number[run] = (key & axis) + size_x * (((key >> 21) & axis) + size_y * (key >> 42)) - least
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
def _ones(bits: Any) -> Any:
    """How many bits of a 64-bit word are set (Warren, Hacker's Delight, 2002)."""
    bits = bits - ((bits >> np.uint64(1)) & np.uint64(0x5555555555555555))
    bits = (bits & np.uint64(0x3333333333333333)) + ((bits >> np.uint64(2)) & np.uint64(0x3333333333333333))
    bits = (bits + (bits >> np.uint64(4))) & np.uint64(0x0F0F0F0F0F0F0F0F)
    return (bits * np.uint64(0x0101010101010101)) >> np.uint64(56)


@njit(cache=True, nogil=True)
def _totals(
    voxel: NDArray[np.uint32],
    keys: NDArray[np.uint64],
    runs: NDArray[np.uint32],
    bits: int,
    totals: NDArray[np.uint64],
) -> None:
    """Add the runs up, into (M, 6) x, y, z (places with `_ROOM` added), points, blue | red << 32, green | alpha << 32.

    Args:
        voxel: number of each run's voxel.
        keys: as `_runs` gives them.
        runs: as `_runs` gives them.
        bits: of the steps in a voxel.
        totals: gets the sums.
    """
    totals[:] = 0
    axis, shift, low, half = np.uint64(2 * _REACH - 1), np.uint64(bits), np.uint64(0xFFFF), np.uint64(16)
    for run in range(len(voxel)):
        here = voxel[run]
        key, points = keys[run], np.uint64(runs[run, 3])
        whole = points << shift
        totals[here, 0] += np.uint64(runs[run, 0]) + (key & axis) * whole
        totals[here, 1] += np.uint64(runs[run, 1]) + ((key >> np.uint64(21)) & axis) * whole
        totals[here, 2] += np.uint64(runs[run, 2]) + (key >> np.uint64(42)) * whole
        totals[here, 3] += points
        one, other = np.uint64(runs[run, 4]), np.uint64(runs[run, 5])
        totals[here, 4] += (one & low) | ((other & low) << np.uint64(32))
        totals[here, 5] += (one >> half) | ((other >> half) << np.uint64(32))


@njit(cache=True, nogil=True, error_model="numpy")  # no voxel is empty, and a test for it would cost a tenth
def _emit(totals: NDArray[np.int64], step: NDArray[np.float64], words: NDArray[np.float32], coloured: bool) -> None:
    """Write the averages, one voxel after the other, into 16-byte points; `step` in metres (3,)."""
    tile = new_tile()
    for start in range(0, len(totals), TILE):
        part = totals[start : start + TILE]
        _average(part, step, coloured, tile, tile[3].view(np.uint32))
        into = words[4 * start : 4 * (start + len(part))]
        for i in range(len(part)):
            into[4 * i], into[4 * i + 1], into[4 * i + 2], into[4 * i + 3] = (
                tile[0, i],
                tile[1, i],
                tile[2, i],
                tile[3, i],
            )


@njit(cache=True, nogil=True, error_model="numpy")
def _average(
    totals: NDArray[np.int64],
    step: NDArray[np.float64],
    coloured: bool,
    tile: NDArray[np.float32],
    colour: NDArray[np.uint32],
) -> None:
    """Averages of up to a tile of voxels, side by side."""
    tiny = 2.0**-34  # lifts a quotient that rounding left just below a whole number; others lie 1 / points below it
    origin = _ROOM - 0.5  # a place was cut off to the step below
    low = 0xFFFFFFFF
    sx, sy, sz = step[0], step[1], step[2]
    for i in range(len(totals)):
        share = 1.0 / totals[i, 3]
        tile[0, i] = np.float32((totals[i, 0] * share - origin) * sx)
        tile[1, i] = np.float32((totals[i, 1] * share - origin) * sy)
        tile[2, i] = np.float32((totals[i, 2] * share - origin) * sz)
    for i in range(len(totals)):
        share = 1.0 / totals[i, 3]
        even, odd = totals[i, 4], totals[i, 5]
        blue, red = np.int64((even & low) * share + tiny), np.int64(((even >> 32) & low) * share + tiny)
        green, alpha = np.int64((odd & low) * share + tiny), np.int64(((odd >> 32) & low) * share + tiny)
        colour[i] = blue | (green << 8) | (red << 16) | (alpha << 24)
    if not coloured:
        colour[: len(totals)] = 0


def warm_up() -> None:
    """Compile the kernels of this file."""
    points = np.zeros((8, 16), XYZRGB)
    points["x"], points["y"] = np.meshgrid(np.arange(16), np.arange(8))
    voxel_grid(points, 0.5)
