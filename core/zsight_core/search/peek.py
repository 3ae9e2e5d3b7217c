"""The quickest look at a pose: are some points of the model's surface where the camera measured something?"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from zsight_core.jit import njit

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

GRAZING = -0.15
"""Cosine, of the way to a point and its normal, above which the point does not face the camera."""

NEAREST = 0.05
"""Metres in depth."""

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
    samples: NDArray[np.float32],
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
        samples: (7, M) points of the model's surface, one in a column, x and y from its origin, z from its foot,
            metres; outward normals; and the products of both.
        places: (N, 3) x and y on the support (m) and yaw (rad).
        full: turn about the vertical after which the model looks as before, rad.
        base: height of the model's foot over the support, metres.
        noise: standard deviation of 1 / z, 1/m.
        most: places returned at most.
        axes: 3; or 2 to leave yaws as they are.

    Returns:
        (K, 3) as places.
    """
    some = samples[:, ::STRIDE].copy()
    image, shape, T = depth.reshape(-1), depth.shape, T_optical_support
    scores, worth = np.empty(len(places)), np.empty(len(places), np.int64)
    count = 0
    for i in range(len(places)):
        x, y, yaw = places[i, 0], places[i, 1], places[i, 2]
        scores[count] = _peek(image, shape, pinhole, T, some, x, y, base, yaw, noise, FEWEST // STRIDE)
        worth[count] = i
        count += 1 if scores[count] >= WORTH_A_CLIMB else 0
    order = np.argsort(-scores[:count], kind="mergesort")[:most]
    kept, heights = np.empty((len(order), 3)), np.empty(len(order))
    count = 0
    for i in order:
        x, y, yaw, score = _climb(image, shape, pinhole, T, some, places[worth[i]], scores[i], base, noise, axes)
        if _peek(image, shape, pinhole, T, samples, x, y, base, yaw, noise, FEWEST) < PEEKED:
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
    samples: NDArray[np.float32],
    start: NDArray[np.float64],
    score: float,
    base: float,
    noise: float,
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
                reached = _peek(image, shape, pinhole, T_optical_support, samples, *there, noise, FEWEST // STRIDE)
                if reached > score:
                    x, y, yaw, score, better = x + dx, y + dy, yaw + turn, reached, True
                    break  # the other way leads back
        if not better or step != 1:
            step /= 2
    return x, y, yaw, score


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"reassoc", "nsz", "contract"})  # sums in any order
def _peek(
    image: NDArray[np.float32],
    shape: tuple[int, int],
    pinhole: tuple[float, float, float, float],
    T_optical_support: NDArray[np.float64],
    samples: NDArray[np.float32],
    x: float,
    y: float,
    z: float,
    yaw: float,
    noise: float,
    fewest: int,
) -> float:
    """Share of the facing points of the model that are there, less those seen through, at a place and height.

    One loop without a way out of it, in single precision: the compiler does eight points at a time.

    Args:
        image: depth, flat.
        shape: rows and columns of the image.
        pinhole: fx, fy, cx, cy.
        T_optical_support: (4, 4).
        samples: (7, M) as of best_places.
        x: place on the support, metres.
        y: likewise.
        z: height over the support, metres.
        yaw: radians.
        noise: standard deviation of 1 / z, 1/m.
        fewest: points that must be there.
    """
    single = np.float32
    fx, fy, cx, cy = pinhole
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
    e0, e1 = single(r00 * t0 + r10 * t1 + r20 * t2), single(r01 * t0 + r11 * t1 + r21 * t2)
    e2 = single(r02 * t0 + r12 * t1 + r22 * t2)
    # to columns, rows and depth, the first two times depth
    u0, u1, u2, u3 = single(fx * r00), single(fx * r01), single(fx * r02), single(fx * t0)
    v0, v1, v2, v3 = single(fy * r10), single(fy * r11), single(fy * r12), single(fy * t1)
    d0, d1, d2, d3 = single(r20), single(r21), single(r22), single(t2)
    left, top, width, height = single(cx + 0.5), single(cy + 0.5), single(shape[1]), single(shape[0])
    slack, spread, columns = single(SLACK), single(3 * noise), np.int32(shape[1])
    nothing, one, half = single(0), single(1), single(0.5)
    hidden, through, grazing, nearest = single(HIDDEN), single(SEEN_THROUGH), single(GRAZING), single(NEAREST)
    facing, there, score = nothing, nothing, nothing
    for k in range(samples.shape[1]):
        px, py, ph = samples[0, k], samples[1, k], samples[2, k]
        pz = d0 * px + d1 * py + d2 * ph + d3
        w = one / pz
        u = (u0 * px + u1 * py + u2 * ph + u3) * w + left
        v = (v0 * px + v1 * py + v2 * ph + v3) * w + top
        away = samples[6, k] + samples[3, k] * e0 + samples[4, k] * e1 + samples[5, k] * e2
        inside = (u >= nothing) & (v >= nothing) & (u < width) & (v < height)
        seen = inside & (away <= grazing * pz) & (pz >= nearest)
        measured = image[np.uint32(np.int32(v) * columns + np.int32(u) if seen else np.int32(0))]
        seen = seen & (measured > nothing)
        off = (measured - pz) / (slack + spread * pz * pz)
        on = seen & (abs(off) < one)
        facing += (hidden if off <= -one else one) if seen else nothing
        there += one if on else nothing
        score += (one - half * off * off) if on else (-through if seen & (off > nothing) else nothing)
    return float(score / facing) if there >= fewest else -2.0


def warm_up() -> None:
    """Compile the kernels (or load them from their cache)."""
    depth, samples, places = np.ones((4, 4), np.float32), np.zeros((7, 1), np.float32), np.zeros((1, 3))
    best_places(depth, (1.0, 1.0, 0.0, 0.0), np.eye(4), samples, places, 1.0, 0.0, 1e-3, 1, 3)
