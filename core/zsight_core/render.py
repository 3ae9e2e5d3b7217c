"""A z-buffer: what a pinhole camera would see of a solid at a pose, pixel by pixel."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from zsight_core.jit import njit

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["draw", "face_planes", "moved_planes", "place", "product", "region_of", "warm_up"]

ON_EDGE = 1e-7
"""Pixels beyond an edge that are still of a face, so that none is lost between two of them."""


@njit(cache=True, nogil=True, error_model="numpy")
def place(T: NDArray[np.float64], vertices: NDArray[np.float64]) -> NDArray[np.float64]:
    """Vertices (V, 3) moved by T (4, 4)."""
    moved = np.empty_like(vertices)
    for i in range(len(vertices)):
        for a in range(3):
            moved[i, a] = T[a, 0] * vertices[i, 0] + T[a, 1] * vertices[i, 1] + T[a, 2] * vertices[i, 2] + T[a, 3]
    return moved


@njit(cache=True, nogil=True, error_model="numpy")
def face_planes(vertices: NDArray[np.float64], faces: NDArray[np.int32]) -> NDArray[np.float64]:
    """(F, 4) outward unit normal n and offset d of each face, n . p = d; d < 0 where the face looks at the camera."""
    planes = np.empty((len(faces), 4))
    for f in range(len(faces)):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        x, y, z = vertices[a, 0], vertices[a, 1], vertices[a, 2]
        ux, uy, uz = vertices[b, 0] - x, vertices[b, 1] - y, vertices[b, 2] - z
        wx, wy, wz = vertices[c, 0] - x, vertices[c, 1] - y, vertices[c, 2] - z
        nx, ny, nz = uy * wz - uz * wy, uz * wx - ux * wz, ux * wy - uy * wx
        square = nx * nx + ny * ny + nz * nz
        scale = 1.0 / np.sqrt(square) if square > 1e-36 else 0.0
        planes[f, 0], planes[f, 1], planes[f, 2] = nx * scale, ny * scale, nz * scale
        planes[f, 3] = (nx * x + ny * y + nz * z) * scale
    return planes


@njit(cache=True, nogil=True, error_model="numpy")
def moved_planes(T: NDArray[np.float64], planes: NDArray[np.float64]) -> NDArray[np.float64]:
    """Planes (F, 4) of faces moved by T (4, 4); of those that look away from the origin nothing but d is told."""
    moved = np.empty_like(planes)
    x, y, z = T[0, 3], T[1, 3], T[2, 3]
    # the way from the origin to that of the faces, in the frame of the faces
    e0, e1 = T[0, 0] * x + T[1, 0] * y + T[2, 0] * z, T[0, 1] * x + T[1, 1] * y + T[2, 1] * z
    e2 = T[0, 2] * x + T[1, 2] * y + T[2, 2] * z
    for f in range(len(planes)):
        n0, n1, n2 = planes[f, 0], planes[f, 1], planes[f, 2]
        moved[f, 3] = planes[f, 3] + n0 * e0 + n1 * e1 + n2 * e2
        if moved[f, 3] < 0:
            for a in range(3):
                moved[f, a] = T[a, 0] * n0 + T[a, 1] * n1 + T[a, 2] * n2
    return moved


@njit(cache=True, nogil=True, error_model="numpy")
def product(A: NDArray[np.float64], B: NDArray[np.float64]) -> NDArray[np.float64]:
    """A B of two poses (4, 4): a library takes longer to be called."""
    T = np.empty((4, 4))
    for a in range(3):
        for b in range(4):
            T[a, b] = A[a, 0] * B[0, b] + A[a, 1] * B[1, b] + A[a, 2] * B[2, b]
        T[a, 3] += A[a, 3]
    T[3, 0], T[3, 1], T[3, 2], T[3, 3] = 0.0, 0.0, 0.0, 1.0
    return T


@njit(cache=True, nogil=True, error_model="numpy")
def region_of(
    vertices: NDArray[np.float64], pinhole: tuple[float, float, float, float], most: int
) -> tuple[int, int, int, int, int]:
    """Pixels u0, v0, columns, rows and step of a raster of about `most` pixels around the solid.

    It may reach beyond the image. Columns are 0 where a vertex lies behind the camera.
    """
    fx, fy, cx, cy = pinhole
    low_u, high_u, low_v, high_v = np.inf, -np.inf, np.inf, -np.inf
    for i in range(len(vertices)):
        z = vertices[i, 2]
        if z < 0.05:
            return 0, 0, 0, 0, 1
        w = 1.0 / z
        u, v = fx * vertices[i, 0] * w + cx, fy * vertices[i, 1] * w + cy
        low_u, high_u, low_v, high_v = min(low_u, u), max(high_u, u), min(low_v, v), max(high_v, v)
    if max(high_u - low_u, high_v - low_v) > 4000:
        return 0, 0, 0, 0, 1
    u0, v0 = int(np.floor(low_u)), int(np.floor(low_v))
    width, height = int(np.ceil(high_u)) - u0 + 1, int(np.ceil(high_v)) - v0 + 1
    step = max(1, int(np.ceil(np.sqrt(width * height / most))))
    return u0, v0, (width + step - 1) // step, (height + step - 1) // step, step


@njit(cache=True, nogil=True, error_model="numpy")
def draw(  # noqa: C901  one compiled loop over faces and pixels
    vertices: NDArray[np.float64],
    faces: NDArray[np.int32],
    planes: NDArray[np.float64],
    pinhole: tuple[float, float, float, float],
    region: tuple[int, int, int, int, int],
) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Inverse depth (rows, columns), 1/m, 0 where the solid is not, and the face seen, -1 where none."""
    fx, fy, cx, cy = pinhole
    u0, v0, columns, rows, step = region
    w = np.zeros((rows, columns))
    face = np.full((rows, columns), -1, np.int32)
    scale = 1.0 / step
    place = np.empty((len(vertices), 2))  # in columns and rows
    for i in range(len(vertices)):
        z = 1.0 / vertices[i, 2]
        place[i, 0] = (fx * vertices[i, 0] * z + cx - u0) * scale
        place[i, 1] = (fy * vertices[i, 1] * z + cy - v0) * scale
    slope, offset = np.empty(3), np.empty(3)
    for f in range(len(faces)):
        d = planes[f, 3]
        if d > -1e-9:
            continue
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        ya, yb, yc = place[a, 1], place[b, 1], place[c, 1]
        first, last = max(0, int(np.ceil(min(ya, yb, yc)))), min(rows - 1, int(np.floor(max(ya, yb, yc))))
        if first > last:
            continue
        xa, xb, xc = place[a, 0], place[b, 0], place[c, 0]
        left, right = max(0, int(np.ceil(min(xa, xb, xc)))), min(columns - 1, int(np.floor(max(xa, xb, xc))))
        if left > right:
            continue
        per_k, per_r = planes[f, 0] * step / (fx * d), planes[f, 1] * step / (fy * d)
        zero = (planes[f, 0] * (u0 - cx) / fx + planes[f, 1] * (v0 - cy) / fy + planes[f, 2]) / d
        turn = 1.0 if (xb - xa) * (yc - ya) > (yb - ya) * (xc - xa) else -1.0
        for e in range(3):
            x0, y0 = (xa, xb, xc)[e], (ya, yb, yc)[e]
            dx, dy = (xb, xc, xa)[e] - x0, (yb, yc, ya)[e] - y0
            slope[e] = dx / dy if dy != 0 else 0.0
            offset[e] = x0 - slope[e] * y0
        for r in range(first, last + 1):
            low, high = float(left), float(right)
            for e in range(3):
                dy = turn * ((yb, yc, ya)[e] - (ya, yb, yc)[e])
                at = offset[e] + slope[e] * r
                if dy > 0:
                    high = min(high, at + ON_EDGE)
                elif dy < 0:
                    low = max(low, at - ON_EDGE)
            base = zero + per_r * r
            for k in range(int(np.ceil(low)), int(np.floor(high)) + 1):
                inverse = base + per_k * k
                if inverse > w[r, k]:
                    w[r, k] = inverse
                    face[r, k] = f
    return w, face


def warm_up() -> None:
    """Compile the kernels (or load them from their cache)."""
    vertices = np.array([[0.0, 0.0, 1.0], [0.1, 0.0, 1.0], [0.0, 0.1, 1.0]])
    faces = np.array([[0, 2, 1]], np.int32)
    placed = place(product(np.eye(4), np.eye(4)), vertices)
    moved_planes(np.eye(4), face_planes(vertices, faces))
    pinhole = (100.0, 100.0, 50.0, 50.0)
    draw(placed, faces, face_planes(placed, faces), pinhole, region_of(placed, pinhole, 1000))
