"""Voxel grid: one averaged point for every occupied cube of space."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from zsight_core.errors import GeometryError
from zsight_core.jit import njit
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
"""Places, in steps, lie in -ROOM .. ROOM-1; with ROOM added, others have bit 31 set."""

_CROWD = 2**32
"""As many points in a voxel as would have so many steps, and the sum of places might not fit 32 bits."""


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
            distances along x, y and z).
        PointsError: not a cloud, or `out` does not fit.
    """
    cloud = words_of(points)
    edges = _edges(leaf)
    bits = _fineness(float(edges.max()))
    colour = colour_field(points)
    packed = XYZRGB if colour else XYZ
    same = points.dtype == packed
    keys = scratch("voxel keys", (cloud.count + TILE,), np.uint64)
    runs = scratch("voxel runs", (8 * (cloud.count + TILE),), np.uint32)
    firsts = np.empty(0 if same else cloud.count + TILE, np.int32)
    used, far = _runs(cloud.words, cloud.layout, cloud.colour, _scale(edges, bits), bits, keys, runs, firsts)
    if far:
        bits = min(bits, _fineness_of_reach(cloud, edges, leaf))
        used, _ = _runs(cloud.words, cloud.layout, cloud.colour, _scale(edges, bits), bits, keys, runs, firsts)
    number, count = _numbered(keys[:used], cloud.words.nbytes)
    voxels, totals = scratch("voxels", (count,), np.uint64), scratch("voxel totals", (8 * count,), np.uint32)
    if _totals(number, keys, runs, voxels, totals) > _CROWD >> bits:
        totals = np.empty(8 * count, np.uint64)
        _totals(number, keys, runs, voxels, totals)
    averaged = room_for(points, count, out)[:, :count] if same else np.empty((1, count), packed)
    step = edges.astype(np.float64) / 2.0**bits
    _emit(voxels, totals, step, bits, record_words(averaged), colour is not None)
    if same:
        return averaged
    lengths = runs.reshape(-1, 8)[:used, 3].astype(np.int64)
    return _with_fields(points, averaged, firsts[:used], lengths, number)


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
) -> tuple[int, bool]:
    """Find the runs of successive points that share a voxel.

    Works on rows of four words a point, as a packed cloud has them: turning them into columns costs more than it helps.

    Args:
        words: the cloud.
        layout: of the words.
        colour: word of the packed colour, -1 without.
        scale: (3,) steps a metre.
        bits: of the steps in a voxel.
        keys: (R,) gets the voxel of each run, x | y << 21 | z << 42, counted from -2^30 steps.
        runs: (R * 8,) gets the sums of the lower bits of x, y and z, the number of points, and the sums of blue, green,
            red and alpha.
        firsts: gets the first point of each run, if it has room for them.

    Returns:
        How many runs there are; and whether a place is out of room: its point is left out like a hole.
    """
    count = len(words) // layout[0]
    packed = layout[0] == 4 and layout[1] == 0 and layout[2] == 1 and layout[3] == 2 and (colour == 3 or colour < 0)
    rows, scales = np.empty(4 * TILE, np.float32), np.zeros(4 * TILE, np.float32)
    low, high = np.ones(4 * TILE, np.float32), np.ones(4 * TILE, np.float32)
    for axis in range(3):
        scales[axis::4], low[axis::4], high[axis::4] = scale[axis], -(2.0**31), 2.0**31 - 128
    place, sums = np.empty(4 * TILE, np.int32), np.zeros(8 * (TILE + 1), np.int32)
    begins, marks = np.zeros(TILE, np.uint8), np.ones(TILE // 64 + 1, np.uint64)
    used, far = 0, False
    for start in range(0, count, TILE):
        if packed and start + TILE <= count:
            tile = words[4 * start : 4 * (start + TILE)]
        else:
            _load_rows(words, layout, colour, start, rows)
            tile = rows
        _locate(tile, scales, low, high, place)
        _mark_begins(place, np.int32(-1 << bits), begins)
        holes = True
        if _pack_marks(begins.view(np.uint64), marks) or min(place[0], place[1], place[2]) >= -_ROOM:
            _running_sums(place, tile.view(np.uint8), sums)
            used, holes = _append(place, sums, marks, start, bits, keys, runs, firsts, used)
        if holes:
            far |= _any_far(tile, scales)
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
    low: NDArray[np.float32],
    high: NDArray[np.float32],
    place: NDArray[np.int32],
) -> None:
    """The places of the points of a tile, in steps, between `low` and `high`; what is not a number becomes `low`."""
    for k in range(4 * TILE):
        steps = rows[k] * scales[k]
        steps = steps if steps > low[k] else low[k]  # noqa: FURB136  max() would keep a NaN
        steps = steps if steps < high[k] else high[k]  # noqa: FURB136
        place[k] = np.int32(np.floor(steps))


@njit(cache=True, nogil=True)
def _any_far(rows: NDArray[np.float32], scales: NDArray[np.float32]) -> bool:
    """Whether a coordinate of the tile is finite and out of room."""
    room, infinite, any_far = np.float32(_ROOM), np.float32(np.inf), False
    for k in range(4 * TILE):
        steps = abs(rows[k] * scales[k])
        any_far |= (steps >= room) & (steps < infinite)
    return any_far


@njit(cache=True, nogil=True)
def _mark_begins(place: NDArray[np.int32], voxel: Any, begins: NDArray[np.uint8]) -> None:
    """1 for each point but the first whose voxel, the upper bits of its place, is not that of the point before."""
    for i in range(1, TILE):
        x, y, z = (
            place[4 * i] ^ place[4 * i - 4],
            place[4 * i + 1] ^ place[4 * i - 3],
            place[4 * i + 2] ^ place[4 * i - 2],
        )
        begins[i] = np.uint8(1) if (x | y | z) & voxel else np.uint8(0)


@njit(cache=True, nogil=True)
def _pack_marks(eights: NDArray[np.uint64], marks: NDArray[np.uint64]) -> bool:
    """A bit for each byte that is 1; returns whether there is any."""
    some = np.uint64(0)
    for group in range(TILE // 64):
        mark = np.uint64(0)
        for k in range(8):
            mark |= ((eights[8 * group + k] * np.uint64(0x0102040810204080)) >> np.uint64(56)) << np.uint64(8 * k)
        marks[group] = mark
        some |= mark
    return bool(some)


@njit(cache=True, nogil=True)
def _running_sums(place: NDArray[np.int32], channels: NDArray[np.uint8], sums: NDArray[np.int32]) -> None:
    """Sums of all points before each, in rows of 8 words: x, y, z, anything, blue, green, red, alpha.

    They overflow, which does no harm, as the difference of two is again exact. The eight are added at once. (Unsigned,
    because a signed index would be checked for counting from the end.)
    """
    x = y = z = w = blue = green = red = alpha = np.int32(0)
    for i in range(np.uint64(TILE)):
        k, end, byte = np.uint64(4) * i, np.uint64(8) * i + np.uint64(8), np.uint64(16) * i + np.uint64(12)
        x += place[k]
        y += place[k + np.uint64(1)]
        z += place[k + np.uint64(2)]
        w += place[k + np.uint64(3)]
        blue += np.int32(channels[byte])
        green += np.int32(channels[byte + np.uint64(1)])
        red += np.int32(channels[byte + np.uint64(2)])
        alpha += np.int32(channels[byte + np.uint64(3)])
        sums[end] = x
        sums[end + np.uint64(1)] = y
        sums[end + np.uint64(2)] = z
        sums[end + np.uint64(3)] = w
        sums[end + np.uint64(4)] = blue
        sums[end + np.uint64(5)] = green
        sums[end + np.uint64(6)] = red
        sums[end + np.uint64(7)] = alpha


@njit(cache=True, nogil=True)
def _append(
    place: NDArray[np.int32],
    sums: NDArray[np.int32],
    marks: NDArray[np.uint64],
    start: int,
    bits: int,
    keys: NDArray[np.uint64],
    runs: NDArray[np.uint32],
    firsts: NDArray[np.int32],
    used: int,
) -> tuple[int, bool]:
    """Add the runs of a tile that are not holes to those of the cloud.

    Returns:
        How many there are then; and whether some of the tile are holes.
    """
    shift, outside, room = np.uint32(bits), np.int32(-1 << bits), np.int32(_ROOM)
    last, first, one, holes = np.uint64(used), np.uint64(0), np.uint64(1), np.uint64(0)
    for group in range(np.uint64(len(marks))):
        begins = marks[group]
        while begins:
            end = np.uint64(64) * group + _ones((begins - one) & ~begins)  # the lowest that is set
            begins &= begins - one
            k, a, b, n = np.uint64(4) * first, np.uint64(8) * first, np.uint64(8) * end, np.int32(end - first)
            x, y, z, w = place[k], place[k + np.uint64(1)], place[k + np.uint64(2)], place[k + np.uint64(3)]
            dx = sums[b] - sums[a] - np.int32(n * np.int32(x & outside))
            dy = sums[b + np.uint64(1)] - sums[a + np.uint64(1)] - np.int32(n * np.int32(y & outside))
            dz = sums[b + np.uint64(2)] - sums[a + np.uint64(2)] - np.int32(n * np.int32(z & outside))
            points = sums[b + np.uint64(3)] - sums[a + np.uint64(3)] - np.int32(n * np.int32(w & outside))
            blue = sums[b + np.uint64(4)] - sums[a + np.uint64(4)]
            green = sums[b + np.uint64(5)] - sums[a + np.uint64(5)]
            red = sums[b + np.uint64(6)] - sums[a + np.uint64(6)]
            alpha = sums[b + np.uint64(7)] - sums[a + np.uint64(7)]
            at = np.uint64(8) * last
            runs[at] = dx
            runs[at + np.uint64(1)] = dy
            runs[at + np.uint64(2)] = dz
            runs[at + np.uint64(3)] = points
            runs[at + np.uint64(4)] = blue
            runs[at + np.uint64(5)] = green
            runs[at + np.uint64(6)] = red
            runs[at + np.uint64(7)] = alpha
            place_x, place_y, place_z = np.uint32(x + room), np.uint32(y + room), np.uint32(z + room)
            keys[last] = (
                np.uint64(place_x >> shift)
                | (np.uint64(place_y >> shift) << np.uint64(21))
                | (np.uint64(place_z >> shift) << np.uint64(42))
            )
            if len(firsts):
                firsts[last] = start + first
            hole = (place_x | place_y | place_z) >> np.uint32(31)
            holes |= hole
            last += one - hole
            first = end
    return np.int64(last), holes != 0  # type: ignore[return-value]  # int() would keep it unsigned


def _numbered(keys: NDArray[np.uint64], room: int) -> tuple[NDArray[np.uint32], int]:
    """Number of each run's voxel among the occupied ones in order, uint32 (R,), and how many are occupied.

    A map of one bit a voxel is used while it takes at most `room` bytes; a wider cloud is sorted instead.
    """
    number = scratch("voxel numbers", (len(keys),), np.uint32)
    if len(keys) == 0:
        return number, 0
    low, high = _box_of(keys)
    size = high - low + 1
    if math.prod(float(edge) for edge in size.tolist()) > min(8.0 * max(room, 2**20), 2.0**31 - 64):
        voxel, number[:] = np.unique(keys, return_inverse=True)
        return number, len(voxel)
    length = int(size.prod()) // 64 + 1
    occupied = scratch("voxel map", (length,), np.uint64, zeroed=True)
    before = scratch("voxel ranks", (length,), np.uint32)
    touched = scratch("voxel parts", (length // 64 + 1,), np.uint8, zeroed=True)
    return number, _number_by_map(keys, low, size, number, occupied, before, touched)


@njit(cache=True, nogil=True)
def _box_of(keys: NDArray[np.uint64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The least and greatest numbers of voxels along each axis, (3,) each."""
    axis = np.uint64(2 * _REACH - 1)
    low_x = low_y = low_z = np.uint32(0xFFFFFFFF)
    high_x = high_y = high_z = np.uint32(0)
    for run in range(len(keys)):
        key = keys[run]
        x, y, z = np.uint32(key & axis), np.uint32((key >> np.uint64(21)) & axis), np.uint32(key >> np.uint64(42))
        low_x, low_y, low_z = min(low_x, x), min(low_y, y), min(low_z, z)
        high_x, high_y, high_z = max(high_x, x), max(high_y, y), max(high_z, z)
    low, high = np.empty(3, np.int64), np.empty(3, np.int64)
    low[0], low[1], low[2], high[0], high[1], high[2] = low_x, low_y, low_z, high_x, high_y, high_z
    return low, high


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
    six, low_bits, one, axis = np.uint32(6), np.uint32(63), np.uint64(1), np.uint64(2 * _REACH - 1)
    size_x, size_xy = np.uint64(size[0]), np.uint64(size[0] * size[1])
    least = np.uint64(low[0] + size[0] * (low[1] + size[1] * low[2]))
    for run in range(len(keys)):
        key = keys[run]
        x, y, z = key & axis, (key >> np.uint64(21)) & axis, key >> np.uint64(42)
        number[run] = x + size_x * y + size_xy * z - least
    for run in range(len(keys)):
        word = number[run] >> six
        occupied[word] |= one << np.uint64(number[run] & low_bits)
        touched[word >> six] = 1
    total = 0
    for part in range(len(touched)):
        if touched[part]:
            for word in range(64 * part, min(64 * part + 64, len(occupied))):
                before[word] = total
                total += int(_ones(occupied[word]))
    for run in range(len(keys)):
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
    number: NDArray[np.uint32],
    keys: NDArray[np.uint64],
    runs: NDArray[np.uint32],
    voxels: NDArray[np.uint64],
    totals: NDArray[Any],
) -> Any:
    """Add up the runs of each voxel.

    Args:
        number: of each run's voxel.
        keys: as `_runs` gives them.
        runs: as `_runs` gives them.
        voxels: (M,) gets the keys of the voxels.
        totals: (M * 8,) gets the sums of their runs.

    Returns:
        The most points that a voxel has.
    """
    totals[:] = 0
    most = np.uint64(0)
    for run in range(np.uint64(len(number))):
        k, r = np.uint64(8) * number[run], np.uint64(8) * run
        voxels[number[run]] = keys[run]
        a = totals[k] + runs[r]
        b = totals[k + np.uint64(1)] + runs[r + np.uint64(1)]
        c = totals[k + np.uint64(2)] + runs[r + np.uint64(2)]
        d = totals[k + np.uint64(3)] + runs[r + np.uint64(3)]
        e = totals[k + np.uint64(4)] + runs[r + np.uint64(4)]
        f = totals[k + np.uint64(5)] + runs[r + np.uint64(5)]
        g = totals[k + np.uint64(6)] + runs[r + np.uint64(6)]
        h = totals[k + np.uint64(7)] + runs[r + np.uint64(7)]
        totals[k] = a
        totals[k + np.uint64(1)] = b
        totals[k + np.uint64(2)] = c
        totals[k + np.uint64(3)] = d
        totals[k + np.uint64(4)] = e
        totals[k + np.uint64(5)] = f
        totals[k + np.uint64(6)] = g
        totals[k + np.uint64(7)] = h
        most = max(most, np.uint64(totals[k + np.uint64(3)]))  # read back: taken out of the row, it would break it up
    return most


@njit(cache=True, nogil=True, error_model="numpy")  # no voxel is empty, and a test for it would cost a tenth
def _emit(
    keys: NDArray[np.uint64],
    totals: NDArray[Any],
    step: NDArray[np.float64],
    bits: int,
    words: NDArray[np.float32],
    coloured: bool,
) -> None:
    """Write the averages, one voxel after the other, into 16-byte points; `step` in metres (3,)."""
    tiny = 2.0**-34  # lifts a quotient that rounding left just below a whole number; others lie 1 / points below it
    origin = _ROOM - 0.5  # a place was cut off to the step below
    whole = 2.0**bits
    channels, colours = words.view(np.uint8), words.view(np.uint32)
    sx, sy, sz = step[0], step[1], step[2]
    axis = np.uint64(2 * _REACH - 1)
    for i in range(np.uint64(len(keys))):
        key, k = keys[i], np.uint64(8) * i
        v, c = np.uint64(4) * i, np.uint64(16) * i + np.uint64(12)
        share = 1.0 / totals[k + np.uint64(3)]
        x = (totals[k] * share + (np.int64(key & axis) * whole - origin)) * sx
        y = (totals[k + np.uint64(1)] * share + (np.int64((key >> np.uint64(21)) & axis) * whole - origin)) * sy
        z = (totals[k + np.uint64(2)] * share + (np.int64(key >> np.uint64(42)) * whole - origin)) * sz
        blue = np.uint8(np.int32(totals[k + np.uint64(4)] * share + tiny))
        green = np.uint8(np.int32(totals[k + np.uint64(5)] * share + tiny))
        red = np.uint8(np.int32(totals[k + np.uint64(6)] * share + tiny))
        alpha = np.uint8(np.int32(totals[k + np.uint64(7)] * share + tiny))
        words[v] = x
        words[v + np.uint64(1)] = y
        words[v + np.uint64(2)] = z
        channels[c] = blue
        channels[c + np.uint64(1)] = green
        channels[c + np.uint64(2)] = red
        channels[c + np.uint64(3)] = alpha
    if not coloured:
        colours[3::4] = 0


def warm_up() -> None:
    """Compile the kernels of this file."""
    points = np.zeros((8, 16), XYZRGB)
    points["x"], points["y"] = np.meshgrid(np.arange(16), np.arange(8))
    voxel_grid(points, 0.5)
    voxel_grid(np.zeros((1, 4096), XYZ), 8.0)  # more in a voxel than 32 bits hold
    voxel_grid(np.zeros((1, 4096), XYZ), 8.0)
