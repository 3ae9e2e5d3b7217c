"""The LZF byte stream in which ``binary_compressed`` PCD files keep their columns.

The stream (public since Lehmann's liblzf) is a sequence of two kinds of token. A first byte ``c < 32`` announces
``c + 1`` bytes that stand as they are. Any other first byte holds a length in its upper three bits (7: the next byte
adds to it) and, in its lower five, the upper bits of a distance whose lower eight bits follow; it means: repeat
``length + 2`` bytes from ``distance + 1`` back, where the source may run into what is being written.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numba import njit

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["MAX_RATIO", "compress", "decompress", "warm_up"]

MAX_RATIO = 88
"""No stream expands by more: the longest repeat makes 264 bytes from 3."""

_LONGEST_RUN = 32
_LONGEST_REPEAT = 264
_FARTHEST = 8192
_HASH_BITS = 16
_KNUTH = 2654435761  # 2^32 over the golden ratio spreads neighbouring keys


def compress(data: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """The stream that stands for data, both uint8 of shape (bytes,); random data grows by 1/32."""
    stream = np.empty(len(data) + len(data) // _LONGEST_RUN + 8, np.uint8)
    return stream[: _compress(data, stream)]


def decompress(stream: NDArray[np.uint8], data: NDArray[np.uint8]) -> int:
    """Expand a stream, uint8 (bytes,), into ``data``, uint8 (bytes,), which must have exactly its length.

    Returns:
        The number of bytes made, equal to ``len(data)``; -1 where the stream is corrupt: it ends within a token,
        reaches back before its beginning, or makes fewer or more bytes than expected.
    """
    return int(_decompress(stream, data))


def warm_up() -> None:
    """Compile the kernels, or load them from the cache."""
    data = np.zeros(64, np.uint8)
    decompress(compress(data), np.empty_like(data))


@njit(cache=True, nogil=True)
def _decompress(stream: NDArray[np.uint8], data: NDArray[np.uint8]) -> int:
    end_in, end_out = len(stream), len(data)
    at, out = 0, 0
    while at < end_in:
        first = int(stream[at])
        at += 1
        if first < 32:
            run = first + 1
            if at + run > end_in or out + run > end_out:
                return -1
            for k in range(run):
                data[out + k] = stream[at + k]
            at += run
            out += run
            continue
        length = (first >> 5) + 2
        if length == 9:
            if at >= end_in:
                return -1
            length += int(stream[at])
            at += 1
        if at >= end_in:
            return -1
        distance = ((first & 31) << 8) + int(stream[at]) + 1
        at += 1
        if distance > out or out + length > end_out:
            return -1
        for k in range(out, out + length):
            data[k] = data[k - distance]
        out += length
    return out if out == end_out else -1


@njit(cache=True, nogil=True)
def _compress(data: NDArray[np.uint8], stream: NDArray[np.uint8]) -> int:
    """Greedy: at each byte try the last place where the same three bytes stood."""
    size = len(data)
    last = np.full(1 << _HASH_BITS, -_FARTHEST - 1, np.int64)
    at, out, literal = 0, 0, 0  # literal: first byte not yet written
    while at + 2 < size:
        key = int(data[at]) << 16 | int(data[at + 1]) << 8 | int(data[at + 2])
        slot = (key * _KNUTH & 0xFFFFFFFF) >> (32 - _HASH_BITS)
        before = last[slot]
        last[slot] = at
        if not (
            at - before <= _FARTHEST
            and data[before] == data[at]
            and data[before + 1] == data[at + 1]
            and data[before + 2] == data[at + 2]
        ):
            at += 1
            continue
        length = 3
        longest = min(_LONGEST_REPEAT, size - at)
        while length < longest and data[before + length] == data[at + length]:
            length += 1
        out = _put_literals(data, literal, at, stream, out)
        out = _put_repeat(at - before - 1, length - 2, stream, out)
        at += length
        literal = at
    return _put_literals(data, literal, size, stream, out)


@njit(cache=True, nogil=True)
def _put_literals(data: NDArray[np.uint8], start: int, end: int, stream: NDArray[np.uint8], out: int) -> int:
    while start < end:
        run = min(_LONGEST_RUN, end - start)
        stream[out] = run - 1
        for k in range(run):
            stream[out + 1 + k] = data[start + k]
        out += run + 1
        start += run
    return out


@njit(cache=True, nogil=True)
def _put_repeat(distance: int, length: int, stream: NDArray[np.uint8], out: int) -> int:
    if length < 7:
        stream[out] = (length << 5) | (distance >> 8)
        out += 1
    else:
        stream[out] = (7 << 5) | (distance >> 8)
        stream[out + 1] = length - 7
        out += 2
    stream[out] = distance & 255
    return out + 1
