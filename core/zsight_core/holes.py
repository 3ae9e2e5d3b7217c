"""Regions of a support surface where the sensor measured nothing: glass, black, shiny, or in the projector's shadow."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from zsight_core.jit import njit
from zsight_core.transform import inverse

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from zsight_core.support import Support
    from zsight_core.view import View

__all__ = ["Hole", "find_holes", "warm_up"]

SMALLEST_AREA = 0.001
"""Square metres of surface that must be missing."""

SHADOW = 0.5
"""Share of a hole's border that is of objects from which it is taken for their shadow."""


@dataclass(frozen=True, eq=False)
class Hole:
    """A region without depth: nothing may be said to be absent from it."""

    T_camera_box: NDArray[np.float64]
    """(4, 4) centre on the surface and axes of the support, in the cloud's frame."""
    size: NDArray[np.float64]
    """(2,) extents on the surface, metres."""
    area: float
    """Square metres of surface that are hidden."""
    support: int
    """Number of the surface."""
    is_shadow: bool
    """True where objects border it so much that it is likely their shadow and no thing of its own."""


def find_holes(view: View, kind: NDArray[np.uint8], supports: list[Support]) -> list[Hole]:
    """Holes in the surfaces, largest first.

    Args:
        view: depth and pinhole.
        kind: (H, W) kinds of pixels as the scene stage has them.
        supports: surfaces.
    """
    step = max(1, round(view.depth.shape[1] / 160))
    found = []
    taken = np.zeros((-(-view.depth.shape[0] // step), -(-view.depth.shape[1] // step)), np.bool_)
    for number, support in enumerate(supports):
        T_optical_support = inverse(view.T_cloud_optical) @ support.T_camera_support
        rows = _holes(
            view.depth, kind, *view.pinhole, T_optical_support, np.ascontiguousarray(support.outline), step, taken
        )
        for area, x0, y0, x1, y1, beside in rows[rows[:, 0] >= SMALLEST_AREA]:
            T = support.T_camera_support.copy()
            T[:3, 3] = (T @ [(x0 + x1) / 2, (y0 + y1) / 2, 0.0, 1.0])[:3]
            found.append(Hole(T, np.array([x1 - x0, y1 - y0]), float(area), number, bool(beside > SHADOW)))
    return sorted(found, key=lambda hole: -hole.area)


def warm_up() -> None:
    """Compile the kernels (or load them from their cache)."""
    square = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    _holes(
        np.zeros((8, 8), np.float32),
        np.zeros((8, 8), np.uint8),
        8.0,
        8.0,
        4.0,
        4.0,
        np.eye(4),
        square,
        2,
        np.zeros((4, 4), np.bool_),
    )


@njit(cache=True, nogil=True, error_model="numpy")
def _holes(  # noqa: C901  one compiled flood fill; splitting it would pass a dozen numbers around
    depth: NDArray[np.float32],
    kind: NDArray[np.uint8],
    fx: float,
    fy: float,
    cx: float,
    cy: float,
    T_optical_support: NDArray[np.float64],
    outline: NDArray[np.float64],
    step: int,
    taken: NDArray[np.bool_],
) -> NDArray[np.float64]:
    """Per hole (N, 6): area, low x y, high x y on the surface, share of its border that is of objects.

    A ray ends at the first surface: what an earlier, higher one has taken belongs to no later one.
    """
    height, width = (depth.shape[0] + step - 1) // step, (depth.shape[1] + step - 1) // step
    R, t = T_optical_support[:3, :3], T_optical_support[:3, 3]
    offset = R[0, 2] * t[0] + R[1, 2] * t[1] + R[2, 2] * t[2]
    state = np.zeros((height, width), np.int8)  # 1: a hole in the surface; 2: seen to be so
    place = np.empty((height, width, 3))
    for r in range(height):
        for c in range(width):
            if depth[r * step, c * step] > 0 or taken[r, c]:
                continue
            x, y = (c * step - cx) / fx, (r * step - cy) / fy
            slant = R[0, 2] * x + R[1, 2] * y + R[2, 2]
            if slant * offset <= 1e-9:
                continue
            z = offset / slant
            px = R[0, 0] * (x * z - t[0]) + R[1, 0] * (y * z - t[1]) + R[2, 0] * (z - t[2])
            py = R[0, 1] * (x * z - t[0]) + R[1, 1] * (y * z - t[1]) + R[2, 1] * (z - t[2])
            inside = True
            for k in range(len(outline)):
                j = (k + 1) % len(outline)
                ax, ay = outline[j, 0] - outline[k, 0], outline[j, 1] - outline[k, 1]
                if ax * (py - outline[k, 1]) - ay * (px - outline[k, 0]) < 0:
                    inside = False
                    break
            if inside:
                state[r, c] = 1
                taken[r, c] = True
                place[r, c, 0], place[r, c, 1] = px, py
                place[r, c, 2] = step * step * z * z / (fx * fy * max(abs(slant), 0.05))
    rows = np.empty((height * width, 6))  # memory that is not written costs nothing
    queue = np.empty(height * width, np.int64)
    count = 0
    for r0 in range(height):
        for c0 in range(width):
            if state[r0, c0] != 1:
                continue
            state[r0, c0] = 2
            queue[0] = r0 * width + c0
            head, tail = 0, 1
            m = rows[count]
            m[0], m[1], m[2], m[3], m[4] = 0.0, np.inf, np.inf, -np.inf, -np.inf
            border, objects = 0, 0
            while head < tail:
                r, c = queue[head] // width, queue[head] % width
                head += 1
                m[0] += place[r, c, 2]
                for a in range(2):
                    m[1 + a] = min(m[1 + a], place[r, c, a])
                    m[3 + a] = max(m[3 + a], place[r, c, a])
                for k in range(4):
                    j, i = r + (1, -1, 0, 0)[k], c + (0, 0, 1, -1)[k]
                    if not (0 <= j < height and 0 <= i < width) or state[j, i] == 2:
                        continue
                    if state[j, i] == 1:
                        state[j, i] = 2
                        queue[tail] = j * width + i
                        tail += 1
                    else:
                        border += 1
                        if kind[j * step, i * step] == 3:
                            objects += 1
            m[5] = objects / max(border, 1)
            count += 1
    return rows[:count]
