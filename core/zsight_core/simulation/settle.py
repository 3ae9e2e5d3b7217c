"""How objects come to rest: on which sides they stand, what ground they cover, and what may stand on them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from zsight_core.errors import ModelError
from zsight_core.model import Box, Cylinder, Mesh, Shape, Sphere, size_of
from zsight_core.solid import solid_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["RestingPose", "gap", "resting_poses", "slide_to", "stands_on"]

LEAST_SHARE = 0.03
"""Solid angle of a side over that of all sides, below which an object is not taken to stand on it."""

SLENDER = 3.0
"""Height over the narrowest width of the ground contact above which an object is not taken to stay upright."""

MARGIN = 0.004
"""Metres from the centre of mass to the border of what carries it."""

FLAT = 1e-4
"""Metres within which vertices lie in one plane."""

SAME_SIDE = 1e-6
"""One less the cosine between normals of faces that are one flat side."""

FILLED = 0.8
"""Share of its outline that a top face fills at least for other things to stand on it."""

LYING = 0.3
"""Share of cylinders that lie."""

SIDES = 48
"""Corners of the polygon around a circle; it is drawn around, so that nothing sticks out of it."""


@dataclass(frozen=True, eq=False)
class RestingPose:
    """One way in which a shape rests on a horizontal plane, before it is turned about the vertical.

    Attributes:
        R: (3, 3) from the model frame to one with z up.
        share: how often it is met, 0..1; the shares of a shape add up to 1.
        below: metres from the model's origin down to the plane.
        above: metres from the model's origin up to the highest point.
        ground: (K, 2) counter-clockwise convex outline seen from above, metres.
        top: (K, 2) convex outline of the level highest face, on which other things can stand; empty: there is none.
        centre: (2,) centre of mass seen from above, metres.
    """

    R: NDArray[np.float64]
    share: float
    below: float
    above: float
    ground: NDArray[np.float64]
    top: NDArray[np.float64]
    centre: NDArray[np.float64]


def resting_poses(shape: Shape) -> tuple[RestingPose, ...]:
    """All plausible ways in which a shape rests.

    Method: a body of even density rests on those faces of its convex hull above which its centre of mass lies; how
    often follows the solid angle under which the centre sees the face (Goldberg et al., Part pose statistics, 1999,
    the simplest of their estimates) where it is dropped; people set things down as they like, so that half of
    the share is the same for all faces.

    Raises:
        ModelError: a surface does not rest on anything; a mesh has no such face.
    """
    match shape:
        case Cylinder() | Sphere():
            return _round(shape)
        case Box():
            solid = solid_of(shape)
            return _faceted(solid.vertices.tobytes(), solid.faces.tobytes())
        case Mesh(vertices, faces):
            return _faceted(vertices.astype(np.float64).tobytes(), faces.astype(np.int32).tobytes())
        case _:
            raise ModelError(f"{type(shape).__name__} does not rest on a surface; expected a solid")


def gap(a: NDArray[np.float64], b: NDArray[np.float64]) -> float:
    """Distance of two convex outlines (K, 2) along the best separating edge normal, metres; negative: they overlap.

    Method: separating axes (Ericson, Real-Time Collision Detection, 2005, chapter 5.2.1).
    """
    best = -np.inf
    for one, other in ((a, b), (b, a)):
        normals = _normals(one)
        apart = (other @ normals.T).min(axis=0) - (one @ normals.T).max(axis=0)
        best = max(best, float(apart.max()))
    return best


def slide_to(
    moving: NDArray[np.float64], still: NDArray[np.float64], direction: NDArray[np.float64], distance: float
) -> NDArray[np.float64]:
    """Shift (2,), metres, along the unit direction that puts one outline at a distance from another, from outside.

    Args:
        moving: (K, 2) convex outline around the origin.
        still: (K, 2) convex outline.
        direction: (2,) from ``still`` to where the other one shall stand.
        distance: metres between both, not below zero.
    """
    start = still.mean(axis=0)
    near, far = 0.0, float(np.ptp(moving, axis=0).sum() + np.ptp(still, axis=0).sum()) + distance
    for _ in range(30):
        middle = (near + far) / 2
        if gap(moving + start + direction * middle, still) < distance:
            near = middle
        else:
            far = middle
    shift: NDArray[np.float64] = start + direction * far
    return shift


def stands_on(top: NDArray[np.float64], centre: NDArray[np.float64]) -> bool:
    """True where a centre of mass (2,) lies inside the convex outline (K, 2) of a top face, MARGIN from its border."""
    if len(top) < 3:
        return False
    normals = _normals(top)
    return bool(((top - centre) * normals).sum(axis=1).min() > MARGIN)


def _normals(outline: NDArray[np.float64]) -> NDArray[np.float64]:
    """Outward unit normals (K, 2) of the edges of a counter-clockwise outline."""
    step = np.roll(outline, -1, axis=0) - outline
    outward = np.stack([step[:, 1], -step[:, 0]], axis=1)
    normals: NDArray[np.float64] = outward / np.linalg.norm(outward, axis=1, keepdims=True)
    return normals


@lru_cache(maxsize=64)
def _round(shape: Cylinder | Sphere) -> tuple[RestingPose, ...]:
    half = np.array(size_of(shape)) / 2
    around = np.arange(SIDES) * 2 * np.pi / SIDES
    inner = np.stack([np.cos(around), np.sin(around)], axis=1) * half[0]
    circle = inner / np.cos(np.pi / SIDES)
    nowhere, middle = np.zeros((0, 2)), np.zeros(2)
    if isinstance(shape, Sphere):
        return (RestingPose(np.eye(3), 1.0, half[0], half[0], circle, nowhere, middle),)
    down = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
    side = np.array([[1, -1], [1, 1], [-1, 1], [-1, -1]]) * half[[2, 0]]
    upright = RestingPose(np.eye(3), 1 - LYING, half[2], half[2], circle, inner, middle)
    return (upright, RestingPose(down, LYING, half[0], half[0], side, nowhere, middle))


@lru_cache(maxsize=64)
def _faceted(vertices: bytes, faces: bytes) -> tuple[RestingPose, ...]:
    corners = np.frombuffer(vertices).reshape(-1, 3)
    triangles = corners[np.frombuffer(faces, np.int32).reshape(-1, 3)]
    mass = _centre_of_mass(triangles)
    hull = ConvexHull(corners)
    poses = []
    for outward in _distinct(hull.equations[:, :3]):
        side = (hull.equations[:, :3] @ outward > 1 - SAME_SIDE).nonzero()[0]
        share = sum(_solid_angle(corners[hull.simplices[k]] - mass) for k in side)
        R = _turn_down(outward)
        pose = _standing(R, share / (4 * np.pi), corners @ R.T, triangles @ R.T, R @ mass)
        if pose is not None and pose.share > LEAST_SHARE:
            poses.append(pose)
    if not poses:
        raise ModelError("the mesh rests on no face of its convex hull; expected a closed surface with a flat side")
    total = sum(pose.share for pose in poses)
    return tuple(replace(pose, share=(pose.share / total + 1 / len(poses)) / 2) for pose in poses)


def _standing(
    R: NDArray[np.float64],
    share: float,
    corners: NDArray[np.float64],
    triangles: NDArray[np.float64],
    mass: NDArray[np.float64],
) -> RestingPose | None:
    """The pose, with everything turned by R already; None where it would tip over."""
    low, high = float(corners[:, 2].min()), float(corners[:, 2].max())
    contact = _outline(corners[corners[:, 2] < low + FLAT, :2])
    if not stands_on(contact, mass[:2]) or high - low > SLENDER * _width(contact):
        return None
    return RestingPose(R, share, -low, high, _outline(corners[:, :2]), _level_top(triangles, high), mass[:2])


def _level_top(triangles: NDArray[np.float64], high: float) -> NDArray[np.float64]:
    """Outline of the highest faces where they are level and fill it; a rim, as of a mug, is no top."""
    level = triangles[(triangles[:, :, 2] > high - FLAT).all(axis=1)][:, :, :2]
    if len(level) == 0:
        return np.zeros((0, 2))
    outline = _outline(level.reshape(-1, 2))
    one, two = level[:, 1] - level[:, 0], level[:, 2] - level[:, 0]
    filled = float(np.abs(one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0]).sum()) / 2
    return outline if filled > FILLED * ConvexHull(outline).volume else np.zeros((0, 2))


def _outline(xy: NDArray[np.float64]) -> NDArray[np.float64]:
    """Counter-clockwise convex outline (K, 2) of points (N, 2); a point where they lie on one line."""
    try:
        hull = ConvexHull(xy)
    except QhullError:
        return xy[:1]
    outline: NDArray[np.float64] = xy[hull.vertices]
    return outline


def _width(outline: NDArray[np.float64]) -> float:
    """Least distance of two parallel lines around a convex outline."""
    across = outline @ _normals(outline).T
    return float((across.max(axis=0) - across.min(axis=0)).min())


def _centre_of_mass(triangles: NDArray[np.float64]) -> NDArray[np.float64]:
    """Centre (3,) of the body of even density inside closed triangles (F, 3, 3)."""
    volumes = np.einsum("ij,ij->i", triangles[:, 0], np.cross(triangles[:, 1], triangles[:, 2]))
    if abs(volumes.sum()) < 1e-12:
        raise ModelError("the mesh encloses no volume; expected a closed surface")
    centre: NDArray[np.float64] = (volumes[:, np.newaxis] * triangles.sum(axis=1) / 4).sum(axis=0) / volumes.sum()
    return centre


def _distinct(normals: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    """One normal for each flat side of a triangulated hull."""
    kept: list[NDArray[np.float64]] = []
    for normal in normals:
        if all(normal @ other < 1 - SAME_SIDE for other in kept):
            kept.append(normal)
    return kept


def _turn_down(outward: NDArray[np.float64]) -> NDArray[np.float64]:
    """R (3, 3) that turns a unit normal to -z."""
    z = -outward
    x = np.eye(3)[int(np.argmin(np.abs(z)))]
    x = x - z * (x @ z)
    x /= np.linalg.norm(x)
    return np.array([x, np.cross(z, x), z])


def _solid_angle(corners: NDArray[np.float64]) -> float:
    """Of a triangle (3, 3) seen from the origin (Van Oosterom and Strackee 1983), steradians."""
    a, b, c = corners
    x, y, z = (float(np.linalg.norm(corner)) for corner in corners)
    below = x * y * z + float(a @ b) * z + float(a @ c) * y + float(b @ c) * x
    return 2 * abs(float(np.arctan2(abs(float(a @ np.cross(b, c))), below)))
