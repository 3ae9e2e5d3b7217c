"""The quickest look at a pose: are some points of the model's surface where the camera measured something?"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numba import njit

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["best_places", "warm_up"]

SLACK = 0.012
"""Metres in depth, besides three standard deviations of noise, within which a point is there."""

STRIDE = 2
"""Every so many points are looked at before and while climbing."""

FEWEST = 4
"""Points that must be there."""

SEEN_THROUGH = 1.0
"""Weight of a point that is seen through over one that is there."""

WORTH_A_CLIMB = 0.05
"""Least share of points that are there, less those that are seen through, before the climb."""

PEEKED = 0.35
"""The same after it."""

FIRST_STEP, FIRST_TURN = 0.005, float(np.radians(2.5))
"""Metres and radians of the first steps of a climb; the last ones are half of them."""

SAME_PLACE, SAME_TURN = 0.006, 0.12
"""Metres along each axis and radians within which two places are one."""


@njit(cache=True, nogil=True)
def best_places(  # noqa: C901  one compiled loop; splitting it would pass a dozen numbers around
    depth: NDArray[np.float32],
    pinhole: tuple[float, float, float, float],
    T_optical_support: NDArray[np.float64],
    points: NDArray[np.float64],
    normals: NDArray[np.float64],
    places: NDArray[np.float64],
    base: float,
    noise: float,
    most: int,
) -> NDArray[np.float64]:
    """The best of some places, each climbed to the best one near it, without repetitions, best first.

    Args:
        depth: (H, W) metres, 0 where not measured.
        pinhole: fx, fy, cx, cy.
        T_optical_support: (4, 4).
        points: (M, 3) of the model's surface, x and y from its origin, z from its foot, metres.
        normals: (M, 3) outward.
        places: (N, 3) x and y on the support (m) and yaw (rad).
        base: height of the model's foot over the support, metres.
        noise: standard deviation of 1 / z, 1/m.
        most: places returned at most.

    Returns:
        (K, 3) as places.
    """
    scores = np.empty(len(places))
    for i in range(len(places)):
        scores[i] = _peek(depth, pinhole, T_optical_support, points, normals, places[i], base, noise, STRIDE)
    order = np.argsort(-scores, kind="mergesort")[:most]
    kept, heights = np.empty((most, 3)), np.empty(most)
    count = 0
    for i in order:
        if scores[i] < WORTH_A_CLIMB:
            break
        place, score = places[i].copy(), scores[i]
        step = 1.0
        while step > 0.4:
            better = False
            for axis in range(3):
                for sign in (-1.0, 1.0):
                    trial = place.copy()
                    trial[axis] += sign * step * (FIRST_STEP if axis < 2 else FIRST_TURN)
                    reached = _peek(depth, pinhole, T_optical_support, points, normals, trial, base, noise, STRIDE)
                    if reached > score:
                        place, score, better = trial, reached, True
            if not better or step < 1:
                step /= 2
        if _peek(depth, pinhole, T_optical_support, points, normals, place, base, noise, 1) < PEEKED:
            continue
        again = False
        for q in range(count):
            turn = abs(kept[q, 2] - place[2]) % (2 * np.pi)
            turn = min(turn, 2 * np.pi - turn)
            if turn < SAME_TURN and abs(kept[q, 0] - place[0]) < SAME_PLACE and abs(kept[q, 1] - place[1]) < SAME_PLACE:
                again = True
        if not again:
            kept[count], heights[count] = place, score
            count += 1
    order = np.argsort(-heights[:count], kind="mergesort")
    return kept[order]


@njit(cache=True, nogil=True)
def _peek(
    depth: NDArray[np.float32],
    pinhole: tuple[float, float, float, float],
    T_optical_support: NDArray[np.float64],
    points: NDArray[np.float64],
    normals: NDArray[np.float64],
    place: NDArray[np.float64],
    base: float,
    noise: float,
    stride: int,
) -> float:
    """Share of the facing points of the model that are there, less those seen through, at a place (3,)."""
    fx, fy, cx, cy = pinhole
    height, width = depth.shape
    T = T_optical_support
    c, s = np.cos(place[2]), np.sin(place[2])
    facing, there, score = 0, 0, 0.0
    for k in range(0, len(points), stride):
        x = c * points[k, 0] - s * points[k, 1] + place[0]
        y = s * points[k, 0] + c * points[k, 1] + place[1]
        z = points[k, 2] + base
        nx, ny, nz = c * normals[k, 0] - s * normals[k, 1], s * normals[k, 0] + c * normals[k, 1], normals[k, 2]
        px = T[0, 0] * x + T[0, 1] * y + T[0, 2] * z + T[0, 3]
        py = T[1, 0] * x + T[1, 1] * y + T[1, 2] * z + T[1, 3]
        pz = T[2, 0] * x + T[2, 1] * y + T[2, 2] * z + T[2, 3]
        qx = T[0, 0] * nx + T[0, 1] * ny + T[0, 2] * nz
        qy = T[1, 0] * nx + T[1, 1] * ny + T[1, 2] * nz
        qz = T[2, 0] * nx + T[2, 1] * ny + T[2, 2] * nz
        if pz < 0.05 or qx * px + qy * py + qz * pz > -0.15 * pz:
            continue
        u, v = int(fx * px / pz + cx + 0.5), int(fy * py / pz + cy + 0.5)
        if not (0 <= u < width and 0 <= v < height) or depth[v, u] <= 0:
            continue
        facing += 1
        off = (depth[v, u] - pz) / (SLACK + 3 * noise * pz * pz)
        if abs(off) < 1:
            there += 1
            score += 1 - 0.5 * off * off
        elif off > 0:
            score -= SEEN_THROUGH
    return score / facing if there >= FEWEST else -2.0


def warm_up() -> None:
    """Compile the kernels (or load them from their cache)."""
    depth, point = np.ones((4, 4), np.float32), np.zeros((1, 3))
    best_places(depth, (1.0, 1.0, 0.0, 0.0), np.eye(4), point, point, point, 0.0, 1e-3, 1)
