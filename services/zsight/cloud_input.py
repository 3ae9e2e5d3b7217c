"""Clouds from and to files, as commands take them: .pcd, .ply, or a depth image with its partner and intrinsics."""

from __future__ import annotations

from typing import TYPE_CHECKING

from zsight.errors import UsageError
from zsight.sources import pose_matrix, viewpoint_matrix
from zsight_core.files import cloud_file, depth_camera, pcd, ply, rgbd
from zsight_core.files.cloud_file import LoadedCloud

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    import numpy as np
    from numpy.typing import NDArray

    from zsight_core.points import Points

__all__ = ["camera_pose", "read", "require_place", "write"]

_LEVEL = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)
_COLOUR, _DEPTH = "-color.png", "-depth.png"


def read(path: Path, intrinsics: Path | None = None) -> LoadedCloud:
    """A cloud from a file.

    Args:
        path: .pcd, .ply, or one image of a pair NAME-color.png and NAME-depth.png.
        intrinsics: camera.toml or .json of a pair; left out: the one in the pair's folder.

    Raises:
        FileError: the file cannot be read; says why.
        UsageError: a pair has no intrinsics.
    """
    if not path.name.endswith((_COLOUR, _DEPTH)):
        return cloud_file.read(path)
    stem = path.name[: -len(_COLOUR)]
    camera = depth_camera.read(intrinsics) if intrinsics is not None else depth_camera.find(path.parent)
    if camera is None:
        raise UsageError(f"{path} needs its camera: give --intrinsics FILE, or put camera.toml beside it")
    return LoadedCloud(rgbd.read(path.parent / (stem + _COLOUR), path.parent / (stem + _DEPTH), camera))


def camera_pose(text: str, cloud: LoadedCloud) -> NDArray[np.float64] | None:
    """T_world_camera (4, 4) of "x y z qx qy qz qw", or of a cloud where the text is "viewpoint"; none of no text.

    Raises:
        UsageError: the text is something else.
    """
    if text == "viewpoint":
        return viewpoint_matrix(cloud.viewpoint)
    return pose_matrix(text) if text else None


def require_place(path: Path, *, ascii_text: bool = False, compressed: bool = False, overwrite: bool = False) -> None:
    """That a cloud may be written to a path, before it is made.

    Raises:
        UsageError: the file exists and overwrite is not given; the suffix is neither .pcd nor .ply, or the encoding
            does not exist there.
    """
    suffix = path.suffix.lower()
    if path.exists() and not overwrite:
        raise UsageError(f"{path} is there already: choose another name, or give --force to overwrite it")
    if ascii_text and compressed:
        raise UsageError("a cloud is either ascii or compressed: choose one")
    if suffix == ".ply" and compressed:
        raise UsageError("PLY has no compressed encoding: write a .pcd, or leave --compressed out")
    if suffix not in (".pcd", ".ply"):
        raise UsageError(f"cannot write {path}: expected a name that ends in .pcd or .ply")


def write(
    path: Path,
    points: Points,
    *,
    viewpoint: Sequence[float] = _LEVEL,
    ascii_text: bool = False,
    compressed: bool = False,
    overwrite: bool = False,
) -> None:
    """Write a cloud; the file appears whole or not at all.

    Raises:
        FileError: it cannot be written.
        UsageError: see ``require_place``.
    """
    require_place(path, ascii_text=ascii_text, compressed=compressed, overwrite=overwrite)
    if path.suffix.lower() == ".pcd":
        encoding: pcd.Encoding = "ascii" if ascii_text else "binary_compressed" if compressed else "binary"
        pcd.write(path, points, viewpoint=viewpoint, encoding=encoding, overwrite=overwrite)
    else:
        ply.write(path, points, encoding="ascii" if ascii_text else "binary_little_endian", overwrite=overwrite)
