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
"""Points that must be there; of every so many accordingly fewer, for a can seen from above shows little but its top."""

SEEN_THROUGH = 1.0
"""Weight of a point that is seen through over one that is there."""

HIDDEN = 0.5
"""Weight of a point that something nearer hides, be it another thing or the model itself."""

WORTH_A_CLIMB = 0.2
"""Least share of points that are there, less those that are seen through, before the climb."""

PEEKED = 0.4
"""The same after it."""

STEP, TURN = 0.005, float(np.radians(2.5))
"""Metres and radians of the steps of a climb; the first ones are twice as long, the last ones half."""

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
    every, some = samples.T.copy(), samples[::STRIDE].T.copy()
    image, shape, T = depth.reshape(-1), depth.shape, T_optical_support
    pixels = np.empty(len(samples), np.int32)
    scores = np.empty(len(places))
    for i in range(len(places)):
        x, y, yaw = places[i, 0], places[i, 1], places[i, 2]
        scores[i] = _peek(image, shape, pinhole, T, some, x, y, base, yaw, noise, pixels, FEWEST // STRIDE)
    order = np.argsort(-scores, kind="mergesort")[:most]
    kept, heights = np.empty((most, 3)), np.empty(most)
    count = 0
    for i in order:
        if scores[i] < WORTH_A_CLIMB:
            break
        x, y, yaw, score = _climb(image, shape, pinhole, T, some, places[i], scores[i], base, noise, pixels, axes)
        if _peek(image, shape, pinhole, T, every, x, y, base, yaw, noise, pixels, FEWEST) < PEEKED:
            continue
        again = False
        for q in range(count):
            turn = abs(kept[q, 2] - yaw) % full
            turn = min(turn, full - turn)
            if turn < SAME_TURN and abs(kept[q, 0] - x) < SAME_PLACE and abs(kept[q, 1] - y) < SAME_PLACE:
                again = True
        if not again:
            kept[count, 0], kept[count, 1], kept[count, 2], heights[count] = x, y, yaw, score
            count += 1
    order = np.argsort(-heights[:count], kind="mergesort")
    return kept[order]


@njit(cache=True, nogil=True, error_model="numpy")
def _climb(
    image: NDArray[np.float32],
    shape: tuple[int, int],
    pinhole: tuple[float, float, float, float],
    T_optical_support: NDArray[np.float64],
    samples: NDArray[np.float64],
    start: NDArray[np.float64],
    score: float,
    base: float,
    noise: float,
    pixels: NDArray[np.int32],
    axes: int,
) -> tuple[float, float, float, float]:
    """Where steps along one axis at a time lead from a place (3,): x, y, yaw, and the score there."""
    x, y, yaw = start[0], start[1], start[2]
    step = 2.0
    while step > 0.4:
        better = False
        for axis in range(axes):
            for sign in (-1.0, 1.0):
                along, turn = sign * step * STEP, 0.0
                if axis == 0:  # the model's own axes: a ridge of the scores of a long thing lies along one of them
                    dx, dy = along * np.cos(yaw), along * np.sin(yaw)
                elif axis == 1:
                    dx, dy = -along * np.sin(yaw), along * np.cos(yaw)
                else:
                    dx, dy, turn = 0.0, 0.0, sign * step * TURN
                there = x + dx, y + dy, base, yaw + turn
                reached = _peek(
                    image, shape, pinhole, T_optical_support, samples, *there, noise, pixels, FEWEST // STRIDE
                )
                if reached > score:
                    x, y, yaw, score, better = x + dx, y + dy, yaw + turn, reached, True
                    break  # the other way leads back
        if not better or step != 1:
            step /= 2
    return x, y, yaw, score


@njit(cache=True, nogil=True, error_model="numpy")
def _peek(
    image: NDArray[np.float32],
    shape: tuple[int, int],
    pinhole: tuple[float, float, float, float],
    T_optical_support: NDArray[np.float64],
    samples: NDArray[np.float64],
    x: float,
    y: float,
    z: float,
    yaw: float,
    noise: float,
    pixels: NDArray[np.int32],
    fewest: int,
) -> float:
    """Share of the facing points of the model that are there, less those seen through, at a place and height.

    Args:
        image: depth, flat.
        shape: rows and columns of the image.
        pinhole: fx, fy, cx, cy.
        T_optical_support: (4, 4).
        samples: (7, M) as of best_places, one in a column.
        x: place on the support, metres.
        y: likewise.
        z: height over the support, metres.
        yaw: radians.
        noise: standard deviation of 1 / z, 1/m.
        pixels: (M,) room for the pixel of each sample.
        fewest: points that must be there.
    """
    fx, fy, cx, cy = pinhole
    height, width = shape
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
    columns, nowhere = np.int32(width), np.int32(-1)
    for k in range(samples.shape[1]):  # nothing but sums here: the compiler does several points at a time
        pz = r20 * samples[0, k] + r21 * samples[1, k] + r22 * samples[2, k] + t2
        w = 1.0 / pz
        u = fx * (r00 * samples[0, k] + r01 * samples[1, k] + r02 * samples[2, k] + t0) * w + (cx + 0.5)
        v = fy * (r10 * samples[0, k] + r11 * samples[1, k] + r12 * samples[2, k] + t1) * w + (cy + 0.5)
        faces = samples[6, k] + samples[3, k] * e0 + samples[4, k] * e1 + samples[5, k] * e2 <= -0.15 * pz
        seen = faces & (pz >= 0.05) & (u >= 0.0) & (v >= 0.0) & (u < width) & (v < height)
        pixels[k] = np.int32(v) * columns + np.int32(u) if seen else nowhere
    facing, there, score = 0.0, 0, 0.0
    for k in range(samples.shape[1]):
        if pixels[k] < 0 or image[pixels[k]] <= 0:
            continue
        pz = r20 * samples[0, k] + r21 * samples[1, k] + r22 * samples[2, k] + t2
        off = (image[pixels[k]] - pz) / (SLACK + 3 * noise * pz * pz)
        facing += HIDDEN if off <= -1 else 1.0
        if abs(off) < 1:
            there += 1
            score += 1 - 0.5 * off * off
        elif off > 0:
            score -= SEEN_THROUGH
    return score / facing if there >= fewest else -2.0


def warm_up() -> None:
    """Compile the kernels (or load them from their cache)."""
    depth, samples, places = np.ones((4, 4), np.float32), np.zeros((1, 7)), np.zeros((1, 3))
    best_places(depth, (1.0, 1.0, 0.0, 0.0), np.eye(4), samples, places, 1.0, 0.0, 1e-3, 1, 3)
