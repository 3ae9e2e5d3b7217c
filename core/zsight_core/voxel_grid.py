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
from zsight_core.tile import TILE, lies_packed, load_tile, new_tile
from zsight_core.words import colour_field, record_words, words_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from zsight_core.words import Layout, Words

__all__ = ["voxel_grid", "warm_up"]

_Triple = tuple[int, int, int]
"""Along x, y and z."""

_REACH = 2**20
"""Voxel numbers along an axis lie in -REACH .. REACH-1, so that three of them fit one 64-bit key."""

_NAN = -(2**31)
"""The place of an x that is not a number; places that are out of room lie above it, in other voxels."""

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
    bits = _fineness(max(edges.tolist()))
    packed = XYZ if cloud.colour < 0 else XYZRGB
    same = points.dtype == packed
    keys = scratch("voxel keys", (cloud.count + TILE,), np.uint64)
    runs = scratch("voxel runs", (8 * (cloud.count + TILE),), np.uint32)
    firsts = np.empty(0 if same else cloud.count + TILE, np.int32)
    used, far, low, size = _runs(cloud.words, cloud.layout, cloud.colour, edges, bits, keys, runs, firsts)
    if far:
        bits = min(bits, _fineness_of_reach(cloud, edges, leaf))
        used, _, low, size = _runs(cloud.words, cloud.layout, cloud.colour, edges, bits, keys, runs, firsts)
    number, count = _numbered(keys[:used], low, size, cloud.words.nbytes)
    voxels, totals = scratch("voxels", (count,), np.uint64), scratch("voxel totals", (8 * count,), np.uint32)
    if _totals(number, keys, runs, voxels, totals) > _CROWD >> bits:
        totals = np.empty(8 * count, np.uint64)
        _totals(number, keys, runs, voxels, totals)
    averaged = room_for(points, count, out)[:, :count] if same else np.empty((1, count), packed)
    _emit(voxels, totals, edges, bits, record_words(averaged), cloud.colour >= 0)
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
    edges: NDArray[np.float32],
    bits: int,
    keys: NDArray[np.uint64],
    runs: NDArray[np.uint32],
    firsts: NDArray[np.int32],
) -> tuple[int, bool, _Triple, _Triple]:
    """Find the runs of successive points that share a voxel.

    Works on rows of four words a point, as a packed cloud has them. No part of an array is taken within the loop:
    counting who refers to it would cost a tenth.

    Args:
        words: the cloud.
        layout: of the words.
        colour: word of the packed colour, -1 without.
        edges: (3,) of a voxel, metres.
        bits: of the steps in a voxel.
        keys: (R,) gets the voxel of each run, x | y << 21 | z << 42, counted from -2^30 steps.
        runs: (R * 8,) gets the sums of the lower bits of x, y and z, the number of points, and the sums of blue, green,
            red and alpha.
        firsts: gets the first point of each run, if it has room for them.

    Returns:
        How many runs there are; whether a place is out of room: its point is left out like a hole; the least number of
        a voxel along each axis, and how many there are from it to the greatest.
    """
    count = len(words) // layout[0]
    in_rows = lies_packed(words, layout, 0) and (colour == 3 or colour < 0)
    scale = np.float32(1) / edges * np.float32(2**bits)  # a power of two times PCL's, so that roundings are the same
    rows = np.empty(4 * TILE, np.float32)
    words_channels, rows_channels = words.view(np.uint8), rows.view(np.uint8)
    inner, voxel = np.empty(4 * TILE, np.int32), np.empty(3 * TILE, np.int32)
    begins, marks = np.zeros(TILE, np.uint8), np.ones(TILE // 64 + 1, np.uint64)
    eights, sums = begins.view(np.uint64), np.zeros(8 * (TILE + 1), np.int32)
    used, far = 0, False
    for start in range(0, count, TILE):
        direct = in_rows and start + TILE <= count
        if direct:
            _locate(words, np.uint64(4 * start), scale, bits, inner, voxel)
        else:
            _load_rows(words, layout, colour, start, rows)
            _locate(rows, np.uint64(0), scale, bits, inner, voxel)
        _mark_begins(voxel, begins)
        if _pack_marks(eights, marks) or min(voxel[0], voxel[TILE], voxel[2 * TILE]) >= -_ROOM:
            if direct:
                _running_sums(inner, words_channels, np.uint64(16 * start), sums)
            else:
                _running_sums(inner, rows_channels, np.uint64(0), sums)
            used, odd = _append(voxel, sums, marks, start, bits, keys, runs, firsts, used)
        else:
            odd = voxel[0] != _NAN
        if odd:
            far |= _any_far(words, 4 * start, scale) if direct else _any_far(rows, 0, scale)
    low, size = _box_of(keys[:used])
    return used, far, low, size


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
    at: Any,
    scale: NDArray[np.float32],
    bits: int,
    inner: NDArray[np.int32],
    voxel: NDArray[np.int32],
) -> None:
    """The places, in steps, of the points of a tile whose rows begin at word `at`.

    Lower bits go to `inner`, in rows with a 1 as the fourth; the upper ones to `voxel`, in columns. What is out of room
    or not a number stays so; an x that is not a number becomes `_NAN`, which no number does.

    The fourth word chooses between two ones: of rows that are read in part the compiler would do the last ones of each
    tile one by one. (Places are unsigned, because a signed one would be checked for counting from the end.)
    """
    low, high = np.float32(2.0**22 - 2.0**31), np.float32(2.0**31 - 128)
    lowest = np.float32(_NAN)
    within, beyond = np.int32((1 << bits) - 1), np.int32(-1 << bits)
    one, same_one = np.int32(bits > 0), np.int32(bits > 1)
    for i in range(np.uint64(TILE)):
        k = np.uint64(4) * i
        x, y, z = rows[at + k], rows[at + k + np.uint64(1)], rows[at + k + np.uint64(2)]
        w = rows[at + k + np.uint64(3)]
        x, y, z = x * scale[0], y * scale[1], z * scale[2]
        x = low if x < low else x  # noqa: FURB136  a NaN stays
        x = x if x > lowest else lowest  # noqa: FURB136  max() would keep a NaN
        y = y if y > low else low  # noqa: FURB136
        z = z if z > low else low  # noqa: FURB136
        x, y, z = min(x, high), min(y, high), min(z, high)
        a, b, c = np.int32(np.floor(x)), np.int32(np.floor(y)), np.int32(np.floor(z))
        inner[k] = a & within
        inner[k + np.uint64(1)] = b & within
        inner[k + np.uint64(2)] = c & within
        inner[k + np.uint64(3)] = one if w > low else same_one
        voxel[i] = a & beyond
        voxel[i + np.uint64(TILE)] = b & beyond
        voxel[i + np.uint64(2 * TILE)] = c & beyond


@njit(cache=True, nogil=True)
def _any_far(rows: NDArray[np.float32], at: int, scale: NDArray[np.float32]) -> bool:
    """Whether a coordinate of the tile whose rows begin at word `at` is finite and out of room."""
    room, infinite, any_far = np.float32(_ROOM), np.float32(np.inf), False
    for i in range(TILE):
        for axis in range(3):
            steps = abs(rows[at + 4 * i + axis] * scale[axis])
            any_far |= (steps >= room) & (steps < infinite)
    return any_far


@njit(cache=True, nogil=True)
def _mark_begins(voxel: NDArray[np.int32], begins: NDArray[np.uint8]) -> None:
    """1 for each point but the first whose voxel is not that of the point before."""
    for i in range(np.uint64(1), np.uint64(TILE)):
        x = voxel[i] ^ voxel[i - np.uint64(1)]
        y = voxel[i + np.uint64(TILE)] ^ voxel[i + np.uint64(TILE - 1)]
        z = voxel[i + np.uint64(2 * TILE)] ^ voxel[i + np.uint64(2 * TILE - 1)]
        begins[i] = np.uint8(1) if x | y | z else np.uint8(0)


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
def _running_sums(inner: NDArray[np.int32], channels: NDArray[np.uint8], at: Any, sums: NDArray[np.int32]) -> None:
    """Sums of all points before each, in rows of 8 words: x, y, z within voxels, a count, blue, green, red, alpha.

    They overflow, which does no harm, as the difference of two is again exact. The eight are added at once. The rows of
    the tile begin at byte `at`.
    """
    x = y = z = w = blue = green = red = alpha = np.int32(0)
    for i in range(np.uint64(TILE)):
        k, end, byte = np.uint64(4) * i, np.uint64(8) * i + np.uint64(8), at + np.uint64(16) * i + np.uint64(12)
        x += inner[k]
        y += inner[k + np.uint64(1)]
        z += inner[k + np.uint64(2)]
        w += inner[k + np.uint64(3)]
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
    voxel: NDArray[np.int32],
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
        How many there are then; and whether one is left out though its x is a number.
    """
    shift, room = np.uint32(bits), np.int32(_ROOM)
    last, first, one, odd = np.uint64(used), np.uint64(0), np.uint64(1), np.uint64(0)
    for group in range(np.uint64(len(marks))):
        begins = marks[group]
        while begins:
            end = np.uint64(64) * group + _ones((begins - one) & ~begins)  # the lowest that is set
            begins &= begins - one
            a, b = np.uint64(8) * first, np.uint64(8) * end
            dx = sums[b] - sums[a]
            dy = sums[b + np.uint64(1)] - sums[a + np.uint64(1)]
            dz = sums[b + np.uint64(2)] - sums[a + np.uint64(2)]
            points = sums[b + np.uint64(3)] - sums[a + np.uint64(3)]
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
            x, y, z = voxel[first], voxel[first + np.uint64(TILE)], voxel[first + np.uint64(2 * TILE)]
            from_x, from_y, from_z = np.uint32(x + room), np.uint32(y + room), np.uint32(z + room)
            keys[last] = (
                np.uint64(from_x >> shift)
                | (np.uint64(from_y >> shift) << np.uint64(21))
                | (np.uint64(from_z >> shift) << np.uint64(42))
            )
            if len(firsts):
                firsts[last] = start + first
            hole = np.uint64((from_x | from_y | from_z) >> np.uint32(31))
            odd |= hole & np.uint64(x != _NAN)
            last += one - hole
            first = end
    return np.int64(last), odd != 0  # type: ignore[return-value]  # int() would keep it unsigned


def _numbered(keys: NDArray[np.uint64], low: _Triple, size: _Triple, room: int) -> tuple[NDArray[np.uint32], int]:
    """Number of each run's voxel among the occupied ones in order, uint32 (R,), and how many are occupied.

    A map of one bit a voxel is used while it takes at most `room` bytes; a wider cloud is sorted instead.
    """
    number = scratch("voxel numbers", (len(keys),), np.uint32)
    if len(keys) == 0:
        return number, 0
    box = math.prod(size)
    if box > min(8 * max(room, 2**20), 2**31 - 64):
        voxel, number[:] = np.unique(keys, return_inverse=True)
        return number, len(voxel)
    length = box // 64 + 1
    occupied = scratch("voxel map", (length,), np.uint64, zeroed=True)
    before = scratch("voxel ranks", (length,), np.uint32)
    touched = scratch("voxel parts", (length // 64 + 1,), np.uint8, zeroed=True)
    return number, _number_by_map(keys, low, size, number, occupied, before, touched)


@njit(cache=True, nogil=True)
def _box_of(keys: NDArray[np.uint64]) -> tuple[_Triple, _Triple]:
    """The least number of a voxel along each axis, and how many there are from it to the greatest."""
    axis = np.uint64(2 * _REACH - 1)
    low_x = low_y = low_z = np.uint32(0xFFFFFFFF)
    high_x = high_y = high_z = np.uint32(0)
    for run in range(len(keys)):
        key = keys[run]
        x, y, z = np.uint32(key & axis), np.uint32((key >> np.uint64(21)) & axis), np.uint32(key >> np.uint64(42))
        low_x, low_y, low_z = min(low_x, x), min(low_y, y), min(low_z, z)
        high_x, high_y, high_z = max(high_x, x), max(high_y, y), max(high_z, z)
    low = (np.int64(low_x), np.int64(low_y), np.int64(low_z))
    high = (np.int64(high_x), np.int64(high_y), np.int64(high_z))
    return low, (high[0] - low[0] + 1, high[1] - low[1] + 1, high[2] - low[2] + 1)  # type: ignore[return-value]


@njit(cache=True, nogil=True)
def _number_by_map(
    keys: NDArray[np.uint64],
    low: _Triple,
    size: _Triple,
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
    edges: NDArray[np.float32],
    bits: int,
    words: NDArray[np.float32],
    coloured: bool,
) -> None:
    """Write the averages, one voxel after the other, into 16-byte points."""
    tiny = 2.0**-34  # lifts a quotient that rounding left just below a whole number; others lie 1 / points below it
    origin = _ROOM - 0.5  # a place was cut off to the step below
    whole = 2.0**bits
    channels, colours = words.view(np.uint8), words.view(np.uint32)
    sx, sy, sz = edges[0] / whole, edges[1] / whole, edges[2] / whole  # metres a step
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
