"""A z-buffer: what a pinhole camera would see of a solid at a pose, pixel by pixel."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numba import njit

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["draw", "face_planes", "place", "region_of", "warm_up"]


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
        ux, uy, uz = vertices[b, 0] - vertices[a, 0], vertices[b, 1] - vertices[a, 1], vertices[b, 2] - vertices[a, 2]
        wx, wy, wz = vertices[c, 0] - vertices[a, 0], vertices[c, 1] - vertices[a, 1], vertices[c, 2] - vertices[a, 2]
        nx, ny, nz = uy * wz - uz * wy, uz * wx - ux * wz, ux * wy - uy * wx
        length = np.sqrt(nx * nx + ny * ny + nz * nz)
        if length < 1e-18:
            planes[f] = 0.0
            continue
        planes[f, 0], planes[f, 1], planes[f, 2] = nx / length, ny / length, nz / length
        planes[f, 3] = planes[f, 0] * vertices[a, 0] + planes[f, 1] * vertices[a, 1] + planes[f, 2] * vertices[a, 2]
    return planes


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
        u, v = fx * vertices[i, 0] / z + cx, fy * vertices[i, 1] / z + cy
        low_u, high_u, low_v, high_v = min(low_u, u), max(high_u, u), min(low_v, v), max(high_v, v)
    if max(high_u - low_u, high_v - low_v) > 4000:
        return 0, 0, 0, 0, 1
    u0, v0 = int(np.floor(low_u)), int(np.floor(low_v))
    width, height = int(np.ceil(high_u)) - u0 + 1, int(np.ceil(high_v)) - v0 + 1
    step = max(1, int(np.ceil(np.sqrt(width * height / most))))
    return u0, v0, (width + step - 1) // step, (height + step - 1) // step, step


@njit(cache=True, nogil=True, error_model="numpy")
def draw(
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
    for f in range(len(faces)):
        d = planes[f, 3]
        if d > -1e-9:
            continue
        A, B, C = planes[f, 0] / d, planes[f, 1] / d, planes[f, 2] / d
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        ua, va = fx * vertices[a, 0] / vertices[a, 2] + cx, fy * vertices[a, 1] / vertices[a, 2] + cy
        ub, vb = fx * vertices[b, 0] / vertices[b, 2] + cx, fy * vertices[b, 1] / vertices[b, 2] + cy
        uc, vc = fx * vertices[c, 0] / vertices[c, 2] + cx, fy * vertices[c, 1] / vertices[c, 2] + cy
        twice = (ub - ua) * (vc - va) - (vb - va) * (uc - ua)
        sign = 1.0 if twice > 0 else -1.0
        first = max(0, int(np.ceil((min(va, vb, vc) - v0) / step)))
        last = min(rows - 1, int(np.floor((max(va, vb, vc) - v0) / step)))
        left = max(0, int(np.ceil((min(ua, ub, uc) - u0) / step)))
        right = min(columns - 1, int(np.floor((max(ua, ub, uc) - u0) / step)))
        for r in range(first, last + 1):
            v = v0 + r * step
            for k in range(left, right + 1):
                u = u0 + k * step
                if sign * ((ub - ua) * (v - va) - (vb - va) * (u - ua)) < 0:
                    continue
                if sign * ((uc - ub) * (v - vb) - (vc - vb) * (u - ub)) < 0:
                    continue
                if sign * ((ua - uc) * (v - vc) - (va - vc) * (u - uc)) < 0:
                    continue
                inverse = A * (u - cx) / fx + B * (v - cy) / fy + C
                if inverse > w[r, k]:
                    w[r, k] = inverse
                    face[r, k] = f
    return w, face


def warm_up() -> None:
    """Compile the kernels (or load them from their cache)."""
    vertices = np.array([[0.0, 0.0, 1.0], [0.1, 0.0, 1.0], [0.0, 0.1, 1.0]])
    faces = np.array([[0, 2, 1]], np.int32)
    placed = place(np.eye(4), vertices)
    pinhole = (100.0, 100.0, 50.0, 50.0)
    draw(placed, faces, face_planes(placed, faces), pinhole, region_of(placed, pinhole, 1000))
