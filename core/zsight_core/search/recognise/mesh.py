"""Meshes: each face of the convex hull down on which they stand."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from zsight_core.search.recognise import votes
from zsight_core.search.recognise.votes import Pose, vote
from zsight_core.solid import solid_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from zsight_core.model import Mesh
    from zsight_core.scene import Checkpoint
    from zsight_core.search.clues import Clues, Hypothesis

__all__ = ["hypotheses", "stable_poses", "turned"]

MOST_POSES = 6

SMALLEST_FACE = 0.03
"""Share of the hull's area below which a face is too small to stand on."""

BALANCE = 0.06
"""Share of the solid's size by which its centre of mass must be inside of what it stands on."""


def hypotheses(shape: Mesh, clues: Clues, checkpoint: Checkpoint) -> list[Hypothesis]:
    """On each stable face."""
    return vote(solid_of(shape), [Pose(R, tall) for R, tall in stable_poses(shape)], clues, checkpoint)


def turned(shape: Mesh, clues: Clues, found: Hypothesis) -> list[Hypothesis]:
    """How else it may rest where it was found: a part of it alone may look the same in many poses."""
    return votes.turned(solid_of(shape), [Pose(R, tall) for R, tall in stable_poses(shape)], clues, found)


def stable_poses(shape: Mesh) -> list[tuple[NDArray[np.float64], float]]:
    """Rotations (3, 3) that put a face of the convex hull down under the centre of mass, with the height.

    As modelled comes first where it is stable.
    """
    return list(_stable_poses(shape.vertices.astype(np.float64).tobytes(), shape.faces.astype(np.int32).tobytes()))


@lru_cache(maxsize=64)
def _stable_poses(vertices: bytes, faces: bytes) -> tuple[tuple[NDArray[np.float64], float], ...]:
    from scipy.spatial import ConvexHull, QhullError

    corners = np.frombuffer(vertices).reshape(-1, 3)
    triangles = np.frombuffer(faces, np.int32).reshape(-1, 3)
    upright = (np.eye(3), float(np.ptp(corners[:, 2])))
    try:
        hull = ConvexHull(corners)
    except (QhullError, ValueError):  # flat or degenerate: only as modelled
        return (upright,)
    centre = _centre_of_mass(corners, triangles)
    size = float(np.ptp(corners, axis=0).max())
    ways = hull.equations[:, :3]
    found: list[tuple[float, NDArray[np.float64]]] = []
    used = np.zeros(len(ways), np.bool_)
    for k in range(len(ways)):
        if used[k]:
            continue
        same = (ways @ ways[k] > 0.9998) & (np.abs(hull.equations[:, 3] - hull.equations[k, 3]) < 1e-3 * size + 1e-4)
        used |= same
        area = _area(corners[hull.simplices[same]])
        if area / hull.area >= SMALLEST_FACE and _is_over(
            centre, ways[k], corners[np.unique(hull.simplices[same])], size
        ):
            found.append((area, ways[k]))
    found.sort(key=lambda item: -item[0])
    poses = [(_putting_down(down), 0.0) for _, down in found]
    poses = [(R, float(np.ptp(corners @ R[2]))) for R, _ in poses if R[2, 2] < 0.9999]
    standing = [upright] if any(down[2] < -0.9999 for _, down in found) or not found else []
    return tuple((standing + poses)[:MOST_POSES])


def _centre_of_mass(corners: NDArray[np.float64], faces: NDArray[np.int32]) -> NDArray[np.float64]:
    """Of the solid, by signed tetrahedra; of the corners where the mesh encloses nothing."""
    a, b, c = (corners[faces[:, k]] for k in range(3))
    volume = np.einsum("ij,ij->i", a, np.cross(b, c)) / 6
    if abs(volume.sum()) < 1e-9:
        return np.asarray(corners.mean(axis=0))
    return np.asarray((volume[:, np.newaxis] * (a + b + c) / 4).sum(axis=0) / volume.sum())


def _area(triangles: NDArray[np.float64]) -> float:
    return float(
        np.linalg.norm(np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]), axis=1).sum() / 2
    )


def _is_over(centre: NDArray[np.float64], down: NDArray[np.float64], ring: NDArray[np.float64], size: float) -> bool:
    """True where the centre of mass stands well within the face."""
    from zsight_core.support import outline_of

    R = _putting_down(down)
    outline = outline_of((ring @ R.T)[:, :2])
    if len(outline) < 3:
        return False
    step = np.roll(outline, -1, axis=0) - outline
    offset = (R @ centre)[:2] - outline
    inside = (step[:, 0] * offset[:, 1] - step[:, 1] * offset[:, 0]) / np.maximum(np.linalg.norm(step, axis=1), 1e-12)
    return bool(inside.min() > BALANCE * size * 0.5)


def _putting_down(down: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rotation (3, 3) by the shortest way that turns a direction downward."""
    up = -down
    axis = np.cross(up, [0.0, 0.0, 1.0])
    sine, cosine = float(np.linalg.norm(axis)), float(up[2])
    if sine < 1e-9:
        return np.eye(3) if cosine > 0 else np.diag([1.0, -1.0, -1.0])
    x, y, z = axis / sine
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    R: NDArray[np.float64] = np.eye(3) + sine * K + (1 - cosine) * K @ K
    return R
