"""The LZF byte stream in which ``binary_compressed`` PCD files keep their columns.

The stream (public since Lehmann's liblzf) is a sequence of two kinds of token. A first byte ``c < 32`` announces
``c + 1`` bytes that stand as they are. Any other first byte holds a length in its upper three bits (7: the next byte
adds to it) and, in its lower five, the upper bits of a distance whose lower eight bits follow; it means: repeat
``length + 2`` bytes from ``distance + 1`` back, where the source may run into what is being written.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from zsight_core.files.eight_bytes import load, store
from zsight_core.jit import njit

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["MAX_RATIO", "compress", "decompress", "warm_up"]

MAX_RATIO = 88
"""No stream expands by more: the longest repeat makes 264 bytes from 3."""

_LONGEST_RUN = 32
_LONGEST_REPEAT = 264
_LONGEST_TOKEN = 48  # a run with its first byte is 33; reading eight at a time goes up to seven farther
_FARTHEST = 8192
_HASH_BITS = 16
_KNUTH = np.uint64(2654435761)  # 2^32 over the golden ratio spreads neighbouring keys
_ONE_BYTE, _THREE_BYTES = np.uint64(0xFF), np.uint64(0xFFFFFF)
_PIECE = 1 << 30  # so that places in the data fit 32 bits
_PATIENCE = 6  # after 2^6 bytes without a repeat look at every second byte only, and so on


def compress(data: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """The stream that stands for data, both uint8 of shape (bytes,); random data grows by 1/32."""
    stream = np.empty(len(data) + len(data) // _LONGEST_RUN + 16, np.uint8)  # and room to write eight at a time
    end = 0
    for start in range(0, len(data), _PIECE):  # streams that follow each other make one stream
        end += int(_compress(data[start : start + _PIECE], stream[end:]))
    return stream[:end]


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
    """Token by token; eight bytes at a time as long as both ends are farther away than any token reaches."""
    end_in, end_out = len(stream), len(data)
    at, out = 0, 0
    while at < end_in - _LONGEST_TOKEN and out < end_out - _LONGEST_REPEAT - 8:
        first = int(stream[np.uint64(at)])
        at += 1
        if first < 32:
            _copy_ahead(stream, at, data, out, first + 1)
            at += first + 1
            out += first + 1
            continue
        length = (first >> 5) + 2
        if length == 9:
            length += int(stream[np.uint64(at)])
            at += 1
        distance = ((first & 31) << 8) + int(stream[np.uint64(at)]) + 1
        at += 1
        if distance > out:
            return -1
        end = out + length  # up to seven bytes more are written, which is overwritten later
        if distance >= 8:
            while out < end:
                store(data, out, load(data, out - distance))
                out += 8
        elif distance == 4:  # the same float32 again and again, such as the NaN of holes
            value = load(data, out - 4) & np.uint64(0xFFFFFFFF)
            value |= value << np.uint64(32)
            while out < end:
                store(data, out, value)
                out += 8
        else:
            while out < end:
                data[np.uint64(out)] = data[np.uint64(out - distance)]
                out += 1
        out = end
    return _decompress_end(stream, at, data, out)


@njit(cache=True, nogil=True)
def _copy_ahead(source: NDArray[np.uint8], at: int, target: NDArray[np.uint8], out: int, count: int) -> None:
    """Copy at least count bytes, up to seven more; what is written too much is overwritten later."""
    store(target, out, load(source, at))
    done = 8
    while done < count:
        store(target, out + done, load(source, at + done))
        done += 8


@njit(cache=True, nogil=True)
def _decompress_end(stream: NDArray[np.uint8], at: int, data: NDArray[np.uint8], out: int) -> int:
    """The same byte by byte, with every bound checked."""
    end_in, end_out = len(stream), len(data)
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
    """Greedy: at each byte try the last place where the same three bytes stood.

    The longer nothing has been found, the larger the steps, so that noise costs little time; hardly any length is lost.
    """
    size = len(data)
    last = np.full(1 << _HASH_BITS, -_FARTHEST - 1, np.int32)
    at, out, literal = 0, 0, 0  # literal: first byte not yet written
    while at < size - 2 * _LONGEST_RUN:
        key = load(data, at) & _THREE_BYTES
        slot = (key * _KNUTH & np.uint64(0xFFFFFFFF)) >> np.uint64(32 - _HASH_BITS)
        before = int(last[slot])
        last[slot] = at
        if at - before > _FARTHEST or (load(data, before) & _THREE_BYTES) != key:
            at += 1 + ((at - literal) >> _PATIENCE)
            continue
        length, longest = 3, min(_LONGEST_REPEAT, size - at - 8)
        while length < longest:  # not a function of its own: the call takes a third of the time
            different = load(data, before + length) ^ load(data, at + length)
            if different != 0:
                while different & _ONE_BYTE == 0:
                    different >>= np.uint64(8)
                    length += 1
                break
            length += 8
        length = min(length, longest)
        while literal < at:
            run = min(_LONGEST_RUN, at - literal)
            stream[np.uint64(out)] = run - 1
            _copy_ahead(data, literal, stream, out + 1, run)
            out += run + 1
            literal += run
        out = _put_repeat(at - before - 1, length - 2, stream, out)
        at += length
        literal = at
    return _put_rest(data, literal, stream, out)


@njit(cache=True, nogil=True)
def _put_repeat(distance: int, length: int, stream: NDArray[np.uint8], out: int) -> int:
    if length < 7:
        stream[np.uint64(out)] = (length << 5) | (distance >> 8)
        out += 1
    else:
        stream[np.uint64(out)] = (7 << 5) | (distance >> 8)
        stream[np.uint64(out + 1)] = length - 7
        out += 2
    stream[np.uint64(out)] = distance & 255
    return out + 1


@njit(cache=True, nogil=True)
def _put_rest(data: NDArray[np.uint8], start: int, stream: NDArray[np.uint8], out: int) -> int:
    """The last bytes as they stand."""
    while start < len(data):
        run = min(_LONGEST_RUN, len(data) - start)
        stream[out] = run - 1
        for k in range(run):
            stream[out + 1 + k] = data[start + k]
        out += run + 1
        start += run
    return out
