"""Which turns leave a shape as it is."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from zsight_core.model import Box, Cylinder, Mesh, Shape, Sphere, Surface, size_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["Symmetry", "least_turned", "symmetries_of"]

ORDERS = (2, 3, 4, 5, 6, 8)
"""How many turns to a full one are tried on meshes."""

ALL_AROUND = 36
"""A mesh that this many turns leave as it is counts as round."""

SAME = 0.01
"""Share of its largest edge within which a turned mesh lies on itself; and at least a millimetre."""

_SAMPLES = 1000
_AXES = np.eye(3)


@dataclass(frozen=True)
class Symmetry:
    """Turns about an axis through the model's origin by a full turn over ``order``; 0: by any angle."""

    axis: tuple[float, float, float]
    order: int


def symmetries_of(shape: Shape) -> tuple[Symmetry, ...]:
    """Turns about the model's axes that leave a shape as it is, one an axis; empty where there is none.

    Of a mesh points of its surface are turned, and compared with where the surface is.
    """
    match shape:
        case Box(size):
            return tuple(_about(k, 4 if _equal(size[k - 2], size[k - 1]) else 2) for k in range(3))
        case Cylinder():
            return (_about(0, 2), _about(1, 2), _about(2, 0))
        case Sphere():
            return tuple(_about(k, 0) for k in range(3))
        case Mesh():
            return _of_mesh(shape)
        case Surface():
            return ()


def least_turned(R: NDArray[np.float64], shape: Shape) -> NDArray[np.float64]:
    """Which turn (3, 3) of the model, among those that leave its shape as it is, to put before R (3, 3).

    Of all poses that look the same that one is told which is turned least against the frame of R. A mesh stays as it
    is: it has a front and a back that its shape alone need not show.
    """
    if isinstance(shape, Mesh | Surface):
        return np.eye(3)
    if isinstance(shape, Sphere):
        return R.T
    orders = tuple(symmetry.order for symmetry in symmetries_of(shape))
    turns = _turns(orders)
    if 0 in orders:
        turns = np.array([turn @ _unwound(R @ turn, orders.index(0)) for turn in turns])
    traces = np.round(np.trace(R @ turns, axis1=1, axis2=2), 9)
    best: NDArray[np.float64] = turns[int(np.argmax(traces))]
    return best


@lru_cache(maxsize=64)
def _turns(orders: tuple[int, ...]) -> NDArray[np.float64]:
    """All turns (N, 3, 3) about the three axes that whole steps of full turns over the orders lead to."""
    return np.array(
        [
            np.linalg.multi_dot(
                [np.linalg.matrix_power(_turn(axis, max(orders[axis], 1)), powers[axis]) for axis in range(3)]
            )
            for powers in product(*(range(max(order, 1)) for order in orders))
        ]
    )


def _unwound(R: NDArray[np.float64], axis: int) -> NDArray[np.float64]:
    """The turn (3, 3) about an axis of the model after which R (3, 3) turns least."""
    j, k = (axis + 1) % 3, (axis + 2) % 3
    angle = np.arctan2(R[j, k] - R[k, j], R[j, j] + R[k, k])
    return _turn(axis, 2 * np.pi / angle) if abs(angle) > 1e-12 else np.eye(3)


def _about(axis: int, order: int) -> Symmetry:
    x, y, z = _AXES[axis]
    return Symmetry((float(x), float(y), float(z)), order)


def _equal(a: float, b: float) -> bool:
    return abs(a - b) < 1e-6


def _of_mesh(mesh: Mesh) -> tuple[Symmetry, ...]:
    from scipy.spatial import cKDTree

    surface = _samples(mesh, 20 * _SAMPLES)
    some, tree = surface[::20], cKDTree(surface)
    nearest, _ = tree.query(some, k=[2])  # the first is the point itself
    near = max(SAME * max(size_of(mesh)), 0.001) + float(np.max(nearest))
    found = []
    for axis in range(3):
        turned = {order: some @ _turn(axis, order).T for order in (*ORDERS, ALL_AROUND)}
        gaps = {order: tree.query(points, distance_upper_bound=near)[0] for order, points in turned.items()}
        fits = [order for order, distances in gaps.items() if np.isfinite(distances).all()]
        if ALL_AROUND in fits:
            found.append(_about(axis, 0))
        elif fits:
            found.append(_about(axis, max(fits)))
    return tuple(found)


def _turn(axis: int, order: float) -> NDArray[np.float64]:
    """R (3, 3) about an axis by a full turn over order."""
    c, s = np.cos(2 * np.pi / order), np.sin(2 * np.pi / order)
    j, k = (axis + 1) % 3, (axis + 2) % 3
    R = np.eye(3)
    R[j, j], R[j, k], R[k, j], R[k, k] = c, -s, s, c
    return R


def _samples(mesh: Mesh, count: int) -> NDArray[np.float64]:
    """Points (count, 3) spread evenly over the surface; the same each time."""
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    areas = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    generator = np.random.default_rng(0)
    face = generator.choice(len(areas), count, p=areas / areas.sum())
    u, v = np.sort(generator.random((2, count, 1)), axis=0)
    points: NDArray[np.float64] = u * a[face] + (v - u) * b[face] + (1 - v) * c[face]
    return points
