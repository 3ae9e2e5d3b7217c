"""A file that appears whole or not at all."""

from __future__ import annotations

import contextlib
import os
import secrets
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

from zsight_core.errors import FileError

if TYPE_CHECKING:
    from collections.abc import Iterator

__all__ = ["AnyPath", "atomic_file"]

AnyPath = str | os.PathLike[str]


@contextlib.contextmanager
def atomic_file(path: AnyPath, *, overwrite: bool = False) -> Iterator[BinaryIO]:
    """Write a file beside its place and move it there when the block ends without an error.

    Readers see the old file or the new one, never a part. If the block fails, nothing is left behind. Of several
    writers that may not overwrite exactly one succeeds.

    Args:
        path: where the file shall be.
        overwrite: replace a file that is there; otherwise that is an error.

    Yields:
        A binary file open for writing.

    Raises:
        FileError: there is a file already, the place is no regular file, or the system refuses to write.
    """
    place = Path(path)
    try:
        _require_free(place, overwrite=overwrite)
        beside = place.parent / f".zsight-{secrets.token_hex(6)}.part"
        try:
            # open(..., "xb") takes its permissions from the user's mask, which tempfile would not
            with beside.open("xb") as file:
                yield file
            _publish(beside, place, overwrite=overwrite)
        finally:
            beside.unlink(missing_ok=True)
    except OSError as error:
        raise FileError(path, f"cannot be written: {error.strerror or error}") from error
    except ValueError as error:
        if "null" not in str(error):  # only a path with a NUL in it is meant here
            raise
        raise FileError(path, f"cannot be written: {error}") from error


def _require_free(place: Path, *, overwrite: bool) -> None:
    if not overwrite and os.path.lexists(place):
        raise _exists(place)
    if place.exists() and not place.is_file():
        raise FileError(place, "is there and is not a regular file; choose another name")
    if not place.parent.is_dir():
        raise FileError(place, f"cannot be written: there is no folder {place.parent}; make it first")


def _publish(beside: Path, place: Path, *, overwrite: bool) -> None:
    """Move the finished file to its place; a link, unlike a rename, fails where a file has appeared meanwhile."""
    if overwrite:
        beside.replace(place)
        return
    try:
        os.link(beside, place)
    except FileExistsError:
        raise _exists(place) from None
    except OSError:  # a file system without hard links
        _reserve_and_publish(beside, place)


def _reserve_and_publish(beside: Path, place: Path) -> None:
    """The same with an empty file as the reservation: only its maker goes on to replace it."""
    try:
        place.open("xb").close()
    except FileExistsError:
        raise _exists(place) from None
    beside.replace(place)


def _exists(place: Path) -> FileError:
    return FileError(place, "there is a file of this name already; choose another name or ask to overwrite it")
