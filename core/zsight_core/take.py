"""The points of a cloud that a mask marks, whole records at memory speed."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from zsight_core.errors import PointsError
from zsight_core.jit import njit
from zsight_core.tile import TILE
from zsight_core.words import record_words

if TYPE_CHECKING:
    from numpy.typing import DTypeLike, NDArray

    from zsight_core.points import Points

__all__ = ["append_marked", "array_for", "room_for", "take", "trimmed", "units_of", "warm_up"]


def take(points: Points, mask: NDArray[np.bool_], out: Points | None = None) -> Points:
    """The marked points: (1, M), every field as it is, in the cloud's order.

    Args:
        points: (H, W).
        mask: the same shape.
        out: room for at least M points of the same dtype, contiguous; the result is then a view of it.

    Raises:
        PointsError: the shapes differ, or `out` is too small or of another dtype.
    """
    if mask.shape != points.shape or mask.dtype != np.bool_:
        raise PointsError(f"mask has shape {mask.shape} and type {mask.dtype}; expected {points.shape} and bool")
    flat_mask = np.ascontiguousarray(mask).reshape(-1)
    count = int(np.count_nonzero(flat_mask))
    room = room_for(points, count, out)[:, :count]
    units, target = units_of(points), units_of(room)
    if units is not None and target is not None:
        _take_units(units, flat_mask.view(np.uint8), target)
    else:
        room[0] = points.reshape(-1)[flat_mask]
    return room


def room_for(points: Points, count: int, out: Points | None) -> Points:
    """Room (1, N >= count) for points of this dtype: `out` if it is given, else fresh.

    Raises:
        PointsError: `out` does not fit.
    """
    if out is None:
        return np.empty((1, count), points.dtype)
    if out.dtype != points.dtype or not out.flags.c_contiguous or out.size < count:
        raise PointsError(f"output holds {out.size} points of {out.dtype}; expected {count} or more of {points.dtype}")
    return out.reshape(1, -1)


def array_for(shape: tuple[int, ...], dtype: DTypeLike, out: NDArray[Any] | None) -> NDArray[Any]:
    """Room of this shape and type: `out` if it is given, else fresh.

    Raises:
        PointsError: `out` does not fit.
    """
    if out is None:
        return np.empty(shape, dtype)
    if out.shape != shape or out.dtype != dtype or not out.flags.c_contiguous:
        raise PointsError(
            f"output has shape {out.shape} and type {out.dtype}; expected {shape} and {np.dtype(dtype)}, contiguous"
        )
    return out


def trimmed(room: Points, count: int, out: Points | None) -> Points:
    """The first `count` points of the room (1, N); as a copy where most of fresh room would be held for nothing."""
    filled = room[:, :count]
    if out is not None or 2 * count >= room.size:
        return filled
    return filled.view(np.dtype((np.void, room.dtype.itemsize))).copy().view(room.dtype)


def units_of(points: Points) -> NDArray[np.complex128] | None:
    """A contiguous cloud's memory in units of 16 bytes, which move in one go; None where that does not fit."""
    if points.dtype.itemsize % 16 or not points.flags.c_contiguous:
        return None
    units: NDArray[np.complex128] = record_words(points).view(np.complex128)
    return units if units.flags.aligned else None


@njit(cache=True, nogil=True)
def append_marked(
    units: NDArray[np.complex128],
    start: int,
    marked: NDArray[np.uint8],
    eights: NDArray[np.uint64],
    out: NDArray[np.complex128],
    used: int,
) -> int:
    """Copy the marked ones of the points from `start` on behind the `used` points that `out` holds already.

    Args:
        units: the cloud, a unit a point.
        start: first point of the tile.
        marked: 1 or 0 for each point of a tile; what lies behind the cloud's last point does not count.
        eights: the same memory, eight marks at a time.
        out: room for all points of the cloud.
        used: points in it.

    Returns:
        Points in `out` afterwards.
    """
    length = np.uint64(min(TILE, len(units) - start))
    place, begin, whole = np.uint64(used), np.uint64(start), length // np.uint64(8)
    for group in range(whole):  # neighbours are mostly marked alike
        first = begin + np.uint64(8) * group
        if eights[group] == np.uint64(0x0101010101010101):
            for i in range(np.uint64(8)):
                out[place + i] = units[first + i]
            place += np.uint64(8)
        elif eights[group] != np.uint64(0):
            for i in range(np.uint64(8)):
                out[place] = units[first + i]
                place += np.uint64(marked[np.uint64(8) * group + i])
    for i in range(np.uint64(8) * whole, length):
        if marked[i]:
            out[place] = units[begin + i]
            place += np.uint64(1)
    return np.int64(place)  # type: ignore[return-value]  # int() would keep it unsigned


@njit(cache=True, nogil=True)
def _take_units(units: NDArray[np.complex128], mask: NDArray[np.uint8], out: NDArray[np.complex128]) -> None:
    """Without branches that follow the mask: a point that is not marked is overwritten by the next."""
    per_point = len(units) // max(len(mask), 1)
    place, end, i = np.uint64(0), np.uint64(len(out)), np.uint64(0)
    if per_point == 1:
        while place < end:
            out[place] = units[i]
            place += np.uint64(mask[i])
            i += np.uint64(1)
        return
    step = np.uint64(per_point)
    while place < end:
        for k in range(step):
            out[place + k] = units[i * step + k]
        place += np.uint64(mask[i]) * step
        i += np.uint64(1)


def warm_up() -> None:
    """Compile the kernels of this file."""
    units = np.zeros(2 * TILE, np.complex128)
    _take_units(units[:2], np.ones(2, np.uint8), units[:2].copy())
    marked = np.ones(TILE, np.uint8)
    append_marked(units, 0, marked, marked.view(np.uint64), units.copy(), 0)
