"""The LZF codec against a plain reading of the format."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from zsight_core.files import lzf

if TYPE_CHECKING:
    from numpy.typing import NDArray

# Bytes in which repeats are likely, and bytes in which they are not
REPETITIVE = st.lists(st.tuples(st.binary(min_size=1, max_size=6), st.integers(1, 90))).map(
    lambda runs: b"".join(piece * times for piece, times in runs)
)


def array(data: bytes) -> NDArray[np.uint8]:
    return np.frombuffer(data, np.uint8).copy()


def plain_decompress(stream: bytes, size: int) -> bytes | None:
    """The format read word for word; None where the stream is corrupt."""
    data, rest = bytearray(), list(stream)
    while rest:
        first = rest.pop(0)
        if first < 32:
            if len(rest) < first + 1:
                return None
            data += bytes(rest[: first + 1])
            del rest[: first + 1]
        else:
            if (first >> 5 == 7 and len(rest) < 2) or not rest:
                return None
            length = (first >> 5) + (rest.pop(0) if first >> 5 == 7 else 0) + 2
            distance = ((first & 31) << 8) + rest.pop(0) + 1
            if distance > len(data):
                return None
            for _ in range(length):
                data.append(data[-distance])
    return bytes(data) if len(data) == size else None


@given(st.one_of(st.binary(max_size=3000), REPETITIVE))
def test_what_is_compressed_expands_to_the_same(data: bytes) -> None:
    stream = lzf.compress(array(data))
    assert plain_decompress(stream.tobytes(), len(data)) == data
    out = np.empty(len(data), np.uint8)
    assert lzf.decompress(stream, out) == len(data)
    assert out.tobytes() == data
    assert len(stream) <= len(data) + len(data) // 32 + 1
    assert len(data) <= lzf.MAX_RATIO * len(stream)


@given(st.binary(max_size=60), st.integers(0, 400))
def test_any_bytes_are_expanded_as_the_format_says_or_called_corrupt(stream: bytes, size: int) -> None:
    fence = np.full(size + 16, 0xA5, np.uint8)
    made = lzf.decompress(array(stream), fence[:size])
    expected = plain_decompress(stream, size)
    assert made == (-1 if expected is None else size)
    if expected is not None:
        assert fence[:size].tobytes() == expected
    assert (fence[size:] == 0xA5).all()


@given(REPETITIVE.filter(lambda data: len(data) > 20), st.data())
def test_a_cut_stream_is_corrupt(data: bytes, draw: st.DataObject) -> None:
    stream = lzf.compress(array(data))
    cut = draw.draw(st.integers(0, len(stream) - 1))
    assert lzf.decompress(stream[:cut], np.empty(len(data), np.uint8)) == -1


@pytest.mark.parametrize("distance", [1, 2, 3, 4, 5, 7, 8, 9, 15, 16, 17, 31, 33, 8191, 8192, 8193])
def test_repeats_at_every_kind_of_distance(distance: int) -> None:
    rng = np.random.default_rng(distance)
    data = np.tile(rng.integers(0, 256, distance, dtype=np.uint8), 3 + 2000 // distance)
    stream = lzf.compress(data)
    out = np.empty_like(data)
    assert lzf.decompress(stream, out) == len(data)
    np.testing.assert_array_equal(out, data)
    assert (len(stream) < len(data)) == (distance <= 8192)


def test_zeros_shrink_by_nearly_the_largest_ratio() -> None:
    zeros = np.zeros(1_000_000, np.uint8)
    assert len(lzf.compress(zeros)) * (lzf.MAX_RATIO - 1) < len(zeros)
