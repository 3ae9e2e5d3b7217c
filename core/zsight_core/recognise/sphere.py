"""Balls: every point steps one radius against its normal, and they agree on the centre."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from zsight_core.clues import Clues, Hypothesis
from zsight_core.recognise import votes
from zsight_core.solid import solid_of

if TYPE_CHECKING:
    from zsight_core.model import Sphere

__all__ = ["hypotheses"]


def hypotheses(shape: Sphere, clues: Clues) -> list[Hypothesis]:
    """One centre a segment and a piece, where the height of most centres is that of a ball on something."""
    radius = shape.diameter / 2
    found = votes.hypotheses(solid_of(shape), [votes.Pose(np.eye(3), shape.diameter, round=True)], clues)
    for piece in clues.segments + clues.pieces:
        known = np.abs(piece.normals).sum(axis=1) > 0.5
        if known.sum() < 10:
            continue
        centres = piece.points[known] - radius * piece.normals[known]
        centre = np.median(centres, axis=0)
        near = np.linalg.norm(centres - centre, axis=1) < radius / 2
        if near.sum() < 0.4 * len(centres):
            continue
        centre = np.median(centres[near], axis=0)
        levels = [h for h in clues.bases(piece.support) if clues.is_carried(centre[:2], radius, h, piece.support)]
        base = min(levels, key=lambda h: abs(h + radius - centre[2]))
        if abs(base + radius - centre[2]) > 0.015:
            continue
        T = np.eye(4)
        T[:2, 3] = centre[:2]
        T[2, 3] = base + radius
        found.append(Hypothesis(T, base, piece.support, turns=False))
    return found
