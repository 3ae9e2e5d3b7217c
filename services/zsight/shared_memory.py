"""The host's shared memory: how much is left, and what dead processes left behind."""

from __future__ import annotations

import contextlib
import os
import sys
from pathlib import Path

if sys.platform != "win32":  # there segments vanish with their last process
    import fcntl

__all__ = ["free_bytes", "leave", "remove_orphans", "total_bytes"]

_FOLDER = Path("/dev/shm")  # noqa: S108  where Linux keeps POSIX shared memory


def free_bytes(folder: Path = _FOLDER) -> int:
    """Shared memory that is left; without bound where the system does not say."""
    try:
        room = os.statvfs(folder)
    except (OSError, AttributeError):  # Windows has no statvfs, other systems no such folder
        return sys.maxsize
    return room.f_bavail * room.f_frsize


def total_bytes(folder: Path = _FOLDER) -> int:
    """Shared memory that this host or container has; without bound where the system does not say."""
    try:
        room = os.statvfs(folder)
    except (OSError, AttributeError):
        return sys.maxsize
    return room.f_blocks * room.f_frsize


def remove_orphans(folder: Path = _FOLDER) -> int:
    """Remove Zenoh's segments that no process holds any more; how many there were.

    Zenoh locks (flock) every segment in use and unlinks at most what its own process made, so a killed process leaves
    its segments. One that can be locked exclusively is nobody's.
    """
    return sum(_remove_unheld(path) for path in folder.glob("*.zenoh"))


def leave(folder: Path = _FOLDER) -> int:
    """At the very end of a process: let go of the segments it uses and remove those that nobody else does; how many.

    Zenoh keeps some mapped and locked until the process is gone, and then nobody is left to remove them.
    """
    own = _own(folder)
    if sys.platform == "win32":
        return 0
    for descriptor in (descriptor for descriptors in own.values() for descriptor in descriptors):
        with contextlib.suppress(OSError):
            fcntl.flock(descriptor, fcntl.LOCK_UN)
    return sum(_remove_unheld(path) for path in own)


def _own(folder: Path) -> dict[Path, list[int]]:
    """The segments that this process has open, with their file descriptors; none where the system does not say."""
    own: dict[Path, list[int]] = {}
    with contextlib.suppress(OSError):
        for link in Path("/proc/self/fd").iterdir():
            with contextlib.suppress(OSError):
                path = link.readlink()
                if path.parent == folder and path.suffix == ".zenoh":
                    own.setdefault(path, []).append(int(link.name))
    return own


def _remove_unheld(path: Path) -> bool:
    if sys.platform == "win32":
        return False
    with contextlib.suppress(OSError):
        descriptor = os.open(path, os.O_RDWR | os.O_NOFOLLOW)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            path.unlink()
            return True
        finally:
            os.close(descriptor)
    return False
