"""Makes the mesh files that lie beside it; run again after changing a dimension: ``python make_meshes.py``.

Each mesh is closed, in metres, its faces counter-clockwise seen from outside, its origin at the centre of its
bounding box.
"""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from zsight_core.open3d_module import load as load_open3d

if TYPE_CHECKING:
    from numpy.typing import NDArray

HERE = Path(__file__).resolve().parent

STL_TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attributes", "<u2")])

Triangles = tuple["NDArray[np.float64]", "NDArray[np.int64]"]
"""Vertices (V, 3), metres, and faces (F, 3)."""


def mug() -> Triangles:
    """A cylindrical mug, 82 mm across and 95 mm high, with a handle toward +x that reaches 33 mm out.

    The outer wall has two openings of two by two cells; the handle grows from the eight corners of one to those of
    the other, so that wall and handle are one closed surface.
    """
    outer, inner, height, floor = 0.041, 0.037, 0.095, 0.006
    width, thickness, low, high = 0.0065, 0.0045, 0.0205, 0.0785  # halves of the handle, heights of its ends
    side = np.arcsin(width / outer)
    angles = np.concatenate([[-side, 0.0], np.linspace(side, 2 * np.pi - side, 45, endpoint=False)])
    wall_heights = [0.0, *(low + thickness * np.arange(-1, 2)), *(high + thickness * np.arange(-1, 2)), height]
    profile = [(outer, z) for z in wall_heights] + [(inner, height), (inner, floor)]
    vertices, cells = _revolve(profile, angles, bottom=0.0, top=floor)
    openings = {(column, row) for column in (0, 1) for row in (1, 2, 4, 5)}
    faces = [face for cell, pair in cells.items() if cell not in openings for face in pair]
    start = [row * len(angles) + column for column, row in _around(column=1, row=2)]
    end = [row * len(angles) + column for column, row in _around(column=1, row=5, upward=-1)]
    rings = _handle_rings(width, thickness, low, high, x=outer, reach=0.033 - thickness)
    links = [start, *(list(range(len(vertices) + 8 * k, len(vertices) + 8 * k + 8)) for k in range(len(rings))), end]
    for inside, outside in pairwise(links):
        for i in range(8):
            j = (i + 1) % 8
            faces += _quad(inside[i], inside[j], outside[j], outside[i])
    return np.vstack([vertices, *rings]), np.array(faces)


RING = ((-1, -1), (0, -1), (1, -1), (1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0))
"""The eight corners around two by two cells, counter-clockwise: steps across and up."""


def _around(column: int, row: int, upward: int = 1) -> list[tuple[int, int]]:
    return [(column + across, row + upward * up) for across, up in RING]


def _handle_rings(
    width: float, thickness: float, low: float, high: float, x: float, reach: float
) -> list[NDArray[np.float64]]:
    """Rounded cross-sections (8, 3) along a half ellipse from the lower to the upper end."""
    rounded = np.array([np.array(corner) / np.linalg.norm(corner) for corner in RING]) * [width, thickness]
    rings = []
    for angle in np.linspace(-np.pi / 2, np.pi / 2, 17)[1:-1]:
        centre = np.array([x + reach * np.cos(angle), 0.0, (low + high) / 2 + (high - low) / 2 * np.sin(angle)])
        tangent = np.array([-reach * np.sin(angle), 0.0, (high - low) / 2 * np.cos(angle)])
        tangent /= np.linalg.norm(tangent)
        inward = np.array([-tangent[2], 0.0, tangent[0]])
        rings.append(centre + rounded[:, :1] * [0.0, 1.0, 0.0] + rounded[:, 1:] * inward)
    return rings


def l_bracket() -> Triangles:
    """Two flat legs at a right angle: 80 mm along x, 60 mm along z, 40 mm wide, 8 mm thick."""
    outline = np.array([[0, 0], [0.08, 0], [0.08, 0.008], [0.008, 0.008], [0.008, 0.06], [0, 0.06]])
    front = np.insert(outline, 1, -0.02, axis=1)
    back = np.insert(outline, 1, 0.02, axis=1)
    cap = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 5]])
    n = len(outline)
    sides = [face for i in range(n) for face in _quad(i, i + n, (i + 1) % n + n, (i + 1) % n)]
    return np.vstack([front, back]), np.vstack([cap, cap[:, ::-1] + n, sides])


def milk_carton() -> Triangles:
    """A gable-top carton: 95 mm square, 193 mm to the eaves, 228 mm to the ridge along x, gables folded inward."""
    half, eaves, ridge = 0.0475, 0.193, 0.228
    square = np.array([[-half, -half], [half, -half], [half, half], [-half, half]])
    vertices = np.vstack(
        [
            np.insert(square, 2, 0.0, axis=1),
            np.insert(square, 2, eaves, axis=1),
            [[-half, 0, ridge], [half, 0, ridge], [-0.022, 0, eaves + 0.024], [0.022, 0, eaves + 0.024]],
        ]
    )
    walls = [face for i in range(4) for face in _quad(i, (i + 1) % 4, (i + 1) % 4 + 4, i + 4)]
    roof = [*_quad(4, 5, 9, 8), *_quad(6, 7, 8, 9)]
    gables = [(5, 6, 11), (6, 9, 11), (9, 5, 11), (7, 4, 10), (4, 8, 10), (8, 7, 10)]
    return vertices, np.array([(0, 2, 1), (0, 3, 2), *walls, *roof, *gables])


def _quad(a: int, b: int, c: int, d: int) -> list[tuple[int, int, int]]:
    return [(a, b, c), (a, c, d)]


def _revolve(
    profile: list[tuple[float, float]], angles: NDArray[np.float64], bottom: float, top: float
) -> tuple[NDArray[np.float64], dict[tuple[int, int], list[tuple[int, int, int]]]]:
    """Turn a profile of (radius, height) about z and close it on the axis.

    Returns:
        Vertices, ring by ring, and the faces of each cell by column and row; row -1 is the fan at the bottom.
    """
    steps = len(angles)
    around = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    rings = [np.column_stack([around * radius, np.full(steps, z)]) for radius, z in profile]
    vertices = np.vstack([*rings, [0, 0, bottom], [0, 0, top]])
    first, last = steps * len(profile), steps * (len(profile) - 1)
    cells: dict[tuple[int, int], list[tuple[int, int, int]]] = {}
    for i in range(steps):
        j = (i + 1) % steps
        cells[i, -1] = [(first, j, i)]
        for row in range(len(profile) - 1):
            below, above = row * steps, (row + 1) * steps
            cells[i, row] = _quad(below + i, below + j, above + j, above + i)
        cells[i, len(profile) - 1] = [(first + 1, last + i, last + j)]
    return vertices, cells


def _open3d_mesh(triangles: Triangles) -> Any:
    core = load_open3d().core
    vertices, faces = triangles
    return load_open3d().t.geometry.TriangleMesh(
        core.Tensor(np.ascontiguousarray(vertices)), core.Tensor(np.ascontiguousarray(faces))
    )


def _check(name: str, vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> None:
    legacy = _open3d_mesh((vertices, faces)).to_legacy()
    volume = legacy.get_volume() if legacy.is_watertight() else 0.0
    size = np.ptp(vertices, axis=0) * 1e3
    print(f"{name}: {len(faces)} faces, {size.round(2)} mm, {volume * 1e6:.1f} ml, closed: {legacy.is_watertight()}")
    if volume <= 0:
        raise SystemExit(f"{name} is not closed, or inside out")


def _save_stl(path: Path, vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> None:
    records = np.zeros(len(faces), STL_TRIANGLE)
    records["corners"] = vertices[faces]
    normals = np.cross(vertices[faces[:, 1]] - vertices[faces[:, 0]], vertices[faces[:, 2]] - vertices[faces[:, 0]])
    records["normal"] = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    header = f"zsight {path.stem}, metres".encode().ljust(80)
    path.write_bytes(header + np.uint32(len(faces)).tobytes() + records.tobytes())


if __name__ == "__main__":
    for make in (mug, l_bracket, milk_carton):
        vertices, faces = make()
        vertices = vertices - (vertices.min(axis=0) + vertices.max(axis=0)) / 2
        _check(make.__name__, vertices, faces)
        _save_stl(HERE / f"{make.__name__}.stl", vertices, faces)
