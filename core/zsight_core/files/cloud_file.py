"""A cloud from a file of any kind that is known here: PCD or PLY."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from zsight_core.errors import FileError
from zsight_core.files import pcd, ply
from zsight_core.files.pcd_header import LEVEL, Viewpoint

if TYPE_CHECKING:
    from zsight_core.files.atomic_file import AnyPath
    from zsight_core.points import Points

__all__ = ["SUFFIXES", "LoadedCloud", "list_clouds", "natural_order", "read"]

SUFFIXES = (".pcd", ".ply")


@dataclass(frozen=True, eq=False)  # arrays do not compare to one truth value
class LoadedCloud:
    """A cloud ready for use.

    ``points`` (H, W) with float32 x, y, z, metres, and the file's further fields; ``viewpoint`` x y z qw qx qy qz,
    where the sensor stood, metres, and its quaternion with w first; the identity where the file does not say.
    """

    points: Points
    viewpoint: Viewpoint = LEVEL


def read(path: AnyPath) -> LoadedCloud:
    """Read a cloud; its suffix says how.

    Raises:
        FileError: unknown suffix, no such file, damaged, or without x, y, z.
    """
    match Path(path).suffix.lower():
        case ".pcd":
            file = pcd.read(path)
            return LoadedCloud(_usable(file.points, path), file.viewpoint)
        case ".ply":
            return LoadedCloud(_usable(ply.read(path).points, path))
        case suffix:
            raise FileError(path, f"has the suffix {suffix!r}; clouds are read from {' and '.join(SUFFIXES)} files")


def list_clouds(folder: AnyPath) -> list[Path]:
    """The cloud files in a folder (not below it), in natural order: frame2 before frame10.

    Raises:
        FileError: there is no such folder, or it cannot be read.
    """
    try:
        files = [path for path in Path(folder).iterdir() if path.suffix.lower() in SUFFIXES and path.is_file()]
    except OSError as error:
        raise FileError(folder, f"cannot be listed: {error.strerror or error}") from error
    return sorted((path for path in files if not path.name.startswith(".")), key=lambda path: natural_order(path.name))


def natural_order(name: str) -> tuple[list[tuple[int, int, str]], str]:
    """A key to sort names by, in which runs of digits count as numbers."""
    parts = re.findall(r"([0-9]+)|([^0-9]+)", name)
    return [(0, int(digits), "") if digits else (1, 0, letters.lower()) for digits, letters in parts], name


def _usable(points: Points, path: AnyPath) -> Points:
    """The points with x, y, z as float32, as the rest of the package expects them; a copy only where they are not."""
    names = points.dtype.names or ()
    if any(axis not in names or points.dtype[axis].shape != () for axis in "xyz"):
        raise FileError(path, f"has the fields {', '.join(names)}; expected x, y and z among them, one number each")
    if all(points.dtype[axis] == np.dtype("<f4") for axis in "xyz"):
        return points
    formats: list[Any] = [np.dtype("<f4") if name in tuple("xyz") else points.dtype[name] for name in names]
    single = np.empty(points.shape, np.dtype(list(zip(names, formats, strict=True))))
    for name in names:
        with np.errstate(over="ignore"):
            single[name] = points[name]
    return single
