"""Shared memory that a writer of clouds uses again and again."""

from __future__ import annotations

import logging
import threading
from collections import deque
from typing import TYPE_CHECKING, Any

import zenoh
from zenoh import shm

from zsight import shared_memory

if TYPE_CHECKING:
    from zsight_protocol.point_cloud import Buffer

__all__ = ["BufferRing"]

log = logging.getLogger(__name__)

_BUFFERS = 8  # a reader has seven periods to copy a cloud before it is written over: 233 ms at 30 Hz
_FEWEST = 3  # one that is written, one that is read, one on the way
_HELD = 4  # newest payloads that the writer keeps alive: what nobody holds is invalid after 0.1 to 0.2 s
_SMALLEST = 512 * 1024  # bytes that a buffer has room for at least
_OVERHEAD = 4096  # bytes that a buffer takes beside its payload, at most
_PIECE = 256 * 1024  # bytes of a view that are copied at once, small enough to stay in the cache

_WHEN_FREE = shm.GarbageCollect()
_BY_FORCE: Any = shm.Deallocate(1)  # type: ignore[arg-type]  # the stubs leave out how many


class BufferRing:
    """Some buffers of one writer, which takes the one it used longest ago; made when the first big payload comes.

    A reader that stands still keeps what is on its way to it for as long as it stands. Once all buffers are kept so,
    the oldest is taken by force: whoever still reads it finds it invalid afterwards. So no reader takes anything from
    the writer or from other readers.

    All pages are touched when the ring is made: a page that comes into being while a cloud is copied costs many times
    the copy, and on a host whose shared memory is full, writing to one ends the process.
    """

    def __init__(self) -> None:
        """Nothing is taken from the host yet."""
        self._buffers: deque[shm.ShmProvider] = deque()
        self._held: deque[zenoh.ZBytes] = deque(maxlen=_HELD)
        self._largest = 0
        self._lock = threading.Lock()

    def payload(self, head: bytes, blob: Buffer) -> zenoh.ZBytes | None:
        """Head and blob in shared memory; none where the host has no room for it."""
        size = len(head) + len(blob)
        with self._lock:
            try:
                if size > self._largest:
                    self._make(max(size + size // 4 if self._largest else size, _SMALLEST))
                if size > self._largest:
                    return None
                shared = self._take(size)
            except zenoh.ZError as error:
                log.debug("no shared memory for %d bytes: %s", size, error)
                return None
            shared[0 : len(head)] = head
            _fill(shared, len(head), blob)
            payload = zenoh.ZBytes(shared)
            self._held.append(payload)
            return payload

    def _take(self, size: int) -> shm.ZShmMut:
        """The free buffer that was used longest ago, or the one that was used longest ago of all."""
        for _ in range(len(self._buffers)):
            self._buffers.rotate(-1)
            try:
                return self._buffers[-1].alloc(size, _WHEN_FREE)
            except zenoh.ZError:
                continue
        self._buffers.rotate(-1)
        return self._buffers[-1].alloc(size, _BY_FORCE)

    def _make(self, largest: int) -> None:
        """Buffers for payloads of up to so many bytes, as many as fit into half of what the host has left."""
        count = min(_BUFFERS, shared_memory.free_bytes() // 2 // (largest + _OVERHEAD))
        if count < _FEWEST:
            log.debug("no shared memory for %d buffers of %d bytes", _FEWEST, largest)
            return
        self._held.clear()
        self._buffers = deque(_touched(largest) for _ in range(count))
        self._largest = largest

    def close(self) -> None:
        """Give the memory back, as soon as nobody reads it any more."""
        with self._lock:
            self._held.clear()
            self._buffers.clear()
            self._largest = 0


def _touched(size: int) -> shm.ShmProvider:
    """Memory for one payload, of which every page is there."""
    provider = shm.ShmProvider.default_backend(size + _OVERHEAD)
    _fill(provider.alloc(size), 0, memoryview(bytes(size)))
    return provider


def _fill(shared: shm.ZShmMut, start: int, blob: Buffer) -> None:
    """Copy a blob into shared memory; it takes bytes only, so that a view goes in pieces that stay in the cache."""
    if isinstance(blob, bytes | bytearray):
        shared[start : start + len(blob)] = blob
        return
    for piece in range(0, len(blob), _PIECE):
        end = min(piece + _PIECE, len(blob))
        shared[start + piece : start + end] = bytes(blob[piece:end])
