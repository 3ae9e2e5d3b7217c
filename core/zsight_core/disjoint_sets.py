"""Disjoint sets of numbers, joined one by one: which of them hang together."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from zsight_core.jit import njit

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["root_of", "unite", "warm_up"]


@njit(cache=True, nogil=True)
def root_of(parent: NDArray[np.signedinteger[Any]], i: int) -> int:
    """Representative of the set that holds `i`, halving the path on the way (Tarjan and van Leeuwen 1984)."""
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i


@njit(cache=True, nogil=True)
def unite(parent: NDArray[np.signedinteger[Any]], i: int, j: int) -> None:
    """Join the sets of `i` and `j`; the lower of their representatives stands for both."""
    one, other = root_of(parent, i), root_of(parent, j)
    parent[max(one, other)] = min(one, other)


def warm_up() -> None:
    """Compile the kernels of this file."""
    unite(np.arange(2), 0, 1)
