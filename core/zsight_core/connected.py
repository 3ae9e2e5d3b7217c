"""The part of a surface that hangs together with a patch."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from zsight_core.errors import GeometryError, PointsError
from zsight_core.jit import njit
from zsight_core.points import is_organised
from zsight_core.words import words_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from zsight_core.points import Points
    from zsight_core.words import Layout

__all__ = ["connected_to", "warm_up"]


def connected_to(
    points: Points, member: NDArray[np.bool_], patch: NDArray[np.bool_], gap: float = 0.03
) -> NDArray[np.bool_]:
    """The members that are reached from the patch in steps of at most `gap` metres from member to member.

    In an organised cloud a step leads to one of the 24 pixels around (so it crosses one-pixel holes); else to any
    member within the gap.

    Args:
        points: (H, W), metres.
        member: (H, W) points that may be reached, for instance the inliers of a plane.
        patch: (H, W) where to begin; points of it that are not members are passed over.
        gap: longest step, metres.

    Returns:
        Mask (H, W), a subset of `member`.

    Raises:
        PointsError: the masks do not fit the cloud.
        GeometryError: gap is not above zero.
    """
    for mask in (member, patch):
        if mask.shape != points.shape or mask.dtype != np.bool_:
            raise PointsError(f"mask has shape {mask.shape} and type {mask.dtype}; expected {points.shape} and bool")
    if not (math.isfinite(gap) and gap > 0):
        raise GeometryError(f"gap is {gap} m; expected a length above zero")
    if points.size == 0:
        return member.copy()
    cloud = words_of(points)
    free = np.ascontiguousarray(member).reshape(-1).copy()
    seeds = np.flatnonzero(np.ascontiguousarray(patch).reshape(-1))
    if is_organised(points):
        return _flood_image(cloud.words, cloud.layout, points.shape[1], free, seeds, gap).reshape(points.shape)
    return _flood_space(cloud.words, cloud.layout, free, seeds, gap).reshape(points.shape)


@njit(cache=True, nogil=True)
def _flood_image(
    words: NDArray[np.float32],
    layout: Layout,
    width: int,
    free: NDArray[np.bool_],
    seeds: NDArray[np.int64],
    gap: float,
) -> NDArray[np.bool_]:
    """Flood fill over the image; `free` is used up."""
    height = len(free) // width
    reached = np.zeros(len(free), np.bool_)
    stack = np.empty(len(free), np.int64)
    limit = gap * gap
    top = 0
    for seed in seeds:
        if free[seed]:
            free[seed] = False
            stack[top] = seed
            top += 1
    while top > 0:
        top -= 1
        here = stack[top]
        reached[here] = True
        v, u = here // width, here % width
        for dv in range(-2, 3):
            for du in range(-2, 3):
                if 0 <= v + dv < height and 0 <= u + du < width:
                    there = here + dv * width + du
                    if free[there] and _square(words, layout, here, there) <= limit:
                        free[there] = False
                        stack[top] = there
                        top += 1
    return reached


@njit(cache=True, nogil=True)
def _square(words: NDArray[np.float32], layout: Layout, here: int, there: int) -> float:
    """Squared distance of two points; NaN where one is a hole."""
    step, at_x, at_y, at_z = layout
    dx = float(words[step * here + at_x]) - float(words[step * there + at_x])
    dy = float(words[step * here + at_y]) - float(words[step * there + at_y])
    dz = float(words[step * here + at_z]) - float(words[step * there + at_z])
    return dx * dx + dy * dy + dz * dz


@njit(cache=True, nogil=True)
def _flood_space(
    words: NDArray[np.float32], layout: Layout, free: NDArray[np.bool_], seeds: NDArray[np.int64], gap: float
) -> NDArray[np.bool_]:
    """Flood fill over a grid of cells as wide as the gap: a step leads into one of the 27 cells around."""
    step, at_x, at_y, at_z = layout
    reached = np.zeros(len(free), np.bool_)
    size = 1024
    while size < len(free):
        size *= 2
    head = np.full(size, -1, np.int64)
    following = np.full(len(free), -1, np.int64)
    inverse = 1.0 / gap
    for i in range(len(free)):
        base = step * i
        if free[i]:
            place = _cell(words, base + at_x, base + at_y, base + at_z, inverse, 0, 0, 0) & (size - 1)
            following[i] = head[place]
            head[place] = i
    stack = np.empty(len(free), np.int64)
    limit = gap * gap
    top = 0
    for seed in seeds:
        if free[seed]:
            free[seed] = False
            stack[top] = seed
            top += 1
    while top > 0:
        top -= 1
        here = stack[top]
        reached[here] = True
        base = step * here
        for near in range(27):
            dx, dy, dz = near % 3 - 1, near // 3 % 3 - 1, near // 9 - 1
            place = _cell(words, base + at_x, base + at_y, base + at_z, inverse, dx, dy, dz) & (size - 1)
            before = -1
            there = head[place]
            while there >= 0:
                after = following[there]
                if not free[there]:  # reached before: out of the list, so that it is not looked at again
                    if before < 0:
                        head[place] = after
                    else:
                        following[before] = after
                else:
                    if _square(words, layout, here, there) <= limit:
                        free[there] = False
                        stack[top] = there
                        top += 1
                    before = there
                there = after
    return reached


@njit(cache=True, nogil=True)
def _cell(
    words: NDArray[np.float32], at_x: int, at_y: int, at_z: int, inverse: float, dx: int, dy: int, dz: int
) -> int:
    """Hash of the cell that lies dx, dy, dz cells from the cell of a point."""
    x = math.floor(words[at_x] * inverse) + dx
    y = math.floor(words[at_y] * inverse) + dy
    z = math.floor(words[at_z] * inverse) + dz
    mixed: int = (x * 73856093) ^ (y * 19349669) ^ (z * 83492791)
    return mixed ^ (mixed >> 17)


def warm_up() -> None:
    """Compile the kernels of this file."""
    points = words_of(np.zeros((3, 3, 3), np.float32))
    seeds = np.zeros(1, np.int64)
    _flood_image(points.words, points.layout, 3, np.ones(9, np.bool_), seeds, 0.1)
    _flood_space(points.words, points.layout, np.ones(9, np.bool_), seeds, 0.1)
