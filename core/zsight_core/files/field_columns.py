"""Records turned into columns, all points' first field before all points' second, and back.

Both orders have the same bytes. Fields of several numbers stay together point by point, as in compressed PCD files.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from zsight_core.jit import njit

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

__all__ = ["to_columns", "to_records", "warm_up"]

_WORD = 4


def to_columns(records: NDArray[np.uint8], sizes: Sequence[int]) -> NDArray[np.uint8]:
    """Columns, uint8 (points * record,), of records, uint8 (points, record), whose fields have these sizes in bytes."""
    columns = np.empty(records.size, np.uint8)
    if _are_words(sizes):
        _words_to_columns(_words(records), _words(columns), len(sizes))
        return columns
    for column, cells in _pairs(columns, records, sizes):
        column[...] = cells
    return columns


def to_records(columns: NDArray[np.uint8], sizes: Sequence[int]) -> NDArray[np.uint8]:
    """Records, uint8 (points, record), of columns, uint8 (points * record,), of fields of these sizes in bytes."""
    size = sum(sizes)
    records = np.empty((len(columns) // size, size), np.uint8)
    if _are_words(sizes):
        _words_to_records(_words(columns), _words(records), len(sizes))
        return records
    for column, cells in _pairs(columns, records, sizes):
        cells[...] = column
    return records


def warm_up() -> None:
    """Compile the kernels, or load them from the cache."""
    to_records(to_columns(np.zeros((8, 4), np.uint8), [4]), [4])


def _are_words(sizes: Sequence[int]) -> bool:
    return all(size == _WORD for size in sizes)


def _words(data: NDArray[np.uint8]) -> NDArray[np.uint32]:
    return data.reshape(-1).view(np.uint32)


def _pairs(columns: NDArray[np.uint8], records: NDArray[np.uint8], sizes: Sequence[int]) -> list[tuple[Any, Any]]:
    """The cells of each field in both orders, as items of its size, which numpy moves whole."""
    points, pairs, start = len(records), [], 0
    for size in sizes:
        item = np.dtype((np.void, size))
        column = columns[start * points : (start + size) * points].reshape(points, size)
        pairs.append((column.view(item), records[:, start : start + size].view(item)))
        start += size
    return pairs


@njit(cache=True, nogil=True)
def _words_to_records(columns: NDArray[np.uint32], records: NDArray[np.uint32], width: int) -> None:
    """Four columns at a time, which the processor can turn in its registers."""
    points = len(records) // width
    field = 0
    while field + 4 <= width:
        for i in range(points):
            for k in range(4):
                records[np.uint64(i * width + field + k)] = columns[np.uint64((field + k) * points + i)]
        field += 4
    while field < width:
        for i in range(points):
            records[np.uint64(i * width + field)] = columns[np.uint64(field * points + i)]
        field += 1


@njit(cache=True, nogil=True)
def _words_to_columns(records: NDArray[np.uint32], columns: NDArray[np.uint32], width: int) -> None:
    points = len(records) // width
    field = 0
    while field + 4 <= width:
        for i in range(points):
            for k in range(4):
                columns[np.uint64((field + k) * points + i)] = records[np.uint64(i * width + field + k)]
        field += 4
    while field < width:
        for i in range(points):
            columns[np.uint64(field * points + i)] = records[np.uint64(i * width + field)]
        field += 1
