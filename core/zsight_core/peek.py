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

HIDDEN = 0.5
"""Weight of a point that something nearer hides, be it another thing or the model itself."""

WORTH_A_CLIMB = 0.2
"""Least share of points that are there, less those that are seen through, before the climb."""

PEEKED = 0.4
"""The same after it."""

FIRST_STEP, FIRST_TURN = 0.005, float(np.radians(2.5))
"""Metres and radians of the first steps of a climb; the last ones are half of them."""

SAME_PLACE, SAME_TURN = 0.006, 0.12
"""Metres along each axis and radians within which two places are one."""


@njit(cache=True, nogil=True, error_model="numpy")
def best_places(
    depth: NDArray[np.float32],
    pinhole: tuple[float, float, float, float],
    T_optical_support: NDArray[np.float64],
    samples: NDArray[np.float64],
    places: NDArray[np.float64],
    full: float,
    base: float,
    noise: float,
    most: int,
    axes: int,
) -> NDArray[np.float64]:
    """The best of some places, each climbed to the best one near it, without repetitions, best first.

    Args:
        depth: (H, W) metres, 0 where not measured.
        pinhole: fx, fy, cx, cy.
        T_optical_support: (4, 4).
        samples: (M, 7) points of the model's surface, x and y from its origin, z from its foot, metres; outward
            normals; and the products of both.
        places: (N, 3) x and y on the support (m) and yaw (rad).
        full: turn about the vertical after which the model looks as before, rad.
        base: height of the model's foot over the support, metres.
        noise: standard deviation of 1 / z, 1/m.
        most: places returned at most.
        axes: 3; or 2 to leave yaws as they are.

    Returns:
        (K, 3) as places.
    """
    some = samples[::STRIDE].copy()
    scores = np.empty(len(places))
    for i in range(len(places)):
        x, y, yaw = places[i, 0], places[i, 1], places[i, 2]
        scores[i] = _peek(depth, pinhole, T_optical_support, some, x, y, base, yaw, noise)
    order = np.argsort(-scores, kind="mergesort")[:most]
    kept, heights = np.empty((most, 3)), np.empty(most)
    count = 0
    for i in order:
        if scores[i] < WORTH_A_CLIMB:
            break
        place, score = _climb(depth, pinhole, T_optical_support, some, places[i], scores[i], base, noise, axes)
        x, y, yaw = place[0], place[1], place[2]
        if _peek(depth, pinhole, T_optical_support, samples, x, y, base, yaw, noise) < PEEKED:
            continue
        again = False
        for q in range(count):
            turn = abs(kept[q, 2] - yaw) % full
            turn = min(turn, full - turn)
            if turn < SAME_TURN and abs(kept[q, 0] - x) < SAME_PLACE and abs(kept[q, 1] - y) < SAME_PLACE:
                again = True
        if not again:
            kept[count], heights[count] = place, score
            count += 1
    order = np.argsort(-heights[:count], kind="mergesort")
    return kept[order]


@njit(cache=True, nogil=True, error_model="numpy")
def _climb(
    depth: NDArray[np.float32],
    pinhole: tuple[float, float, float, float],
    T_optical_support: NDArray[np.float64],
    samples: NDArray[np.float64],
    start: NDArray[np.float64],
    score: float,
    base: float,
    noise: float,
    axes: int,
) -> tuple[NDArray[np.float64], float]:
    """The best place (3,) that steps along one axis at a time lead to, and its score."""
    place = start.copy()
    step = 1.0
    while step > 0.4:
        better = False
        for axis in range(axes):
            length = step * (FIRST_STEP if axis < 2 else FIRST_TURN)
            here = place[axis]
            for sign in (-1.0, 1.0):
                place[axis] = here + sign * length
                x, y, yaw = place[0], place[1], place[2]
                reached = _peek(depth, pinhole, T_optical_support, samples, x, y, base, yaw, noise)
                if reached > score:
                    score, better = reached, True
                    break  # the other way leads back
                place[axis] = here
        if not better or step < 1:
            step /= 2
    return place, score


@njit(cache=True, nogil=True, error_model="numpy")
def _peek(
    depth: NDArray[np.float32],
    pinhole: tuple[float, float, float, float],
    T_optical_support: NDArray[np.float64],
    samples: NDArray[np.float64],
    x: float,
    y: float,
    z: float,
    yaw: float,
    noise: float,
) -> float:
    """Share of the facing points of the model that are there, less those seen through, at a place and height."""
    fx, fy, cx, cy = pinhole
    height, width = depth.shape
    T = T_optical_support
    c, s = np.cos(yaw), np.sin(yaw)
    # from the model, turned by yaw and shifted, to the camera
    r00, r01, r02 = T[0, 0] * c + T[0, 1] * s, T[0, 1] * c - T[0, 0] * s, T[0, 2]
    r10, r11, r12 = T[1, 0] * c + T[1, 1] * s, T[1, 1] * c - T[1, 0] * s, T[1, 2]
    r20, r21, r22 = T[2, 0] * c + T[2, 1] * s, T[2, 1] * c - T[2, 0] * s, T[2, 2]
    t0 = T[0, 0] * x + T[0, 1] * y + T[0, 2] * z + T[0, 3]
    t1 = T[1, 0] * x + T[1, 1] * y + T[1, 2] * z + T[1, 3]
    t2 = T[2, 0] * x + T[2, 1] * y + T[2, 2] * z + T[2, 3]
    # the way from the camera to the model's origin, in the model's frame
    e0, e1, e2 = r00 * t0 + r10 * t1 + r20 * t2, r01 * t0 + r11 * t1 + r21 * t2, r02 * t0 + r12 * t1 + r22 * t2
    facing, there, score = 0.0, 0, 0.0
    for k in range(len(samples)):
        b = samples[k]
        pz = r20 * b[0] + r21 * b[1] + r22 * b[2] + t2
        if pz < 0.05 or b[6] + b[3] * e0 + b[4] * e1 + b[5] * e2 > -0.15 * pz:
            continue
        w = 1.0 / pz
        u = int(fx * (r00 * b[0] + r01 * b[1] + r02 * b[2] + t0) * w + cx + 0.5)
        v = int(fy * (r10 * b[0] + r11 * b[1] + r12 * b[2] + t1) * w + cy + 0.5)
        if not (0 <= u < width and 0 <= v < height):
            continue
        measured = depth[v, u]
        if measured <= 0:
            continue
        off = (measured - pz) / (SLACK + 3 * noise * pz * pz)
        facing += HIDDEN if off <= -1 else 1.0
        if abs(off) < 1:
            there += 1
            score += 1 - 0.5 * off * off
        elif off > 0:
            score -= SEEN_THROUGH
    return score / facing if there >= FEWEST else -2.0


def warm_up() -> None:
    """Compile the kernels (or load them from their cache)."""
    depth, samples, places = np.ones((4, 4), np.float32), np.zeros((1, 7)), np.zeros((1, 3))
    best_places(depth, (1.0, 1.0, 0.0, 0.0), np.eye(4), samples, places, 1.0, 0.0, 1e-3, 1, 3)
