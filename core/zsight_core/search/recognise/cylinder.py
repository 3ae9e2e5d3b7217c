"""Cylinders: standing and lying."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from zsight_core.search.recognise.votes import Pose, vote
from zsight_core.solid import solid_of

if TYPE_CHECKING:
    from zsight_core.model import Cylinder
    from zsight_core.scene import Checkpoint
    from zsight_core.search.clues import Clues, Hypothesis

__all__ = ["hypotheses"]

LYING = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
"""Rotation that lays the model's z axis along x."""


def hypotheses(shape: Cylinder, clues: Clues, checkpoint: Checkpoint) -> list[Hypothesis]:
    """On its end and on its side."""
    return vote(
        solid_of(shape), [Pose(np.eye(3), shape.height, is_round=True), Pose(LYING, shape.diameter)], clues, checkpoint
    )
