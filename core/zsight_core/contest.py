"""Which of two poses the image is for, told by just those pixels in which they would look different.

What looks the same in both says nothing of which is true, but its noise is in every score of a whole pose: a handle
is one pixel in twenty of a mug.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numba import njit

from zsight_core.render import draw, face_planes, place, region_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["TELLING", "lead", "warm_up"]

TELLING = 15.0
"""Pixels by which a pose must lead to be told from another one; about twice what shares one error."""

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
) -> float:
    """Pixels by which one pose explains more than another, those looked through counted twice against it.

    Args:
        depth: (H, W) metres, 0 where not measured.
        pinhole: fx, fy, cx, cy.
        vertices: (V, 3) of the solid, model frame, metres.
        faces: (F, 3).
        T_one: (4, 4) T_optical_model.
        T_other: (4, 4).
        noise: standard deviation of 1 / z, 1/m.
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
            if a == b or u < 0 or u >= width or depth[v, u] <= 0:
                continue
            w = 1.0 / depth[v, u]
            gate = 3.0 * noise + SLACK * w * w
            if abs(a - b) > gate:
                total += _says(w, a, gate) - _says(w, b, gate)
    return float(total * step * step)


@njit(cache=True, nogil=True, error_model="numpy")
def _says(w: float, drawn: float, gate: float) -> int:
    """What a measured inverse depth says of a drawn one: 1 it is there, -2 it is looked through, 0 nothing."""
    if drawn == 0 or w > drawn + gate:
        return 0
    return 1 if w >= drawn - gate else -2


def warm_up() -> None:
    """Compile the kernel (or load it from its cache)."""
    vertices, faces = np.array([[0.0, 0.0, 1.0], [0.1, 0.0, 1.0], [0.0, 0.1, 1.0]]), np.array([[0, 2, 1]], np.int32)
    lead(np.ones((9, 9), np.float32), (9.0, 9.0, 5.0, 5.0), vertices, faces, np.eye(4), np.eye(4), 1e-3)
