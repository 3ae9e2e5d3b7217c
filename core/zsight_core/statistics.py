"""Centroid, bounding box and average colour of a cloud."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from numba import njit

from zsight_core.errors import GeometryError, PointsError
from zsight_core.words import words_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from zsight_core.points import Points
    from zsight_core.words import Layout

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


@njit(cache=True, nogil=True, fastmath={"reassoc", "nsz", "contract"})  # a sum in any order is as good; NaNs are kept
def _tile_sums(
    tile: NDArray[np.float32], step: int, at_x: int, at_y: int, at_z: int, sums: NDArray[np.float64]
) -> None:
    sx = sy = sz = 0.0
    n = 0
    for i in range(len(tile) // step):
        x, y, z = tile[step * i + at_x], tile[step * i + at_y], tile[step * i + at_z]
        finite = abs(x) < np.inf and abs(y) < np.inf and abs(z) < np.inf
        sx += float(x) if finite else 0.0
        sy += float(y) if finite else 0.0
        sz += float(z) if finite else 0.0
        n += 1 if finite else 0
    sums[0] += sx
    sums[1] += sy
    sums[2] += sz
    sums[3] += n


@njit(cache=True, nogil=True)
def _sums(words: NDArray[np.float32], layout: Layout) -> NDArray[np.float64]:
    """(4,) sums of x, y, z over the finite points, and their count."""
    step, at_x, at_y, at_z = layout
    sums = np.zeros(4)
    if step == 4 and at_x == 0 and at_y == 1 and at_z == 2:
        _tile_sums(words, 4, 0, 1, 2, sums)
    else:
        _tile_sums(words, step, at_x, at_y, at_z, sums)
    return sums


@njit(cache=True, nogil=True)
def _bounds(words: NDArray[np.float32], layout: Layout) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Least and greatest of each axis over the finite points; infinities the wrong way round without any.

    The bits of a float, its lower 31 flipped when it is negative, are ordered as the floats are, and the least of
    integers is found many at a time where NaN forbids that for floats.
    """
    step, at_x, at_y, at_z = layout
    bits = words.view(np.int32)
    low = np.full(3, np.inf)
    high = np.full(3, -np.inf)
    if step == 4 and at_x == 0 and at_y == 1 and at_z == 2:
        limits = _ordered_bounds(bits, 4, 0, 1, 2)
    else:
        limits = _ordered_bounds(bits, step, at_x, at_y, at_z)
    if limits[0] <= limits[3]:
        for axis in range(3):
            low[axis] = _from_ordered(limits[axis])
            high[axis] = _from_ordered(limits[3 + axis])
    return low, high


@njit(cache=True, nogil=True)
def _ordered_bounds(bits: NDArray[np.int32], step: int, at_x: int, at_y: int, at_z: int) -> NDArray[np.int32]:
    exponent = np.int32(0x7F800000)
    least, most = np.int32(-0x7FFFFFFF), np.int32(0x7FFFFFFF)
    lx = ly = lz = most
    hx = hy = hz = least
    for i in range(len(bits) // step):
        x, y, z = bits[step * i + at_x], bits[step * i + at_y], bits[step * i + at_z]
        finite = (x & exponent) != exponent and (y & exponent) != exponent and (z & exponent) != exponent
        x = x ^ ((x >> 31) & 0x7FFFFFFF)
        y = y ^ ((y >> 31) & 0x7FFFFFFF)
        z = z ^ ((z >> 31) & 0x7FFFFFFF)
        lx = min(lx, np.int32(x) if finite else most)
        ly = min(ly, np.int32(y) if finite else most)
        lz = min(lz, np.int32(z) if finite else most)
        hx = max(hx, np.int32(x) if finite else least)
        hy = max(hy, np.int32(y) if finite else least)
        hz = max(hz, np.int32(z) if finite else least)
    return np.array([lx, ly, lz, hx, hy, hz], dtype=np.int32)


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
