"""How chunks are compressed: what there is, and which is the best that keeps up."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

from zsight import limits
from zsight.errors import UsageError

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from zsight_protocol.point_cloud import Buffer

__all__ = ["CHOICES", "CompressionChoice", "compressed", "decompressed", "require_choice", "stored_name"]

CHOICES = ("auto", "none", "lz4", "zstd")

_ROOM = 1.6  # a compression is used that is this much faster than what comes in
_FORGET = 0.7  # weight of the past in a measured speed


def require_choice(name: str) -> str:
    """The name, where there is such a compression.

    Raises:
        UsageError: there is none.
    """
    if name not in CHOICES:
        raise UsageError(f"compression is {name!r}; expected one of {', '.join(CHOICES)}")
    return name


def stored_name(wanted: str | None, kept: str) -> str:
    """A compression that is asked for as MCAP calls it; what is kept, which is called so, where none is.

    Raises:
        UsageError: there is none of this name, or it is auto: where nothing comes in, there is nothing to keep up with.
    """
    if wanted is None:
        return kept
    if wanted not in CHOICES[1:]:
        raise UsageError(f"compression is {wanted!r}; expected one of {', '.join(CHOICES[1:])}")
    return "" if wanted == "none" else wanted


def compressed(name: str, parts: Sequence[Buffer], size: int) -> list[Buffer]:
    """A chunk's parts as they are stored: name is '' (as they are), 'lz4' or 'zstd', as MCAP calls them."""
    if name == "lz4":
        from lz4.frame import LZ4FrameCompressor

        lz4 = LZ4FrameCompressor()
        return [lz4.begin(size), *(lz4.compress(part) for part in parts), lz4.flush()]
    if name == "zstd":
        from zstandard import ZstdCompressor

        zstd = ZstdCompressor(level=1).compressobj(size=size)
        return [*(zstd.compress(part) for part in parts), zstd.flush()]
    return list(parts)


def decompressed(name: str, stored: memoryview, size: int) -> memoryview:
    """A chunk's bytes, of which there are to be as many as it declares: whatever it holds, it takes no more memory.

    Raises:
        ValueError: they are damaged, more or fewer than declared, or too many, or the compression is not known.
    """
    if name == "":
        return stored
    if size > limits.CHUNK_BYTES:
        raise ValueError(f"a chunk of {size} bytes; expected at most {limits.CHUNK_BYTES}")
    if name == "lz4":
        from lz4.frame import create_decompression_context, decompress_chunk

        try:
            unpacked, _, is_whole = decompress_chunk(create_decompression_context(), stored, max_length=size + 1)
        except RuntimeError as error:
            raise ValueError(f"lz4: {error}") from None
        if not is_whole or len(unpacked) != size:
            raise ValueError(f"lz4: no frame of the {size} bytes that are declared")
        return memoryview(unpacked)
    if name == "zstd":
        from zstandard import ZstdDecompressor, ZstdError, frame_content_size

        try:
            if frame_content_size(stored) not in (-1, size):
                raise ValueError(f"zstd: no frame of the {size} bytes that are declared")
            return memoryview(ZstdDecompressor().decompress(stored, max_output_size=size))
        except ZstdError as error:
            raise ValueError(f"zstd: {error}") from None
    raise ValueError(f"compression {name!r} is not known; expected lz4 or zstd")


class CompressionChoice:
    """Picks the compression of the next chunk: the one asked for, or by measured speed the smallest that keeps up.

    Speeds are measured on the chunks themselves, as they come; where messages pile up, chunks go as they are.
    """

    def __init__(self, wanted: str, clock: Callable[[], float] = time.perf_counter) -> None:
        """Args: one of CHOICES; a clock, seconds."""
        self._wanted = require_choice(wanted)
        self._clock = clock
        self._speeds: dict[str, float] = {}
        self._untried = ["zstd", "lz4"] if wanted == "auto" else []

    def next(self, bytes_per_second: float, backlog: float) -> str:
        """The compression of the next chunk.

        Args:
            bytes_per_second: how fast messages come in.
            backlog: how full the queue is, 0 to 1.
        """
        if self._wanted != "auto":
            return "" if self._wanted == "none" else self._wanted
        if backlog > 0.25:
            return ""
        if self._untried:
            return self._untried[-1]
        for name in ("zstd", "lz4"):
            if self._speeds.get(name, 0.0) > _ROOM * bytes_per_second:
                return name
        return ""

    def measure(self, name: str, size: int, seconds: float) -> None:
        """A chunk of size bytes took so long to be compressed and written."""
        if name in self._untried:
            self._untried.remove(name)
        speed = size / max(seconds, 1e-9)
        self._speeds[name] = _FORGET * self._speeds.get(name, speed) + (1 - _FORGET) * speed
