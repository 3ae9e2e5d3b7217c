"""Files that a user's processes leave for each other where other users may write, too."""

from __future__ import annotations

import os
import stat
import tempfile
from pathlib import Path
from typing import IO

from zsight.errors import UsageError

__all__ = ["folder", "open_own"]


def folder() -> Path:
    """XDG_RUNTIME_DIR, which is a user's own, else the folder for temporary files, which is everybody's."""
    return Path(os.environ.get("XDG_RUNTIME_DIR") or tempfile.gettempdir())


def open_own(path: Path, flags: int = 0) -> IO[bytes]:
    """A file of this user, open; others may put links and files of theirs where it is expected.

    Raises:
        UsageError: it is not this user's own.
        FileNotFoundError: it is not there, and flags do not ask for it to be made.
    """
    problem = f"{path} is no file of this user's own: remove it, or set XDG_RUNTIME_DIR to a folder that is"
    try:
        handle = os.open(path, os.O_RDWR | os.O_NOFOLLOW | flags, 0o600)
    except FileNotFoundError:
        raise
    except OSError as error:
        raise UsageError(f"{problem} ({error.strerror})") from None
    file = os.fdopen(handle, "r+b", buffering=0)
    state = os.fstat(handle)
    if state.st_uid != os.getuid() or not stat.S_ISREG(state.st_mode):
        file.close()
        raise UsageError(problem)
    return file
