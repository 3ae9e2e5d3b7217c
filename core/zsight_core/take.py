"""The points of a cloud that a mask marks, whole records at memory speed."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numba import njit

from zsight_core.errors import PointsError
from zsight_core.words import record_words

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from zsight_core.points import Points

__all__ = ["take", "warm_up"]


def take(points: Points, mask: NDArray[np.bool_], out: Points | None = None) -> Points:
    """The marked points: (1, M), every field as it is, in the cloud's order.

    Args:
        points: (H, W).
        mask: the same shape.
        out: room for at least M points of the same dtype, shape (1, N); the result is then a view of it.

    Raises:
        PointsError: the shapes differ, or `out` is too small or of another dtype.
    """
    if mask.shape != points.shape or mask.dtype != np.bool_:
        raise PointsError(f"mask has shape {mask.shape} and type {mask.dtype}; expected {points.shape} and bool")
    flat_mask = np.ascontiguousarray(mask).reshape(-1)
    count = int(np.count_nonzero(flat_mask))
    if out is None:
        out = np.empty((1, count), points.dtype)
    if out.dtype != points.dtype or not out.flags.c_contiguous or out.size < count:
        raise PointsError(f"output holds {out.size} points of {out.dtype}; expected {count} or more of {points.dtype}")
    room = out.reshape(1, -1)[:, :count]
    if points.dtype.itemsize % 4 == 0 and points.ctypes.data % 4 == 0:
        _take_words(
            record_words(np.ascontiguousarray(points)), points.dtype.itemsize // 4, flat_mask, record_words(room)
        )
    else:
        room[0] = points.reshape(-1)[flat_mask]
    return room


@njit(cache=True, nogil=True)
def _take_words(words: NDArray[np.float32], step: int, mask: NDArray[np.bool_], out: NDArray[np.float32]) -> None:
    used = 0
    if step == 4:
        for i in range(len(mask)):
            if mask[i]:
                for k in range(4):
                    out[used + k] = words[4 * i + k]
                used += 4
    else:
        for i in range(len(mask)):
            if mask[i]:
                for k in range(step):
                    out[used + k] = words[step * i + k]
                used += step


def warm_up() -> None:
    """Compile the kernels of this file."""
    take(np.zeros((1, 2), [("x", "<f4")]), np.ones((1, 2), np.bool_))
