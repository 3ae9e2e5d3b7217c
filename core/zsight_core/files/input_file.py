"""A file being read by somebody who believes its size and nothing else."""

from __future__ import annotations

import contextlib
import os
import stat
from typing import TYPE_CHECKING, Any

import numpy as np

from zsight_core.errors import FileError

if TYPE_CHECKING:
    from collections.abc import Iterator
    from io import BufferedReader
    from types import TracebackType

    from numpy.typing import NDArray

    from zsight_core.files.atomic_file import AnyPath

__all__ = ["Descriptor", "fill", "input_file", "require_size"]


class Descriptor:
    """A regular file open for reading, as ``with`` gives it: its descriptor, and its size in bytes.

    Files of Python's and generators as contexts would cost as much as all else but the reading of a cloud.

    Raises:
        FileError: it is not there, not regular or may not be read; also for errors of the system within the block.
    """

    def __init__(self, path: AnyPath) -> None:
        self._path = path
        self._opened = -1

    def __enter__(self) -> tuple[int, int]:
        try:  # O_NONBLOCK: not to wait for a pipe's other end
            self._opened = os.open(self._path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)
        except (OSError, ValueError) as error:  # a ValueError for a path with a NUL in it
            raise FileError(self._path, _told(error)) from error
        facts = os.fstat(self._opened)
        if not stat.S_ISREG(facts.st_mode):
            os.close(self._opened)
            raise FileError(self._path, "is not a regular file")
        return self._opened, facts.st_size

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        os.close(self._opened)
        if isinstance(error, OSError):
            raise FileError(self._path, _told(error)) from error


def _told(error: OSError | ValueError) -> str:
    return f"cannot be read: {getattr(error, 'strerror', None) or error}"


@contextlib.contextmanager
def input_file(path: AnyPath) -> Iterator[tuple[BufferedReader, int]]:
    """A regular file open for reading, and its size in bytes; raises what `Descriptor` does."""
    with Descriptor(path) as (opened, size), open(opened, "rb", closefd=False) as file:
        yield file, size


def require_size(size: int, expected: int, path: AnyPath) -> None:
    """Check that the ``size`` bytes that are there can hold the ``expected`` that the header promises.

    Raises:
        FileError: they cannot.
    """
    if size < expected:
        raise FileError(path, f"is cut short: {expected} bytes of data are promised, {size} are there")


def fill(opened: int, array: NDArray[Any], at: int, path: AnyPath) -> None:
    """Read as many bytes from the byte ``at`` on as a contiguous array of one dimension has.

    Raises:
        FileError: fewer are there; a file can shrink while it is read.
    """
    got = os.preadv(opened, [array], at)  # type: ignore[list-item]  # a buffer, though not by numpy's types
    while got < array.nbytes:  # one call reads 2 GB at most
        more = os.preadv(opened, [array.view(np.uint8)[got:].data], at + got)
        if more == 0:
            raise FileError(path, f"is cut short: {got} of {array.nbytes} bytes of data are there")
        got += more
