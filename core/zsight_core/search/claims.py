"""Which candidates can be there together: two things fill no room twice, and no pixel shows two things.

Each candidate claims the pixels in which the image shows its surface. Of those that contradict each other the set is
chosen that explains most: a large thing that would explain some of two small ones does not displace both.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from zsight_core.jit import njit
from zsight_core.render import draw, face_planes, place, region_of
from zsight_core.search.overlap import shared

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from zsight_core.solid import Solid

__all__ = ["Claim", "claimed", "consistent", "contradict", "warm_up"]

ROOM_SHARED = 0.3
"""Share of a solid that may at most lie inside of another one: poses and hulls are not exact."""

SEEN_TWICE = 0.5
"""Share of the pixels that a candidate explains from which it is not there when others explain them."""

STEP = 2
"""Every so many rows and columns of the image are looked at."""

SLACK = 0.001
"""Metres in depth, besides two standard deviations of noise, within which the surface is what a pixel shows; two thin
things that lie on each other show different surfaces."""

MOST_PIXELS = 10_000_000
"""More than any image around a solid has: all its rows and columns are wanted."""

MOST = 16
"""Candidates that contradict each other of which the best set is sought; of more, one after the other is taken."""


class Claim(NamedTuple):
    """What a candidate explains."""

    solid: Solid
    T_optical_model: NDArray[np.float64]
    """(4, 4)"""
    pixels: NDArray[np.int64]
    """(N,) numbers of the pixels that show its surface, ascending."""
    worth: float
    """Pixels that it explains, less those that speak against it, times its probability."""


def contradict(one: Claim, other: Claim) -> bool:
    """True where both cannot be there."""
    if (
        len(one.pixels)
        and len(other.pixels)
        and one.pixels[0] <= other.pixels[-1]
        and other.pixels[0] <= one.pixels[-1]
        and _both(one.pixels, other.pixels) > SEEN_TWICE * min(len(one.pixels), len(other.pixels))
    ):
        return True
    return shared(one.solid, one.T_optical_model, other.solid, other.T_optical_model) > ROOM_SHARED


def consistent(claims: Sequence[Claim]) -> list[int]:
    """Numbers of the claims that explain most without contradicting each other, ascending."""
    against: list[list[int]] = [[] for _ in claims]
    for i, claim in enumerate(claims):
        for k in range(i):
            if contradict(claim, claims[k]):
                against[i].append(k)
                against[k].append(i)
    chosen: list[int] = []
    left = set(range(len(claims)))
    while left:
        group = _group(min(left), against)
        left -= group
        chosen += _best_set(sorted(group, key=lambda k: (-claims[k].worth, k)), claims, against)
    seen = np.zeros(1 + max((int(claims[k].pixels.max(initial=0)) for k in chosen), default=0), np.int16)
    for k in chosen:
        seen[claims[k].pixels] += 1
    for k in sorted(chosen, key=lambda k: (claims[k].worth, -k)):
        pixels = claims[k].pixels
        if int((seen[pixels] > 1).sum()) > SEEN_TWICE * len(pixels):
            chosen.remove(k)
            seen[pixels] -= 1
    return sorted(chosen)


def _group(first: int, against: list[list[int]]) -> set[int]:
    """All that hang together with the first one by contradictions."""
    group, ahead = {first}, [first]
    while ahead:
        for k in against[ahead.pop()]:
            if k not in group:
                group.add(k)
                ahead.append(k)
    return group


def _best_set(group: list[int], claims: Sequence[Claim], against: list[list[int]]) -> list[int]:
    """The members, best first, of the most worth that do not contradict each other."""
    if not group:
        return []
    first, rest = group[0], group[1:]
    others = [k for k in rest if k not in against[first]]
    with_it = [first, *_best_set(others, claims, against)]
    if len(others) == len(rest) or len(group) > MOST:
        return with_it
    without = _best_set(rest, claims, against)
    worth = [sum(claims[k].worth for k in some) for some in (with_it, without)]
    return with_it if worth[0] >= worth[1] else without


@njit(cache=True, nogil=True, error_model="numpy")
def _both(a: NDArray[np.int64], b: NDArray[np.int64]) -> int:
    """Numbers that are in both, each ascending."""
    count, i, j = 0, 0, 0
    while i < len(a) and j < len(b):
        count += 1 if a[i] == b[j] else 0
        low, high = a[i], b[j]
        i += 1 if low <= high else 0
        j += 1 if high <= low else 0
    return count


@njit(cache=True, nogil=True, error_model="numpy")
def claimed(
    depth: NDArray[np.float32],
    pinhole: tuple[float, float, float, float],
    vertices: NDArray[np.float64],
    faces: NDArray[np.int32],
    T_optical_model: NDArray[np.float64],
    noise: float,
) -> NDArray[np.int64]:
    """Numbers (N,) of the pixels, of every STEP-th row and column, that show the surface of a solid.

    Args:
        depth: (H, W) metres, 0 where not measured.
        pinhole: fx, fy, cx, cy.
        vertices: (V, 3) of the solid, model frame, metres.
        faces: (F, 3).
        T_optical_model: (4, 4).
        noise: standard deviation of 1 / z, 1/m.
    """
    height, width = depth.shape
    placed = place(T_optical_model, vertices)
    u0, v0, columns, rows, step = region_of(placed, pinhole, 10_000_000)
    columns, rows = columns * step, rows * step
    left, top = max(0, u0 - u0 % STEP), max(0, v0 - v0 % STEP)
    columns, rows = (
        (min(width, u0 + columns) - left + STEP - 1) // STEP,
        (min(height, v0 + rows) - top + STEP - 1) // STEP,
    )
    if columns <= 0 or rows <= 0:
        return np.zeros(0, np.int64)
    w, _ = draw(placed, faces, face_planes(placed, faces), pinhole, (left, top, columns, rows, STEP))
    found = np.empty(rows * columns, np.int64)
    count = 0
    for r in range(rows):
        v = top + r * STEP
        for k in range(columns):
            u = left + k * STEP
            if w[r, k] > 0 and depth[v, u] > 0:
                off = 1.0 / depth[v, u] - w[r, k]
                if abs(off) < 2.0 * noise + SLACK * w[r, k] * w[r, k]:
                    found[count] = v * width + u
                    count += 1
    return found[:count]


def warm_up() -> None:
    """Compile the kernels (or load them from their cache)."""
    _both(np.zeros(1, np.int64), np.zeros(1, np.int64))
    vertices, faces = np.array([[0.0, 0.0, 1.0], [0.1, 0.0, 1.0], [0.0, 0.1, 1.0]]), np.array([[0, 2, 1]], np.int32)
    claimed(np.ones((9, 9), np.float32), (9.0, 9.0, 5.0, 5.0), vertices, faces, np.eye(4), 1e-3)
