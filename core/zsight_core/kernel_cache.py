"""Where compiled kernels are kept: one folder per user and per set of sources, chosen before numba is imported.

Numba checks by itself that a cached kernel fits its own source file (size and time), the numba version and the
processor. It does not see that a kernel of *another* file, compiled into this one, has changed; therefore the name of
the folder carries a digest of the files whose kernels are compiled into others (``SHARED``) and the package version.
"""

from __future__ import annotations

import hashlib
import os
import platform
import sys
import tempfile
from functools import cache
from pathlib import Path

__all__ = ["SHARED", "folder", "is_stamped", "stamp", "use"]

SHARED = (
    "search/bits.py",
    "search/contour.py",
    "disjoint_sets.py",
    "files/eight_bytes.py",
    "image_normals.py",
    "jit.py",
    "kernel_loading.py",
    "search/model_bits.py",
    "moments.py",
    "neighbour_grid.py",
    "files/number_kinds.py",
    "search/peek.py",
    "points.py",
    "render.py",
    "simulation/depth_edge.py",
    "take.py",
    "tile.py",
    "words.py",
)
"""Files of this package whose kernels are called by kernels of other files, which a test compares with the code; and
those that say how a kernel is compiled and what is kept of it."""

_PACKAGE = Path(__file__).resolve().parent


def use() -> Path:
    """Make numba keep its kernels in `folder`; called by ``import zsight_core``; a NUMBA_CACHE_DIR set outside wins.

    Returns:
        The folder in use; it need not exist yet.
    """
    chosen = Path(os.environ.setdefault("NUMBA_CACHE_DIR", str(folder())))
    alike = int(os.environ.setdefault("NUMBA_SLP_VECTORIZE", "1"))  # like operations of one point at once
    numba = sys.modules.get("numba")
    if numba is not None:
        numba.config.CACHE_DIR = numba.config.CACHE_DIR or str(chosen)
        numba.config.SLP_VECTORIZE = alike
    return chosen


@cache
def folder() -> Path:
    """``$XDG_CACHE_HOME/zsight/kernels-<tag>``, else below ``~/.cache``, else below the temporary folder."""
    name = f"kernels-{_tag()}"
    for parent in (_user_cache(), Path(tempfile.gettempdir()) / f"zsight-{_user()}"):
        if _is_writable(parent):
            return parent / name
    return Path(tempfile.mkdtemp(prefix="zsight-")) / name


def stamp() -> None:
    """Note in the folder in use that all kernels of the present sources are compiled."""
    path = _stamp()
    path.parent.mkdir(parents=True, exist_ok=True)
    path.touch()


def is_stamped() -> bool:
    """True where `stamp` was called for exactly these sources, this numba and this processor; costs about 1 ms."""
    return _stamp().is_file()


def _stamp() -> Path:
    """A file for each state: several checkouts and environments of a user share the folder."""
    return use() / f"warm-{_state()}"


def _tag() -> str:
    """What a folder of kernels depends on beyond what numba checks itself."""
    digest = hashlib.blake2b(digest_size=6)
    for path in (_PACKAGE / name for name in SHARED):
        digest.update(path.read_bytes() if path.exists() else b"")
    for part in (_version("zsight"), _version("numba")):
        digest.update(part.encode())
    return f"{sys.implementation.cache_tag}-{platform.machine()}-{digest.hexdigest()}"


def _state() -> str:
    """Digest over names, sizes and times of all source files, the numba version and the processor's features."""
    digest = hashlib.blake2b(digest_size=16)
    for path in sorted(_PACKAGE.rglob("*.py")):
        facts = path.stat()
        digest.update(f"{path.relative_to(_PACKAGE)} {facts.st_size} {facts.st_mtime_ns}\n".encode())
    digest.update(f"{_version('numba')} {_processor()}".encode())
    return digest.hexdigest()


def _version(distribution: str) -> str:
    """Version by reading the installed metadata, without importing the (slow) package itself."""
    from importlib import metadata

    try:
        return metadata.version(distribution)
    except metadata.PackageNotFoundError:
        return "none"


def _processor() -> str:
    """Model and features as the kernel states them on Linux; elsewhere what Python knows."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").split("\n\n", 1)[0].splitlines()
    except OSError:
        return platform.processor()
    return "\n".join(line for line in lines if line.startswith(("model name", "flags", "Features")))


def _user_cache() -> Path:
    configured = os.environ.get("XDG_CACHE_HOME", "")
    if configured and Path(configured).is_absolute():
        return Path(configured) / "zsight"
    try:
        return Path.home() / ".cache" / "zsight"
    except RuntimeError:  # no home folder is known for this user
        return Path(tempfile.gettempdir()) / f"zsight-{_user()}"


def _user() -> str:
    return str(os.getuid()) if hasattr(os, "getuid") else os.environ.get("USERNAME", "user")


def _is_writable(parent: Path) -> bool:
    """True where a file can be made in `parent` and it belongs to this user (/tmp may hold somebody else's)."""
    try:
        parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        owned = not hasattr(os, "getuid") or parent.stat().st_uid == os.getuid()
        with tempfile.TemporaryFile(dir=parent):
            return owned
    except OSError:
        return False
