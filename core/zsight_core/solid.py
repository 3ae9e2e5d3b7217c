"""The triangles and edges of a shape: what rendering, refinement and verification know of an object."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from zsight_core.errors import ModelError
from zsight_core.model import Box, Cylinder, Mesh, Shape, Sphere

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["Solid", "solid_of"]

SIDES = 48
"""Facets around a cylinder."""


FEW_FACES = 500
"""Faces of a mesh at most for a quick look; those of a finer one are clustered."""

FINEST = 24.0
"""Cubes along the diagonal of a mesh in which its vertices are first clustered."""


@dataclass(frozen=True, eq=False)
class Solid:
    """A closed surface of triangles in the model frame."""

    vertices: NDArray[np.float64]
    """(V, 3) metres."""
    faces: NDArray[np.int32]
    """(F, 3) counter-clockwise seen from outside."""
    edges: NDArray[np.int32]
    """(E, 4) both vertices and both faces of each edge; -1 for the second face of an open border."""


def solid_of(shape: Shape, *, coarse: bool = False) -> Solid:
    """Triangulate a shape; the same shape is triangulated once.

    Args:
        shape: any but a surface.
        coarse: fewer facets on curved shapes, for a quick look.

    Curved shapes are drawn so that their facets lie half outside and half inside of the true surface.

    Raises:
        ModelError: a surface has no closed shape.
    """
    match shape:
        case Box(size):
            return _box_solid(size)
        case Cylinder(diameter, height):
            return _cylinder_solid(diameter / 2, height, 12 if coarse else SIDES)
        case Sphere(diameter):
            return _sphere_solid(diameter / 2, 1 if coarse else 3)
        case Mesh(vertices, faces):
            return _mesh_solid(vertices.astype(np.float64).tobytes(), faces.astype(np.int32).tobytes(), coarse)
        case _:
            raise ModelError(f"{type(shape).__name__} is not a solid; expected a box, cylinder, sphere or mesh")


@lru_cache(maxsize=64)
def _box_solid(size: tuple[float, float, float]) -> Solid:
    return _solid(*_box(np.array(size)))


@lru_cache(maxsize=64)
def _cylinder_solid(radius: float, height: float, sides: int) -> Solid:
    return _solid(*_cylinder(radius, height, sides))


@lru_cache(maxsize=64)
def _sphere_solid(radius: float, cuts: int) -> Solid:
    return _solid(*_sphere(radius, cuts))


@lru_cache(maxsize=64)
def _mesh_solid(vertices: bytes, faces: bytes, coarse: bool) -> Solid:
    corners = np.frombuffer(vertices).reshape(-1, 3)
    triangles = np.frombuffer(faces, np.int32).reshape(-1, 3)
    corners = corners - (corners.min(axis=0) + corners.max(axis=0)) / 2
    a, b, c = (corners[triangles[:, k]] for k in range(3))
    inside_out = float(np.einsum("ij,ij->", a, np.cross(b, c))) < 0  # files with clockwise faces are common
    triangles = triangles[:, ::-1] if inside_out else triangles
    cell = float(np.linalg.norm(np.ptp(corners, axis=0))) / FINEST
    while coarse and len(triangles) > FEW_FACES:
        corners, triangles = _clustered(corners, triangles, cell)
        cell *= 1.25
    return _solid(corners, triangles)


def _clustered(
    vertices: NDArray[np.float64], faces: NDArray[np.int32], cell: float
) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """A mesh with one vertex a cube of this side, where any were (Rossignac and Borrel 1993)."""
    cubes, number = np.unique(np.floor(vertices / cell).astype(np.int64), axis=0, return_inverse=True)
    number = number.reshape(-1)
    counts = np.bincount(number, minlength=len(cubes))
    means = [np.bincount(number, vertices[:, axis], len(cubes)) / counts for axis in range(3)]
    renamed = number[faces]
    whole = (renamed[:, 0] != renamed[:, 1]) & (renamed[:, 1] != renamed[:, 2]) & (renamed[:, 2] != renamed[:, 0])
    first = np.argmin(renamed, axis=1)[:, np.newaxis]
    ordered = np.take_along_axis(renamed, (first + np.arange(3)) % 3, axis=1)
    return np.stack(means, axis=1), np.unique(ordered[whole], axis=0).astype(np.int32)


def _solid(vertices: NDArray[np.float64], faces: NDArray[np.int32]) -> Solid:
    return Solid(np.ascontiguousarray(vertices), np.array(faces, np.int32), _edges(faces))


def _box(size: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * size / 2
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return corners, np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))], np.int32)


def _cylinder(radius: float, height: float, sides: int) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    around = np.arange(sides) * 2 * np.pi / sides
    r = radius * 2 / (1 + np.cos(np.pi / sides))
    ring = np.stack([r * np.cos(around), r * np.sin(around)], axis=1)
    low = np.column_stack([ring, np.full(sides, -height / 2)])
    vertices = np.concatenate([low, low + np.array([0, 0, height]), [[0, 0, -height / 2], [0, 0, height / 2]]])
    faces = []
    for i in range(sides):
        j = (i + 1) % sides
        faces += [
            (i, j, sides + j),
            (i, sides + j, sides + i),
            (2 * sides, j, i),
            (2 * sides + 1, sides + i, sides + j),
        ]
    return vertices, np.array(faces, np.int32)


def _sphere(radius: float, cuts: int) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """An icosahedron, each face cut in four so many times."""
    g = (1 + 5**0.5) / 2
    corners: list[tuple[float, float, float]]
    corners = [(-1, g, 0), (1, g, 0), (-1, -g, 0), (1, -g, 0), (0, -1, g), (0, 1, g), (0, -1, -g), (0, 1, -g)]
    corners += [(g, 0, -1), (g, 0, 1), (-g, 0, -1), (-g, 0, 1)]
    vertices = [np.array(c) / np.hypot(1, g) for c in corners]
    faces = [(0, 11, 5), (0, 5, 1), (0, 1, 7), (0, 7, 10), (0, 10, 11), (1, 5, 9), (5, 11, 4), (11, 10, 2), (10, 7, 6)]
    faces += [(7, 1, 8), (3, 9, 4), (3, 4, 2), (3, 2, 6), (3, 6, 8), (3, 8, 9), (4, 9, 5), (2, 4, 11), (6, 2, 10)]
    faces += [(8, 6, 7), (9, 8, 1)]
    for _ in range(cuts):
        middle: dict[tuple[int, int], int] = {}
        finer = []
        for a, b, c in faces:
            ab, bc, ca = (_halfway(vertices, middle, i, j) for i, j in ((a, b), (b, c), (c, a)))
            finer += [(a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca)]
        faces = finer
    points = np.array(vertices)
    triangles = np.array(faces, np.int32)
    inward = np.linalg.norm(points[triangles].mean(axis=1), axis=1).mean()
    return points * radius * 2 / (1 + inward), triangles


def _halfway(vertices: list[NDArray[np.float64]], middle: dict[tuple[int, int], int], i: int, j: int) -> int:
    key = (min(i, j), max(i, j))
    if key not in middle:
        point = vertices[i] + vertices[j]
        middle[key] = len(vertices)
        vertices.append(point / np.linalg.norm(point))
    return middle[key]


def _edges(faces: NDArray[np.int32]) -> NDArray[np.int32]:
    """Each undirected edge once, with the faces on both sides."""
    ends = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    face = np.tile(np.arange(len(faces)), 3)
    ends = np.sort(ends, axis=1)
    order = np.lexsort((face, ends[:, 1], ends[:, 0]))
    ends, face = ends[order], face[order]
    first = np.concatenate([[True], (ends[1:] != ends[:-1]).any(axis=1)])
    starts = np.flatnonzero(first)
    paired = np.append(~first[1:], False)[starts]
    other = np.where(paired, face[np.minimum(starts + 1, len(face) - 1)], -1)
    return np.column_stack([ends[starts], face[starts], other]).astype(np.int32)
