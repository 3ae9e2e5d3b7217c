"""Boxes: rectangles of the known footprint are laid over what lies at the known height, and against upright faces."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numba import njit

from zsight_core.clues import Clues, Hypothesis, Layer, Piece, ends_of
from zsight_core.recognise import votes
from zsight_core.solid import solid_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from zsight_core.model import Box

__all__ = ["hypotheses", "stable_poses", "warm_up"]

SLACK = 0.008
"""Metres by which a measured side may miss a known one and still be the whole side."""

FACE = 20
"""Cells of an upright piece that may be a face."""

UPRIGHT = 0.97
"""Least level part of the normal of an upright face."""


def hypotheses(shape: Box, clues: Clues) -> list[Hypothesis]:
    """Rectangles on tops and against faces, slid to each end where only a part is seen."""
    poses = [votes.Pose(R, tall) for R, (_, _, tall) in stable_poses(shape.size)]
    found = votes.hypotheses(solid_of(shape), poses, clues)
    for R, (a, b, tall) in stable_poses(shape.size):
        for piece in clues.pieces:
            found += _against_face(piece, R, a, b, tall)
    return found


def stable_poses(size: tuple[float, float, float]) -> list[tuple[NDArray[np.float64], tuple[float, float, float]]]:
    """Rotations (3, 3) that put each different side down, with the extents along x, y and up; as modelled first."""
    x, y, z = size
    quarter_y = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
    quarter_x = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
    poses = [(np.eye(3), (x, y, z)), (quarter_y, (z, y, x)), (quarter_x, (x, z, y))]
    kept: list[tuple[NDArray[np.float64], tuple[float, float, float]]] = []
    for R, extents in poses:
        if not any(abs(extents[2] - other[1][2]) < 1e-4 for other in kept):
            kept.append((R, extents))
    return kept


def _on_top(layer: Layer, R: NDArray[np.float64], a: float, b: float, tall: float, base: float) -> list[Hypothesis]:
    found = []
    for yaw in _best_yaws(layer.xy, a, b):
        c, s = np.cos(yaw), np.sin(yaw)
        along, across = layer.xy @ [c, s], layer.xy @ [-s, c]
        found += [
            _standing(c * x - s * y, s * x + c * y, yaw, R, base, tall, layer.support)
            for x in _places(along, a)
            for y in _places(across, b)
        ]
    return found


def _against_face(piece: Piece, R: NDArray[np.float64], a: float, b: float, tall: float) -> list[Hypothesis]:
    """On the surface with one side in the plane of an upright piece: for boxes whose top is cut off or hidden."""
    if len(piece.points) < FACE or np.hypot(*piece.normal[:2]) < UPRIGHT:
        return []
    if ends_of(piece.points[:, 2], 0.1)[1] > tall + 0.01:
        return []
    out = piece.normal[:2] / np.linalg.norm(piece.normal[:2])
    side = np.array([-out[1], out[0]])
    face = float(np.median(piece.points[:, :2] @ out))
    found = []
    for wide, deep, turn in ((b, a, 0.0), (a, b, np.pi / 2)):
        seen = piece.points[:, :2] @ side
        if np.ptp(seen) > wide + 0.015:
            continue
        for middle in _places(seen, wide):
            x, y = (face - deep / 2) * out + middle * side
            found.append(_standing(x, y, float(np.arctan2(out[1], out[0])) + turn, R, 0.0, tall, piece.support))
    return found


def _standing(
    x: float, y: float, yaw: float, R: NDArray[np.float64], base: float, tall: float, support: int
) -> Hypothesis:
    c, s = np.cos(yaw), np.sin(yaw)
    T = np.eye(4)
    T[:3, :3] = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ R
    T[:3, 3] = x, y, base + tall / 2
    return Hypothesis(T, base, support, turns=True)


def _places(values: NDArray[np.float64], side: float) -> list[float]:
    """Centres of a side along one direction: in the middle where it is all seen, else at each end and the middle."""
    low, high = ends_of(values, 0.01)
    middle = (low + high) / 2
    if abs(high - low - side) < SLACK:
        return [middle]
    return [low + side / 2, middle, high - side / 2]


def _best_yaws(xy: NDArray[np.float64], a: float, b: float) -> list[float]:
    """Up to three yaws whose rectangle fits, best first."""
    misfit = _sweep(xy, a, b)
    count = len(misfit)
    dips = [k for k in range(count) if misfit[k] <= misfit[k - 1] and misfit[k] < misfit[(k + 1) % count]]
    dips.sort(key=lambda k: (misfit[k], k))
    return [k * np.pi / count for k in dips[:3]]


@njit(cache=True, nogil=True)
def _sweep(xy: NDArray[np.float64], a: float, b: float) -> NDArray[np.float64]:
    """Misfit, metres, for 60 yaws over half a turn: area of the rectangle around, and what sticks out of a x b."""
    count = 60
    misfit = np.empty(count)
    for k in range(count):
        c, s = np.cos(k * np.pi / count), np.sin(k * np.pi / count)
        lx, hx, ly, hy = np.inf, -np.inf, np.inf, -np.inf
        for i in range(len(xy)):
            x, y = c * xy[i, 0] + s * xy[i, 1], c * xy[i, 1] - s * xy[i, 0]
            lx, hx, ly, hy = min(lx, x), max(hx, x), min(ly, y), max(hy, y)
        ex, ey = hx - lx, hy - ly
        out = max(0.0, ex - a) + max(0.0, ey - b)
        short = max(0.0, a - ex) + max(0.0, b - ey)
        misfit[k] = out + 0.25 * short + 0.5 * np.sqrt(ex * ey)
    return misfit


def warm_up() -> None:
    """Compile the kernels (or load them from their cache)."""
    _sweep(np.zeros((2, 2)), 0.1, 0.1)
