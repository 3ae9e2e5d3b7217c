"""Centroid, bounding box and average colour of a cloud."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from zsight_core.errors import GeometryError, PointsError
from zsight_core.jit import njit
from zsight_core.tile import TILE, load_tile, new_tile
from zsight_core.words import words_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from zsight_core.points import Points
    from zsight_core.words import Layout

_MOST = 0x7FFFFFFF

__all__ = ["average_colour", "bounding_box", "centroid", "count_finite", "warm_up"]


def centroid(cloud: Points | NDArray[np.floating[Any]]) -> NDArray[np.float64]:
    """Mean (3,) of the finite points, metres.

    Raises:
        GeometryError: there is none.
    """
    words = words_of(cloud)
    sums = _sums(words.words, words.layout)
    _require_points(sums[3])
    mean: NDArray[np.float64] = sums[:3] / sums[3]
    return mean


def count_finite(cloud: Points | NDArray[np.floating[Any]]) -> int:
    """How many points have finite x, y and z."""
    words = words_of(cloud)
    return int(_sums(words.words, words.layout)[3])


def bounding_box(cloud: Points | NDArray[np.floating[Any]]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Least and greatest coordinates, (3,) and (3,), of the finite points, metres.

    Raises:
        GeometryError: there is none.
    """
    words = words_of(cloud)
    low, high = _bounds(words.words, words.layout)
    _require_points(low[0] <= high[0])
    return low, high


def average_colour(points: Points) -> tuple[int, int, int]:
    """Mean red, green, blue in 0..255 of the points with finite coordinates, rounded.

    Raises:
        PointsError: the cloud has no colour.
        GeometryError: no point is finite.
    """
    words = words_of(points)
    if words.colour < 0:
        raise PointsError(f"cloud has fields {', '.join(points.dtype.names or ())}; expected rgb among them")
    red, green, blue, count = _colour_sums(words.words, words.layout, words.colour)
    _require_points(count)
    return round(red / count), round(green / count), round(blue / count)


def _require_points(some: float | bool) -> None:
    if not some:
        raise GeometryError("no point of the cloud has finite coordinates; expected at least one")


@njit(cache=True, nogil=True)
def _sums(words: NDArray[np.float32], layout: Layout) -> NDArray[np.float64]:
    """(4,) sums of x, y, z over the finite points, and their count."""
    sums = np.zeros(4)
    tile = new_tile()
    for start in range(0, len(words) // layout[0], TILE):
        load_tile(words, layout, -1, start, tile)
        _add_tile(tile, sums)
    return sums


@njit(cache=True, nogil=True, fastmath={"reassoc", "nsz", "contract"})  # a sum in any order is as good; NaNs are kept
def _add_tile(tile: NDArray[np.float32], sums: NDArray[np.float64]) -> None:
    """Sums about the tile's first point keep float32 as exact as it is."""
    zero, infinite = np.float32(0), np.float32(np.inf)
    sx = sy = sz = n = zero
    px = tile[0, 0] if abs(tile[0, 0]) < infinite else zero
    py = tile[1, 0] if abs(tile[1, 0]) < infinite else zero
    pz = tile[2, 0] if abs(tile[2, 0]) < infinite else zero
    for i in range(TILE):
        x, y, z = tile[0, i], tile[1, i], tile[2, i]
        finite = (abs(x) < infinite) & (abs(y) < infinite) & (abs(z) < infinite)
        sx += x - px if finite else zero
        sy += y - py if finite else zero
        sz += z - pz if finite else zero
        n += np.float32(1) if finite else zero
    sums[0] += sx + float(n) * px
    sums[1] += sy + float(n) * py
    sums[2] += sz + float(n) * pz
    sums[3] += n


@njit(cache=True, nogil=True)
def _bounds(words: NDArray[np.float32], layout: Layout) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Least and greatest of each axis over the finite points; infinities the wrong way round without any.

    The bits of a float, its lower 31 flipped when it is negative, are ordered as the floats are, and the least of
    integers is found many at a time where NaN forbids that for floats.
    """
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    limits = np.array([_MOST, _MOST, _MOST, -_MOST, -_MOST, -_MOST], dtype=np.int32)
    tile = new_tile()
    bits = tile.view(np.int32)
    for start in range(0, len(words) // layout[0], TILE):
        load_tile(words, layout, -1, start, tile)
        _widen(bits, limits)
    if limits[0] <= limits[3]:
        for axis in range(3):
            low[axis] = _from_ordered(limits[axis])
            high[axis] = _from_ordered(limits[3 + axis])
    return low, high


@njit(cache=True, nogil=True)
def _widen(bits: NDArray[np.int32], limits: NDArray[np.int32]) -> None:
    """Widen limits (6,), in ordered integers, by the points of a tile."""
    exponent, rest = np.int32(0x7F800000), np.int32(0x7FFFFFFF)
    most, least = np.int32(_MOST), np.int32(-_MOST)
    lx, ly, lz, hx, hy, hz = limits[0], limits[1], limits[2], limits[3], limits[4], limits[5]
    for i in range(TILE):
        x, y, z = bits[0, i], bits[1, i], bits[2, i]
        finite = ((x & exponent) != exponent) & ((y & exponent) != exponent) & ((z & exponent) != exponent)
        x = np.int32(x ^ ((x >> 31) & rest))
        y = np.int32(y ^ ((y >> 31) & rest))
        z = np.int32(z ^ ((z >> 31) & rest))
        lx = min(lx, x if finite else most)
        ly = min(ly, y if finite else most)
        lz = min(lz, z if finite else most)
        hx = max(hx, x if finite else least)
        hy = max(hy, y if finite else least)
        hz = max(hz, z if finite else least)
    limits[0], limits[1], limits[2], limits[3], limits[4], limits[5] = lx, ly, lz, hx, hy, hz


@njit(cache=True, nogil=True)
def _from_ordered(number: int) -> float:
    one = np.empty(1, np.int32)
    one[0] = number ^ ((number >> 31) & 0x7FFFFFFF)
    return float(one.view(np.float32)[0])


@njit(cache=True, nogil=True)
def _colour_sums(words: NDArray[np.float32], layout: Layout, colour: int) -> tuple[int, int, int, int]:
    step, at_x, at_y, at_z = layout
    bits = words.view(np.uint32)
    red = green = blue = count = 0
    for i in range(len(words) // step):
        base = step * i
        if (
            math.isfinite(words[base + at_x])
            and math.isfinite(words[base + at_y])
            and math.isfinite(words[base + at_z])
        ):
            packed = int(bits[base + colour])
            red += (packed >> 16) & 255
            green += (packed >> 8) & 255
            blue += packed & 255
            count += 1
    return red, green, blue, count


def warm_up() -> None:
    """Compile the kernels of this file."""
    words = words_of(np.zeros((4, 3), np.float32))
    _sums(words.words, words.layout)
    _bounds(words.words, words.layout)
    _colour_sums(words.words, words.layout, 2)
