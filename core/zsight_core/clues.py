"""What recognisers look at: the smooth pieces of a scene in the frame of the surface they stand over."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from zsight_core.transform import inverse

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from zsight_core.scene import Scene

__all__ = ["Clues", "Hypothesis", "Piece", "clues_of"]

LEVEL = float(np.cos(np.radians(14.0)))
"""A piece whose mean normal is this near to up is flat: a top that may carry things."""

HEIGHT_GATE = 0.010
"""Metres; a top may lie this far from where the shape says."""


class Hypothesis(NamedTuple):
    """A solid might stand here."""

    T_support_model: NDArray[np.float64]
    """(4, 4) in the frame of the surface."""
    base: float
    """Height of its foot over the surface, metres; above 0 where it stands on another object."""
    support: int
    """Number of the surface."""
    turns: bool
    """True where its yaw can be seen; False for a shape that looks the same from all around."""


@dataclass(frozen=True, eq=False)
class Piece:
    """A smooth piece of surface, or all of a segment."""

    points: NDArray[np.float64]
    """(N, 3) metres in the support's frame."""
    normals: NDArray[np.float64]
    """(N, 3) unit, toward the camera, in the support's frame; zeros where unknown."""
    normal: NDArray[np.float64]
    """(3,) mean."""
    segment: int
    """Label of the segment, 0 for none."""
    support: int
    height: float
    """Metres: median of its points' heights."""

    @property
    def is_level(self) -> bool:
        """True for a top."""
        return bool(self.normal[2] > LEVEL)


@dataclass(frozen=True, eq=False)
class Clues:
    """All pieces of a scene, and its segments as pieces."""

    pieces: list[Piece]
    segments: list[Piece]
    eyes: list[NDArray[np.float64]]
    """Per support the camera's place (3,), metres, in the support's frame."""

    @property
    def tops(self) -> list[Piece]:
        """Level pieces, the highest first."""
        return sorted((p for p in self.pieces if p.is_level), key=lambda p: -p.height)

    def bases(self, top: Piece, tall: float) -> list[float]:
        """Heights over the surface on which something this tall could stand so that its top is here."""
        base = top.height - tall
        if abs(base) < HEIGHT_GATE:
            return [0.0]
        if base < 0:
            return []
        reach = np.ptp(top.points[:, :2], axis=0).max() + 0.03
        found = [
            other.height
            for other in self.pieces
            if other.is_level
            and other.support == top.support
            and abs(other.height - base) < HEIGHT_GATE
            and np.abs(other.points[:, :2] - top.points[:, :2].mean(axis=0)).max(axis=1).min() < reach
        ]
        return [min(found, key=lambda h: abs(h - base))] if found else []


def clues_of(scene: Scene) -> Clues:
    """Collect the pieces of a scene."""
    patches, view = scene.patches, scene.view
    rows, columns = np.nonzero(patches.label >= 0)
    label = patches.label[rows, columns]
    v, u = rows * patches.step, columns * patches.step
    z = view.depth[v, u].astype(np.float64)
    optical = np.stack([(u - view.cx) / view.fx * z, (v - view.cy) / view.fy * z, z], axis=1)
    normal = patches.normal[rows, columns].astype(np.float64)
    over = scene.over[v, u]
    frames = [inverse(inverse(view.T_cloud_optical) @ s.T_camera_support) for s in scene.supports]
    points = np.empty_like(optical)
    normals = np.empty_like(normal)
    for s, T in enumerate(frames):
        on = over == s
        points[on] = optical[on] @ T[:3, :3].T + T[:3, 3]
        normals[on] = normal[on] @ T[:3, :3].T
    segment = scene.owner[label] if len(label) else label
    pieces = _split(label, points, normals, segment, over)
    segments = [piece for piece in _split(segment, points, normals, segment, over) if piece.segment >= 2]
    return Clues(pieces, segments, [T[:3, 3] for T in frames])


def _split(
    key: NDArray[np.int32],
    points: NDArray[np.float64],
    normals: NDArray[np.float64],
    segment: NDArray[np.int32],
    over: NDArray[np.int8],
) -> list[Piece]:
    """One piece a key."""
    order = np.argsort(key, kind="stable")
    cuts = np.flatnonzero(np.diff(key[order])) + 1
    pieces = []
    for members in np.split(order, cuts):
        if len(members) == 0 or over[members[0]] < 0:
            continue
        mean = normals[members].sum(axis=0)
        mean /= max(float(np.linalg.norm(mean)), 1e-9)
        height = float(np.median(points[members, 2]))
        pieces.append(
            Piece(points[members], normals[members], mean, int(segment[members[0]]), int(over[members[0]]), height)
        )
    return pieces
