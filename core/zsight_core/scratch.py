"""Working memory that is kept from call to call, so that a stream of clouds costs no fresh pages."""

from __future__ import annotations

import math
import threading
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import DTypeLike, NDArray

__all__ = ["release", "scratch"]

_kept = threading.local()


def scratch(name: str, shape: tuple[int, ...], dtype: DTypeLike, *, zeroed: bool = False) -> NDArray[Any]:
    """An array of this shape that belongs to this thread; its contents are what its last user left.

    It is good until the same thread asks for the same name again, and must not be handed to a caller. Fresh memory
    costs a page fault per 4 KB, which for many kernels is more than the work itself.

    Args:
        name: who asks.
        shape: wanted; room is kept for the largest so far.
        dtype: of the elements.
        zeroed: fresh memory is zero; the user must leave it so.
    """
    arrays: dict[str, NDArray[Any]] = _kept.__dict__.setdefault("arrays", {})
    size = math.prod(shape)
    array = arrays.get(name)
    if array is None or array.size < size or array.dtype != dtype:
        array = arrays[name] = np.zeros(size, dtype) if zeroed else np.empty(size, dtype)
    return array[:size].reshape(shape)


def release() -> None:
    """Give back what this thread holds."""
    _kept.__dict__.clear()
