"""Voxel grid: one averaged point for every occupied cube of space."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numba import njit

from zsight_core.errors import GeometryError
from zsight_core.points import XYZ, XYZRGB, Points
from zsight_core.words import colour_field, record_words, words_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from zsight_core.words import Layout

__all__ = ["voxel_grid", "warm_up"]

_REACH = 2**20
"""Voxel numbers along an axis lie in -REACH .. REACH-1, so that three of them fit one 64-bit key."""

_TILE = 256


def voxel_grid(points: Points, leaf: float | tuple[float, float, float]) -> Points:
    """Average the points of each voxel.

    A point belongs to the voxel floor(x / leaf), floor(y / leaf), floor(z / leaf), reckoned in float32 so that the set
    of voxels is PCL's; a point with a coordinate that is not finite belongs to none. Colours are averaged channel by
    channel and truncated, as PCL does; every other numeric field is averaged too, integers truncated.

    Args:
        points: (H, W).
        leaf: edge of a voxel, or its edges along x, y and z; metres.

    Returns:
        (1, M) points of the input's dtype in PCL's order of voxels: x runs fastest, z slowest.

    Raises:
        GeometryError: an edge is not above zero, or a coordinate lies 2^20 voxels or more from the origin.
        PointsError: not a cloud.
    """
    cloud = words_of(points)
    inverse = np.float32(1) / _edges(leaf)
    colour = colour_field(points)
    others = [name for name in points.dtype.names or () if name not in ("x", "y", "z", colour)]
    slots = np.empty(cloud.count if others else 0, np.int32)
    keys, sums, colours = _accumulate(cloud.words, cloud.layout, cloud.colour, inverse, slots)
    if len(keys) == 1 and keys[0] < 0:
        raise GeometryError(_overflow(cloud.words, cloud.layout, leaf))
    order = np.argsort(keys) if len(keys) < 64 else _sorted_order(keys)
    averaged = np.zeros((1, len(keys)), XYZRGB if colour else XYZ)
    _emit(order, sums, colours, record_words(averaged), averaged.dtype.itemsize // 4, colour is not None)
    if averaged.dtype == points.dtype:
        return averaged
    return _with_fields(points, averaged, others, slots, order)


def _edges(leaf: float | tuple[float, float, float]) -> NDArray[np.float32]:
    edges = np.broadcast_to(np.asarray(leaf, dtype=np.float32), (3,))
    if not (np.isfinite(edges).all() and (edges > 0).all()):
        raise GeometryError(f"leaf is {leaf} m; expected one length above zero, or three")
    return edges


def _overflow(words: NDArray[np.float32], layout: Layout, leaf: float | tuple[float, float, float]) -> str:
    rows = words.reshape(-1, layout[0])[:, list(layout[1:])]
    farthest = float(np.abs(rows[np.isfinite(rows).all(axis=1)]).max())
    return f"leaf {leaf} m is too small for coordinates up to {farthest:g} m: at most 2^20 voxels on either side of 0"


def _with_fields(
    points: Points, averaged: Points, others: list[str], slots: NDArray[np.int32], order: NDArray[np.int64]
) -> Points:
    """The averaged coordinates and colours in the input's dtype, with its further fields averaged as well."""
    result = np.zeros(averaged.shape, points.dtype)
    for axis in "xyz":
        result[axis] = averaged[axis]
    colour = colour_field(points)
    if colour:
        result[colour] = np.ascontiguousarray(averaged["rgb"]).view(points.dtype[colour].newbyteorder("="))
    inside = slots >= 0
    rank = np.empty(len(order), np.int64)
    rank[order] = np.arange(len(order))
    voxel = rank[slots[inside]]
    count = np.bincount(voxel, minlength=len(order))
    for name in others:
        values = points[name].reshape(len(slots), -1)[inside].astype(np.float64)
        means = [np.bincount(voxel, weights=column, minlength=len(order)) / count for column in values.T]
        result[name] = np.stack(means, axis=-1).reshape(result[name].shape)
    return result


@njit(cache=True, nogil=True)
def _accumulate(
    words: NDArray[np.float32], layout: Layout, colour: int, inverse: NDArray[np.float32], slots: NDArray[np.int32]
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.uint32]]:
    """Sums of each voxel in the order of first appearance.

    Returns:
        keys int64 (M,), x fastest; sums float64 (M, 4): x, y, z, count; colours uint32 (M, 4): blue, green, red,
        alpha. One negative key alone: a coordinate was out of reach.
    """
    step, at_x, at_y, at_z = layout
    count = len(words) // step
    capacity = 4096
    table = np.full(2 * capacity, -1, np.int32)
    keys = np.empty(capacity, np.int64)
    sums = np.zeros((capacity, 4))
    colours = np.zeros((capacity, 4), np.uint32)
    used = 0
    tile_keys = np.empty(_TILE, np.int64)
    for start in range(0, count, _TILE):
        stop = min(count, start + _TILE)
        tile = words[step * start : step * stop]
        if step == 4 and at_x == 0 and at_y == 1 and at_z == 2:
            reached = _tile_keys(tile, 4, 0, 1, 2, inverse, tile_keys)
        else:
            reached = _tile_keys(tile, step, at_x, at_y, at_z, inverse, tile_keys)
        if not reached:
            return np.full(1, -1, np.int64), sums, colours
        if used + _TILE > capacity:
            capacity *= 2
            keys = _grown(keys, capacity)
            sums = _grown_rows(sums, capacity)
            colours = _grown_rows(colours, capacity)
            table = _table(keys, used, 2 * capacity)
        tile_slots = slots[start:stop] if len(slots) > 0 else slots
        used = _add_tile(tile, layout, colour, tile_keys, table, keys, sums, colours, used, tile_slots)
    return keys[:used], sums[:used], colours[:used]


@njit(cache=True, nogil=True)
def _add_tile(
    tile: NDArray[np.float32],
    layout: Layout,
    colour: int,
    tile_keys: NDArray[np.int64],
    table: NDArray[np.int32],
    keys: NDArray[np.int64],
    sums: NDArray[np.float64],
    colours: NDArray[np.uint32],
    used: int,
    slots: NDArray[np.int32],
) -> int:
    """Add the points of a tile to their voxels; returns how many voxels there are now.

    Neighbours in an organised cloud mostly share their voxel: a run of them is summed in registers and costs one look
    into the hash table.
    """
    step, at_x, at_y, at_z = layout
    bits = tile.view(np.uint32)
    count = len(tile) // step
    first = 0
    while first < count:
        key = tile_keys[first]
        last = first + 1
        while last < count and tile_keys[last] == key:
            last += 1
        slot = -1
        if key >= 0:
            place = _place(table, keys, key)
            slot = table[place]
            if slot < 0:
                slot = used
                table[place] = slot
                keys[slot] = key
                used += 1
            sx = sy = sz = 0.0
            for i in range(first, last):
                sx += tile[step * i + at_x]
                sy += tile[step * i + at_y]
                sz += tile[step * i + at_z]
            sums[slot, 0] += sx
            sums[slot, 1] += sy
            sums[slot, 2] += sz
            sums[slot, 3] += last - first
            if colour >= 0:
                # two channels in one integer, 32 bits apart: sums of 8-bit values cannot meet
                even = odd = np.uint64(0)
                for i in range(first, last):
                    packed = np.uint64(bits[step * i + colour])
                    even += (packed & np.uint64(0xFF)) | ((packed & np.uint64(0xFF0000)) << np.uint64(16))
                    odd += ((packed >> np.uint64(8)) & np.uint64(0xFF)) | ((packed >> np.uint64(24)) << np.uint64(32))
                colours[slot, 0] += np.uint32(even & np.uint64(0xFFFFFFFF))
                colours[slot, 1] += np.uint32(odd & np.uint64(0xFFFFFFFF))
                colours[slot, 2] += np.uint32(even >> np.uint64(32))
                colours[slot, 3] += np.uint32(odd >> np.uint64(32))
        if len(slots) > 0:
            slots[first:last] = slot
        first = last
    return used


@njit(cache=True, nogil=True)
def _table(keys: NDArray[np.int64], used: int, size: int) -> NDArray[np.int32]:
    """An open hash table of the first `used` keys; its size is a power of two."""
    table = np.full(size, -1, np.int32)
    for slot in range(used):
        table[_place(table, keys, keys[slot])] = slot
    return table


@njit(cache=True, nogil=True)
def _tile_keys(
    tile: NDArray[np.float32],
    step: int,
    at_x: int,
    at_y: int,
    at_z: int,
    inverse: NDArray[np.float32],
    keys: NDArray[np.int64],
) -> bool:
    """Key of the voxel of each point, -1 for a point that is not finite; False where one is out of reach."""
    ix, iy, iz = inverse[0], inverse[1], inverse[2]
    reach = np.float32(_REACH)
    zero = np.float32(0)
    far = 0
    for k in range(len(tile) // step):
        x = tile[step * k + at_x]
        y = tile[step * k + at_y]
        z = tile[step * k + at_z]
        finite = (x - x) + (y - y) + (z - z) == zero
        x = np.floor((x if finite else zero) * ix)
        y = np.floor((y if finite else zero) * iy)
        z = np.floor((z if finite else zero) * iz)
        near = x >= -reach and x < reach and y >= -reach and y < reach and z >= -reach and z < reach
        far += 0 if near else 1
        x = x if near else zero
        y = y if near else zero
        z = z if near else zero
        key = ((np.int64(z) + _REACH) << 42) | ((np.int64(y) + _REACH) << 21) | (np.int64(x) + _REACH)
        keys[k] = key if finite else np.int64(-1)
    return far == 0


@njit(cache=True, nogil=True)
def _place(table: NDArray[np.int32], keys: NDArray[np.int64], key: int) -> int:
    """Where `key` stands in the open table, or the free place where it belongs; its length is a power of two."""
    mask = len(table) - 1
    mixed = np.uint64(key) * np.uint64(0x9E3779B97F4A7C15)
    place = int(mixed >> np.uint64(32)) & mask
    while table[place] >= 0 and keys[table[place]] != key:
        place = (place + 1) & mask
    return place


@njit(cache=True, nogil=True)
def _grown(row: NDArray[np.int64], capacity: int) -> NDArray[np.int64]:
    grown = np.empty(capacity, row.dtype)
    grown[: len(row)] = row
    return grown


@njit(cache=True, nogil=True)
def _grown_rows(rows: NDArray[Any], capacity: int) -> NDArray[Any]:
    grown = np.zeros((capacity, rows.shape[1]), rows.dtype)
    grown[: len(rows)] = rows
    return grown


@njit(cache=True, nogil=True)
def _sorted_order(keys: NDArray[np.int64]) -> NDArray[np.int64]:
    """Indices that sort the keys: radix sort over the bits in which they differ at all."""
    differ = np.int64(0)
    for key in keys:
        differ |= key ^ keys[0]
    order = np.arange(len(keys))
    other = np.empty(len(keys), np.int64)
    counts = np.empty(2048, np.int64)
    for shift in range(0, 63, 11):
        if (differ >> shift) & 2047 == 0:
            continue
        counts[:] = 0
        for key in keys:
            counts[(key >> shift) & 2047] += 1
        total = 0
        for digit in range(2048):
            counts[digit], total = total, total + counts[digit]
        for i in order:
            digit = (keys[i] >> shift) & 2047
            other[counts[digit]] = i
            counts[digit] += 1
        order, other = other, order
    return order


@njit(cache=True, nogil=True)
def _emit(
    order: NDArray[np.int64],
    sums: NDArray[np.float64],
    colours: NDArray[np.uint32],
    words: NDArray[np.float32],
    step: int,
    coloured: bool,
) -> None:
    """Write the averages, one voxel after the other, into words laid out as XYZ or XYZRGB."""
    bits = words.view(np.uint32)
    for k in range(len(order)):
        slot = order[k]
        count = sums[slot, 3]
        for axis in range(3):
            words[step * k + axis] = np.float32(sums[slot, axis] / count)
        if coloured:
            n = np.uint32(count)
            packed = np.uint32(0)
            for channel in range(4):
                packed |= np.uint32((colours[slot, channel] // n) << np.uint32(8 * channel))
            bits[step * k + 3] = packed


def warm_up() -> None:
    """Compile the kernels of this file."""
    points = np.zeros((8, 16), XYZRGB)
    points["x"], points["y"] = np.meshgrid(np.arange(16), np.arange(8))
    voxel_grid(points, 0.5)
