"""Meshes: each stable pose is turned through a full circle over each segment."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from zsight_core.clues import Clues, Hypothesis

if TYPE_CHECKING:
    from zsight_core.model import Mesh

__all__ = ["hypotheses"]

YAWS = 24


def hypotheses(shape: Mesh, clues: Clues) -> list[Hypothesis]:
    """Standing as modelled, its box's middle over the middle of what is seen."""
    size = np.ptp(shape.vertices, axis=0)
    found: list[Hypothesis] = []
    for piece in clues.segments:
        extent = np.ptp(piece.points, axis=0)
        if abs(piece.points[:, 2].max() - size[2]) > 0.012 or max(extent[:2]) > np.hypot(size[0], size[1]) + 0.02:
            continue
        low, high = piece.points[:, :2].min(axis=0), piece.points[:, :2].max(axis=0)
        for yaw in np.arange(YAWS) * 2 * np.pi / YAWS:
            c, s = np.cos(yaw), np.sin(yaw)
            T = np.eye(4)
            T[:2, :2] = [[c, -s], [s, c]]
            T[:2, 3] = (low + high) / 2
            T[2, 3] = size[2] / 2
            found.append(Hypothesis(T, 0.0, piece.support, turns=True))
    return found
