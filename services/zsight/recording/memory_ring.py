"""The last seconds in memory, so that what led to an event can be written when it happens."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from zsight.recording.sample import Sample

__all__ = ["MemoryRing"]


class MemoryRing:
    """Samples of the last seconds, as long as they fit; not safe between threads."""

    def __init__(self, seconds: float, limit: int) -> None:
        """Args: seconds that are kept; bytes that they may take."""
        self._span_ns = int(seconds * 1e9)
        self._limit = limit
        self._samples: deque[Sample] = deque()
        self._size = 0

    def put(self, sample: Sample) -> None:
        """Keep a sample, and forget what is too old or does not fit."""
        self._samples.append(sample)
        self._size += len(sample.payload)
        oldest = sample.received_ns - self._span_ns
        while self._samples and (self._samples[0].received_ns < oldest or self._size > self._limit):
            self._size -= len(self._samples.popleft().payload)

    @property
    def seconds(self) -> float:
        """The time between the oldest and the newest sample."""
        if not self._samples:
            return 0.0
        return (self._samples[-1].received_ns - self._samples[0].received_ns) / 1e9

    def samples(self) -> list[Sample]:
        """All samples, oldest first."""
        return list(self._samples)

    def clear(self) -> None:
        """Forget all of them."""
        self._samples, self._size = deque(), 0
