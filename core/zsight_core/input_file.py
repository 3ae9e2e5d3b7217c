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

    from numpy.typing import NDArray

    from zsight_core.atomic_file import AnyPath

__all__ = ["fill", "input_file", "require_size"]


@contextlib.contextmanager
def input_file(path: AnyPath) -> Iterator[tuple[BufferedReader, int]]:
    """A regular file open for reading, and its size in bytes.

    Raises:
        FileError: it is not there, not regular or may not be read; also for errors of the system within the block.
    """
    try:
        facts = os.stat(path)  # noqa: PTH116  a Path costs as much as the rest of this
        if not stat.S_ISREG(facts.st_mode):  # asked before opening: that would wait for a pipe's other end
            raise FileError(path, "is not a regular file")
        with open(path, "rb") as file:  # noqa: PTH123
            yield file, os.fstat(file.fileno()).st_size
    except OSError as error:
        raise FileError(path, f"cannot be read: {error.strerror or error}") from error
    except ValueError as error:
        if "null" not in str(error):  # only a path with a NUL in it is meant here
            raise
        raise FileError(path, f"cannot be read: {error}") from error


def require_size(size: int, expected: int, path: AnyPath) -> None:
    """Check that the ``size`` bytes that are there can hold the ``expected`` that the header promises.

    Raises:
        FileError: they cannot.
    """
    if size < expected:
        raise FileError(path, f"is cut short: {expected} bytes of data are promised, {size} are there")


def fill(file: BufferedReader, array: NDArray[Any], path: AnyPath) -> None:
    """Read as many bytes as a contiguous array has.

    Raises:
        FileError: fewer are there; a file can shrink while it is read.
    """
    if array.nbytes == 0:
        return
    got = file.readinto(array.view(np.uint8).data)
    if got != array.nbytes:
        raise FileError(path, f"is cut short: {got} of {array.nbytes} bytes of data are there")
