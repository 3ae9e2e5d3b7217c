"""Filters: the points whose coordinates, fields or colour lie within limits."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from zsight_core.errors import GeometryError, PointsError
from zsight_core.jit import njit
from zsight_core.points import XYZ
from zsight_core.take import append_marked, room_for, take, trimmed, units_of
from zsight_core.tile import TILE, lies_packed, load_tile, new_tile
from zsight_core.words import words_of

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from zsight_core.points import Points
    from zsight_core.words import Layout

_LARGEST = float(np.finfo(np.float32).max)

__all__ = ["box", "box_mask", "finite_mask", "matching_colour", "pass_through", "remove_nan", "warm_up"]


def pass_through(points: Points, field: str, low: float, high: float, out: Points | None = None) -> Points:
    """The points with finite coordinates and low <= field <= high: (1, M), all fields kept.

    Limits are compared as float32 where the field is float32, as PCL does.

    Args:
        points: (H, W).
        field: name of a field of one number.
        low: least value kept.
        high: greatest value kept.
        out: room for the result, contiguous, as many points as the cloud has; the result is then a view of it.

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
        lows, highs = [-np.inf] * 3, [np.inf] * 3
        lows["xyz".index(field)], highs["xyz".index(field)] = low, high
        return box(points, lows, highs, out)
    values = points[field]
    kind = values.dtype.type if values.dtype.kind == "f" else float
    inside = (values >= kind(low)) & (values <= kind(high))
    return take(points, inside & finite_mask(points), out)


def box(points: Points, low: ArrayLike, high: ArrayLike, out: Points | None = None) -> Points:
    """The points with low <= (x, y, z) <= high on every axis: (1, M), all fields kept.

    Args:
        points: (H, W).
        low: (3,) least coordinates, metres; -inf is no limit.
        high: (3,) greatest coordinates, metres; inf is no limit.
        out: room for the result, contiguous, as many points as the cloud has; the result is then a view of it.

    Raises:
        GeometryError: a low limit above its high one, or a limit is NaN.
    """
    limits = _limits(low, high)
    cloud, units = words_of(points), units_of(points)
    if units is None or points.dtype.itemsize != 16 or (out is not None and out.size < points.size):
        return take(points, box_mask(points, low, high), out)
    room = room_for(points, points.size, out)
    target = units_of(room)
    if target is None:
        return take(points, box_mask(points, low, high), out)
    return trimmed(room, _take_in_box(cloud.words, cloud.layout, limits, units, target), out)


def box_mask(cloud: Points | NDArray[np.floating[Any]], low: ArrayLike, high: ArrayLike) -> NDArray[np.bool_]:
    """Mask (H, W) of what `box` keeps; a point that is not finite is never kept."""
    words = words_of(cloud)
    out = np.empty(words.shape, np.bool_)
    _in_box(words.words, words.layout, _limits(low, high), out.reshape(-1).view(np.uint8))
    return out


def finite_mask(cloud: Points | NDArray[np.floating[Any]]) -> NDArray[np.bool_]:
    """Mask (H, W) of the points whose x, y and z are finite."""
    return box_mask(cloud, [-np.inf] * 3, [np.inf] * 3)


def remove_nan(points: Points, out: Points | None = None) -> Points:
    """The points with finite x, y and z: (1, M), all fields kept; the rows and columns are given up.

    Args:
        points: (H, W).
        out: room for the result, contiguous, as many points as the cloud has; the result is then a view of it.
    """
    return box(points, [-np.inf] * 3, [np.inf] * 3, out)


def matching_colour(points: Points, rgb: tuple[int, int, int], tolerance: float, out: Points | None = None) -> Points:
    """The points whose red, green and blue each lie within `tolerance` (0..255) of `rgb`: (1, M), all fields kept.

    `out` is room for the result, contiguous, at least M points; the result is then a view of it.

    Raises:
        PointsError: the cloud has no colour.
    """
    words = words_of(points)
    if words.colour < 0:
        raise PointsError(f"cloud has fields {', '.join(points.dtype.names or ())}; expected rgb among them")
    mask = np.empty(points.shape, np.bool_)
    _of_colour(words.words, words.layout, words.colour, np.array(rgb, np.float64), float(tolerance), mask.reshape(-1))
    return take(points, mask, out)


def _limits(low: ArrayLike, high: ArrayLike) -> NDArray[np.float32]:
    """(6,) low and high limits; infinite ones become the largest numbers, so that infinite points lie outside."""
    limits = np.empty((2, 3))
    limits[0], limits[1] = low, high
    for axis in range(3):
        _require_order(limits[0, axis], limits[1, axis])
    return np.clip(limits, -_LARGEST, _LARGEST).astype(np.float32).reshape(6)


def _require_order(low: float, high: float) -> None:
    if not low <= high:
        raise GeometryError(f"limits are {low} to {high}; expected two numbers, the lower one first")


@njit(cache=True, nogil=True)
def _in_box(words: NDArray[np.float32], layout: Layout, limits: NDArray[np.float32], out: NDArray[np.uint8]) -> None:
    tile, inside = new_tile(), np.empty(TILE, np.uint8)
    for start in range(0, len(out), TILE):
        _mark_box(words, layout, start, tile, limits, inside)
        rest = out[start : start + TILE]
        rest[:] = inside[: len(rest)]


@njit(cache=True, nogil=True)
def _take_in_box(
    words: NDArray[np.float32],
    layout: Layout,
    limits: NDArray[np.float32],
    units: NDArray[np.complex128],
    out: NDArray[np.complex128],
) -> int:
    """Copy the points in the box; returns how many they are."""
    tile, inside = new_tile(), np.empty(TILE, np.uint8)
    eights, used = inside.view(np.uint64), 0
    for start in range(0, len(units), TILE):
        _mark_box(words, layout, start, tile, limits, inside)
        used = append_marked(units, start, inside, eights, out, used)
    return used


@njit(cache=True, nogil=True)
def _mark_box(
    words: NDArray[np.float32],
    layout: Layout,
    start: int,
    tile: NDArray[np.float32],
    limits: NDArray[np.float32],
    inside: NDArray[np.uint8],
) -> None:
    """1 for each point of the tile from `start` on that lies within the limits.

    A full tile of packed points is read where it is, which takes no longer than reading it does; others go by `tile`.
    The fourth word of a point chooses between two limits that are the same: of rows that are read in part the compiler
    would do the last ones of each tile one by one.
    """
    lx, ly, lz, hx, hy, hz = limits[0], limits[1], limits[2], limits[3], limits[4], limits[5]
    if lies_packed(words, layout, start):
        first, same_hz = np.uint64(4 * start), max(lz, hz)
        for i in range(np.uint64(TILE)):
            k = first + np.uint64(4) * i
            x, y, z, w = words[k], words[k + np.uint64(1)], words[k + np.uint64(2)], words[k + np.uint64(3)]
            highest = hz if w > lz else same_hz
            inside[i] = (x >= lx) & (x <= hx) & (y >= ly) & (y <= hy) & (z >= lz) & (z <= highest)
        return
    load_tile(words, layout, -1, start, tile)
    for i in range(TILE):
        x, y, z = tile[0, i], tile[1, i], tile[2, i]
        inside[i] = (x >= lx) & (x <= hx) & (y >= ly) & (y <= hy) & (z >= lz) & (z <= hz)


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
    _in_box(words.words, words.layout, np.zeros(6, np.float32), mask.view(np.uint8))
    remove_nan(np.zeros((1, 2), XYZ))
    _of_colour(words.words, words.layout, 2, np.zeros(3), 1.0, mask)
