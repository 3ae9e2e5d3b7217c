"""The host's shared memory: how much is left, and what dead processes left behind."""

from __future__ import annotations

import contextlib
import os
import sys
from pathlib import Path

__all__ = ["free_bytes", "remove_orphans"]

_FOLDER = Path("/dev/shm")  # noqa: S108  where Linux keeps POSIX shared memory


def free_bytes(folder: Path = _FOLDER) -> int:
    """Shared memory that is left; without bound where the system does not say."""
    try:
        room = os.statvfs(folder)
    except (OSError, AttributeError):  # Windows has no statvfs, other systems no such folder
        return sys.maxsize
    return room.f_bavail * room.f_frsize


def remove_orphans(folder: Path = _FOLDER) -> int:
    """Remove Zenoh's segments that no process holds any more; how many there were.

    Zenoh locks (flock) every segment in use and unlinks at most what its own process made, so a killed process leaves
    its segments. One that can be locked exclusively is nobody's.
    """
    try:
        import fcntl
    except ImportError:  # no such locks on Windows, where segments vanish with their last process
        return 0
    removed = 0
    for path in folder.glob("*.zenoh"):
        with contextlib.suppress(OSError):
            descriptor = os.open(path, os.O_RDWR | os.O_NOFOLLOW)
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
                path.unlink()
                removed += 1
            finally:
                os.close(descriptor)
    return removed
