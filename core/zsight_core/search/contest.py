"""Which of two poses the image is for, told by just those pixels in which they would look different.

What looks the same in both says nothing of which is true, but its noise is in every score of a whole pose: a handle
is one pixel in twenty of a mug.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from zsight_core.jit import njit
from zsight_core.render import draw, face_planes, place, region_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["NOBODY", "TELLING", "lead", "mark", "warm_up"]

TELLING = 15.0
"""Pixels by which a pose must lead to be told from another one; about twice what shares one error."""

NOBODY, SEVERAL = -1, -2
"""What ``mark`` leaves where no solid explains a pixel, and where more than one do."""

PIXELS = 6000
"""Pixels that are looked at at most."""

SLACK = 0.004
"""Metres in depth, besides three standard deviations of noise, that two surfaces must be apart to look different."""


@njit(cache=True, nogil=True, error_model="numpy")
def lead(
    depth: NDArray[np.float32],
    pinhole: tuple[float, float, float, float],
    vertices: NDArray[np.float64],
    faces: NDArray[np.int32],
    T_one: NDArray[np.float64],
    T_other: NDArray[np.float64],
    noise: float,
    owners: NDArray[np.int16],
    own: int,
) -> float:
    """Pixels by which one pose explains more than another, less those that are looked through.

    What another solid explains says nothing: a handle may be thought where a neighbour happens to be.

    Args:
        depth: (H, W) metres, 0 where not measured.
        pinhole: fx, fy, cx, cy.
        vertices: (V, 3) of the solid, model frame, metres.
        faces: (F, 3).
        T_one: (4, 4) T_optical_model.
        T_other: (4, 4).
        noise: standard deviation of 1 / z, 1/m.
        owners: (H, W) numbers of the solids that explain pixels, as of ``mark``.
        own: number of this one.
    """
    height, width = depth.shape
    one, other = place(T_one, vertices), place(T_other, vertices)
    region = region_of(np.concatenate((one, other)), pinhole, PIXELS)
    u0, v0, columns, rows, step = region
    if columns == 0:
        return 0.0
    w_one, _ = draw(one, faces, face_planes(one, faces), pinhole, region)
    w_other, _ = draw(other, faces, face_planes(other, faces), pinhole, region)
    total = 0
    for r in range(rows):
        v = v0 + r * step
        if v < 0 or v >= height:
            continue
        for k in range(columns):
            u = u0 + k * step
            a, b = w_one[r, k], w_other[r, k]
            if a == b or u < 0 or u >= width or depth[v, u] <= 0 or owners[v, u] not in (NOBODY, own):
                continue
            w = 1.0 / depth[v, u]
            gate = 3.0 * noise + SLACK * w * w
            if abs(a - b) > gate:
                total += _says(w, a, gate) - _says(w, b, gate)
    return float(total * step * step)


@njit(cache=True, nogil=True, error_model="numpy")
def _says(w: float, drawn: float, gate: float) -> int:
    """What a measured inverse depth says of a drawn one: 1 it is there, -1 it is looked through, 0 nothing."""
    if drawn == 0 or w > drawn + gate:
        return 0
    return 1 if w >= drawn - gate else -1


@njit(cache=True, nogil=True, error_model="numpy")
def mark(
    depth: NDArray[np.float32],
    pinhole: tuple[float, float, float, float],
    vertices: NDArray[np.float64],
    faces: NDArray[np.int32],
    T_optical_model: NDArray[np.float64],
    noise: float,
    number: int,
    owners: NDArray[np.int16],
) -> None:
    """Write a solid's number where the image shows its surface, or SEVERAL where another one's stood already.

    Args:
        depth: (H, W) metres, 0 where not measured.
        pinhole: fx, fy, cx, cy.
        vertices: (V, 3) of the solid, model frame, metres.
        faces: (F, 3).
        T_optical_model: (4, 4).
        noise: standard deviation of 1 / z, 1/m.
        number: of the solid, 0 or more.
        owners: (H, W) numbers of those that were marked before, NOBODY elsewhere; changed in place.
    """
    height, width = depth.shape
    placed = place(T_optical_model, vertices)
    u0, v0, columns, rows, step = region_of(placed, pinhole, width * height)
    left, top = max(0, u0), max(0, v0)
    columns, rows = min(width, u0 + columns * step) - left, min(height, v0 + rows * step) - top
    if columns <= 0 or rows <= 0:
        return
    drawn, _ = draw(placed, faces, face_planes(placed, faces), pinhole, (left, top, columns, rows, 1))
    for r in range(rows):
        for k in range(columns):
            u, v = left + k, top + r
            if drawn[r, k] == 0 or depth[v, u] <= 0:
                continue
            w = 1.0 / depth[v, u]
            if abs(w - drawn[r, k]) <= 3.0 * noise + SLACK * w * w:
                owners[v, u] = number if owners[v, u] == NOBODY else SEVERAL


def warm_up() -> None:
    """Compile the kernels (or load them from their cache)."""
    vertices, faces = np.array([[0.0, 0.0, 1.0], [0.1, 0.0, 1.0], [0.0, 0.1, 1.0]]), np.array([[0, 2, 1]], np.int32)
    image = np.ones((9, 9), np.float32), (9.0, 9.0, 5.0, 5.0), vertices, faces
    owners = np.full((9, 9), NOBODY, np.int16)
    lead(*image, np.eye(4), np.eye(4), 1e-3, owners, 0)
    mark(*image, np.eye(4), 1e-3, 0, owners)
