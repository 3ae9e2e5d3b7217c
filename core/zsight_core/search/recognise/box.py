"""Boxes: each different side down."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from zsight_core.search.recognise.votes import Pose, vote
from zsight_core.solid import solid_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from zsight_core.model import Box
    from zsight_core.scene import Checkpoint
    from zsight_core.search.clues import Clues, Hypothesis

__all__ = ["hypotheses", "stable_poses"]


def hypotheses(shape: Box, clues: Clues, checkpoint: Checkpoint) -> list[Hypothesis]:
    """On each side."""
    return vote(solid_of(shape), [Pose(R, tall) for R, tall in stable_poses(shape.size)], clues, checkpoint)


def stable_poses(size: tuple[float, float, float]) -> list[tuple[NDArray[np.float64], float]]:
    """Rotations (3, 3) that put each different side down, with the height; as modelled first."""
    x, y, z = size
    quarter_y = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
    quarter_x = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
    kept: list[tuple[NDArray[np.float64], float]] = []
    for R, tall in ((np.eye(3), z), (quarter_y, x), (quarter_x, y)):
        if not any(abs(tall - other) < 1e-4 for _, other in kept):
            kept.append((R, tall))
    return kept
