"""Triangle meshes from files: STL, PLY, OBJ, GLB."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from zsight_core import open3d_module
from zsight_core.errors import FileError, ModelError
from zsight_core.model import Mesh

if TYPE_CHECKING:
    import os

    from numpy.typing import NDArray

__all__ = ["read"]

_STL_HEADER = 84
_STL_FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


def read(path: str | os.PathLike[str], scale: float = 1.0) -> Mesh:
    """The mesh in a file, its bounding box centred on the origin.

    Args:
        path: a .stl, .ply, .obj or .glb file.
        scale: turns the file's unit into metres.

    Raises:
        FileError: the file is missing, is not a mesh, or holds no triangles.
    """
    file = Path(path)
    if not file.is_file():
        raise FileError(path, "no such file; expected a mesh (.stl, .ply, .obj or .glb)")
    corners = _binary_stl(file)
    vertices, faces = _joined(corners) if corners is not None else _by_open3d(file)
    vertices = vertices * scale
    centre = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    try:
        return Mesh(vertices - centre, faces)
    except ModelError as error:
        raise FileError(path, str(error)) from None


def _binary_stl(file: Path) -> NDArray[np.float64] | None:
    """Corners (F, 3, 3) of a binary STL file, which a length that fits its count makes known; else none.

    Binary STL is most of all meshes in robotics, and is read here without the second that importing open3d takes.
    """
    data = file.read_bytes()
    if file.suffix.lower() != ".stl" or len(data) < _STL_HEADER:
        return None
    count = int.from_bytes(data[80:_STL_HEADER], "little")
    if count == 0 or len(data) != _STL_HEADER + count * _STL_FACET.itemsize:
        return None
    facets = np.frombuffer(data, dtype=_STL_FACET, offset=_STL_HEADER)
    return facets["corners"].astype(np.float64)


def _joined(corners: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Vertices and faces in place of loose triangles: equal corners become one vertex."""
    vertices, index = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    return vertices, index.reshape(-1, 3).astype(np.int32)


def _by_open3d(file: Path) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    open3d = open3d_module.load()
    with open3d.utility.VerbosityContextManager(open3d.utility.VerbosityLevel.Error):
        mesh = open3d.io.read_triangle_mesh(str(file))
    vertices = np.asarray(mesh.vertices, dtype=np.float64)
    faces = np.asarray(mesh.triangles, dtype=np.int32)
    if len(faces) == 0:
        raise FileError(file, "no triangles in it; expected a mesh (.stl, .ply, .obj or .glb)")
    return vertices, faces
