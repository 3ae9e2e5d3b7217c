"""How much of one solid lies inside of another one: two solid things cannot be at one place."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from zsight_core.jit import njit
from zsight_core.transform import inverse

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from zsight_core.solid import Solid

__all__ = ["hull_area", "radius", "shared", "warm_up"]

FLAT = 1e-9
"""Metres by which a corner may be outside of a side of a solid that is its own hull."""

GRID = 6
"""Points along each side of the box around a solid at which its inside is sampled."""


class _Hull(NamedTuple):
    sides: NDArray[np.float64]
    """(F, 4) outward normal and offset of each side."""
    inside: NDArray[np.float64]
    """(N, 3) points inside, metres, model frame."""
    radius: float
    """Metres from the origin to the farthest vertex."""
    area: float
    """Square metres."""


def shared(a: Solid, T_a: NDArray[np.float64], b: Solid, T_b: NDArray[np.float64]) -> float:
    """Share (0..1) of the convex hull of one solid that lies in that of the other, of the smaller one.

    Args:
        a: one solid.
        T_a: (4, 4) its pose in any frame.
        b: the other solid.
        T_b: (4, 4) its pose in the same frame.
    """
    hull_a, hull_b = (_hull(solid) for solid in (a, b))
    gap = T_a[:3, 3] - T_b[:3, 3]
    if gap @ gap > (hull_a.radius + hull_b.radius) ** 2:
        return 0.0
    T_b_a = inverse(T_b) @ T_a
    return max(
        _share_inside(hull_a.inside, hull_b.sides, T_b_a), _share_inside(hull_b.inside, hull_a.sides, inverse(T_b_a))
    )


def hull_area(solid: Solid) -> float:
    """Square metres of the convex hull's surface; seen from anywhere it covers at most half of that."""
    return _hull(solid).area


def radius(solid: Solid) -> float:
    """Metres from the origin to the farthest vertex."""
    return _hull(solid).radius


@njit(cache=True, nogil=True, error_model="numpy")
def _share_inside(points: NDArray[np.float64], sides: NDArray[np.float64], T: NDArray[np.float64]) -> float:
    """Share of points (N, 3), moved by T (4, 4), that are inside of all sides (F, 4)."""
    inside = 0
    for i in range(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        px = T[0, 0] * x + T[0, 1] * y + T[0, 2] * z + T[0, 3]
        py = T[1, 0] * x + T[1, 1] * y + T[1, 2] * z + T[1, 3]
        pz = T[2, 0] * x + T[2, 1] * y + T[2, 2] * z + T[2, 3]
        out = False
        for f in range(len(sides)):
            if sides[f, 0] * px + sides[f, 1] * py + sides[f, 2] * pz + sides[f, 3] > 0:
                out = True
                break
        inside += 0 if out else 1
    return inside / max(len(points), 1)


def warm_up() -> None:
    """Compile the kernel (or load it from its cache)."""
    _share_inside(np.zeros((1, 3)), np.zeros((1, 4)), np.eye(4))


@lru_cache(maxsize=64)
def _hull(solid: Solid) -> _Hull:
    corners = solid.vertices
    sides, area = _own_sides(solid)
    if (corners @ sides[:, :3].T + sides[:, 3]).max() > FLAT:
        from scipy.spatial import ConvexHull  # takes a fifth of a second to import, and most solids are convex

        hull = ConvexHull(corners)
        sides, area = hull.equations, float(hull.area)
    sides = np.unique(sides.round(9), axis=0)
    low, high = corners.min(axis=0), corners.max(axis=0)
    steps = (np.arange(GRID) + 0.5) / GRID
    grid = low + (high - low) * np.stack(np.meshgrid(steps, steps, steps), axis=-1).reshape(-1, 3)
    inside = grid[(grid @ sides[:, :3].T + sides[:, 3] <= 0).all(axis=1)]
    return _Hull(sides, inside, float(np.linalg.norm(corners, axis=1).max()), area)


def _own_sides(solid: Solid) -> tuple[NDArray[np.float64], float]:
    """Outward normal and offset (F, 4) of its triangles, and their area: those of the hull where it is convex."""
    a, b, c = (solid.vertices[solid.faces[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    lengths = np.linalg.norm(normals, axis=1)
    normals = normals[lengths > 0] / lengths[lengths > 0, np.newaxis]
    return np.column_stack([normals, -(normals * a[lengths > 0]).sum(axis=1)]), float(lengths.sum()) / 2
