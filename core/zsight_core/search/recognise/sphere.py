"""Balls: one way to lie."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from zsight_core.search.recognise.votes import Pose, vote
from zsight_core.solid import solid_of

if TYPE_CHECKING:
    from zsight_core.model import Sphere
    from zsight_core.scene import Checkpoint
    from zsight_core.search.clues import Clues, Hypothesis

__all__ = ["hypotheses"]


def hypotheses(shape: Sphere, clues: Clues, checkpoint: Checkpoint) -> list[Hypothesis]:
    """Anywhere."""
    return vote(solid_of(shape), [Pose(np.eye(3), shape.diameter, is_round=True)], clues, checkpoint)
