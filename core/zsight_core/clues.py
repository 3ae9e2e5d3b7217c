"""What recognisers look at: the smooth pieces of a scene in the frame of the surface they stand over."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from zsight_core.transform import inverse

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from zsight_core.scene import Scene
    from zsight_core.wholes import Cells

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
    cells = scene.cells
    frames = [inverse(inverse(scene.view.T_cloud_optical) @ s.T_camera_support) for s in scene.supports]
    pieces: list[Piece] = []
    grouped: dict[int, list[NDArray[np.int64]]] = {}
    for k in range(len(cells.start) - 1):
        members = np.arange(cells.start[k], cells.start[k + 1])
        segment = int(scene.owner[k])
        pieces.append(_piece(cells, members, segment))
        grouped.setdefault(segment, []).append(members)
    segments = [_piece(cells, np.concatenate(m), segment) for segment, m in sorted(grouped.items()) if segment >= 2]
    return Clues(pieces, segments, [T[:3, 3] for T in frames])


def _piece(cells: Cells, members: NDArray[np.int64], segment: int) -> Piece:
    points, normals = cells.points[members], cells.normals[members]
    mean = normals.sum(axis=0)
    mean /= max(float(np.linalg.norm(mean)), 1e-9)
    return Piece(points, normals, mean, segment, int(cells.support[members[0]]), float(np.median(points[:, 2])))
