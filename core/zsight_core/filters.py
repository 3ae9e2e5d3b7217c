"""Filters: the points whose coordinates, fields or colour lie within limits."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from numba import njit

from zsight_core.errors import GeometryError, PointsError
from zsight_core.take import take
from zsight_core.words import words_of

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from zsight_core.points import Points
    from zsight_core.words import Layout

__all__ = ["box", "box_mask", "finite_mask", "matching_colour", "pass_through", "remove_nan", "warm_up"]


def pass_through(points: Points, field: str, low: float, high: float) -> Points:
    """The points with finite coordinates and low <= field <= high: (1, M), all fields kept.

    Limits are compared as float32 where the field is float32, as PCL does.

    Raises:
        PointsError: the cloud has no such field, or the field holds several numbers a point.
        GeometryError: low > high or a limit is NaN.
    """
    if field not in (points.dtype.names or ()):
        raise PointsError(f"cloud has fields {', '.join(points.dtype.names or ()) or 'none'}; there is no {field!r}")
    if points.dtype[field].shape:
        raise PointsError(f"field {field} holds {points.dtype[field].shape} numbers a point; expected one")
    _require_order(low, high)
    if field in ("x", "y", "z"):
        limits = np.array([[-np.inf] * 3, [np.inf] * 3])
        limits[:, "xyz".index(field)] = low, high
        return take(points, box_mask(points, *limits))
    values = points[field]
    return take(points, (values >= values.dtype.type(low)) & (values <= values.dtype.type(high)) & finite_mask(points))


def box(points: Points, low: ArrayLike, high: ArrayLike) -> Points:
    """The points with low <= (x, y, z) <= high on every axis: (1, M), all fields kept.

    Args:
        points: (H, W).
        low: (3,) least coordinates, metres; -inf is no limit.
        high: (3,) greatest coordinates, metres; inf is no limit.

    Raises:
        GeometryError: a low limit above its high one, or a limit is NaN.
    """
    return take(points, box_mask(points, low, high))


def box_mask(cloud: Points | NDArray[np.floating[Any]], low: ArrayLike, high: ArrayLike) -> NDArray[np.bool_]:
    """Mask (H, W) of what `box` keeps; a point that is not finite is never kept."""
    lows, highs = (np.asarray(limit, dtype=np.float64).reshape(3) for limit in (low, high))
    for least, greatest in zip(lows, highs, strict=True):
        _require_order(least, greatest)
    words = words_of(cloud)
    out = np.empty(words.shape, np.bool_)
    largest = np.finfo(np.float32).max
    limits = np.clip(np.concatenate([lows, highs]), -largest, largest).astype(np.float32)
    _in_box(words.words, words.layout, limits, out.reshape(-1))
    return out


def finite_mask(cloud: Points | NDArray[np.floating[Any]]) -> NDArray[np.bool_]:
    """Mask (H, W) of the points whose x, y and z are finite."""
    return box_mask(cloud, [-np.inf] * 3, [np.inf] * 3)


def remove_nan(points: Points) -> Points:
    """The points with finite x, y and z: (1, M), all fields kept; the rows and columns are given up."""
    return take(points, finite_mask(points))


def matching_colour(points: Points, rgb: tuple[int, int, int], tolerance: float) -> Points:
    """The points whose red, green and blue each lie within `tolerance` (0..255) of `rgb`: (1, M), all fields kept.

    Raises:
        PointsError: the cloud has no colour.
    """
    words = words_of(points)
    if words.colour < 0:
        raise PointsError(f"cloud has fields {', '.join(points.dtype.names or ())}; expected rgb among them")
    mask = np.empty(points.shape, np.bool_)
    _of_colour(words.words, words.layout, words.colour, np.array(rgb, np.float64), float(tolerance), mask.reshape(-1))
    return take(points, mask)


def _require_order(low: float, high: float) -> None:
    if not low <= high:
        raise GeometryError(f"limits are {low} to {high}; expected two numbers, the lower one first")


@njit(cache=True, nogil=True)
def _in_box(words: NDArray[np.float32], layout: Layout, limits: NDArray[np.float32], out: NDArray[np.bool_]) -> None:
    step, at_x, at_y, at_z = layout
    lx, ly, lz, hx, hy, hz = limits[0], limits[1], limits[2], limits[3], limits[4], limits[5]
    if step == 4 and at_x == 0 and at_y == 1 and at_z == 2:
        for i in range(len(out)):
            x, y, z = words[4 * i], words[4 * i + 1], words[4 * i + 2]
            out[i] = (x >= lx) & (x <= hx) & (y >= ly) & (y <= hy) & (z >= lz) & (z <= hz)
    else:
        for i in range(len(out)):
            x, y, z = words[step * i + at_x], words[step * i + at_y], words[step * i + at_z]
            out[i] = (x >= lx) & (x <= hx) & (y >= ly) & (y <= hy) & (z >= lz) & (z <= hz)


@njit(cache=True, nogil=True)
def _of_colour(
    words: NDArray[np.float32],
    layout: Layout,
    colour: int,
    rgb: NDArray[np.float64],
    tolerance: float,
    out: NDArray[np.bool_],
) -> None:
    step, at_x, at_y, at_z = layout
    bits = words.view(np.uint32)
    for i in range(len(out)):
        base = step * i
        packed = np.int64(bits[base + colour])
        near = abs(((packed >> 16) & 255) - rgb[0]) <= tolerance
        near &= abs(((packed >> 8) & 255) - rgb[1]) <= tolerance
        near &= abs((packed & 255) - rgb[2]) <= tolerance
        near &= math.isfinite(words[base + at_x] + words[base + at_y] + words[base + at_z])
        out[i] = near


def warm_up() -> None:
    """Compile the kernels of this file."""
    words = words_of(np.zeros((4, 3), np.float32))
    mask = np.empty(4, np.bool_)
    _in_box(words.words, words.layout, np.zeros(6, np.float32), mask)
    _of_colour(words.words, words.layout, 2, np.zeros(3), 1.0, mask)
