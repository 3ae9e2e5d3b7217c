"""Balls: every point steps one radius against its normal, and they agree on the centre."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from zsight_core.clues import Clues, Hypothesis

if TYPE_CHECKING:
    from zsight_core.model import Sphere

__all__ = ["hypotheses"]


def hypotheses(shape: Sphere, clues: Clues) -> list[Hypothesis]:
    """One centre a segment and a piece, where the height of most centres is that of a ball on something."""
    radius = shape.diameter / 2
    found: list[Hypothesis] = []
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
        base = float(centre[2]) - radius
        if base > 0.015:
            levels = [p.height for p in clues.pieces if p.is_level and p.support == piece.support]
            levels = [h for h in levels if abs(h - base) < 0.012]
            if not levels:
                continue
            base = min(levels, key=lambda h: abs(h - base))
        elif abs(base) < 0.015:
            base = 0.0
        else:
            continue
        T = np.eye(4)
        T[:2, 3] = centre[:2]
        T[2, 3] = base + radius
        found.append(Hypothesis(T, base, piece.support, turns=False))
    return found
