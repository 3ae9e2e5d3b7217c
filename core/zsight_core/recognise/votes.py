"""One-point votes: every oriented bit of the scene says where a solid would have to stand to have such a bit there.

A surface holds two of a solid's rotations and its height. What is left, x, y and yaw, follows from one oriented bit: a
bit of surface of a certain height and steepness, or a bit of the rim of a level top, can only be one of those bits of
the model that have the same height and steepness, and the direction it faces gives the yaw. Where many bits agree,
the solid may stand (a generalised Hough transform, Ballard 1981, over x, y and yaw). Nothing is parted into objects
first, so that touching, stacked and half hidden things vote as well as others.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numba import njit

from zsight_core.bits import KINDS
from zsight_core.clues import Hypothesis
from zsight_core.model_bits import LAYER, model_bits
from zsight_core.peek import best_places

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from zsight_core.clues import Clues, Stand
    from zsight_core.model_bits import ModelBits
    from zsight_core.scene import Checkpoint
    from zsight_core.solid import Solid

__all__ = ["Pose", "vote", "warm_up"]

CELL = 0.010
"""Metres; votes are counted in cells of this size in x and y."""

YAWS = 36
"""Votes are counted in so many steps of yaw."""

BEYOND = 0.6
"""Share of the model's reach by which its middle may lie beyond what is seen of the place it stands on."""

FEWEST = 6
"""Votes in a cell and its neighbours below which nothing is proposed."""

LEAST_SHARE = 0.05
"""Share of the most votes of any cell that a cell must have to be looked at."""

PEAKS = 300
"""Places that are peeked at, a pose and stand."""

PROPOSED = 30
"""Places proposed, a pose and stand."""


class Pose(NamedTuple):
    """One way in which a solid rests."""

    R: NDArray[np.float64]
    """(3, 3) from the model to a frame with z up."""
    tall: float
    """Metres."""
    is_round: bool = False
    """True where turning it about the vertical changes nothing."""


def vote(solid: Solid, poses: Sequence[Pose], clues: Clues, checkpoint: Checkpoint) -> list[Hypothesis]:
    """Where the solid may rest in one of the poses."""
    found: list[Hypothesis] = []
    for number, pose in enumerate(poses):
        bits = model_bits(solid, pose.R, is_round=pose.is_round)
        for stand in clues.stands(pose.tall):
            checkpoint("propose", number / len(poses))
            places = _places(bits, stand, clues, 1 if pose.is_round else YAWS)
            found += [_standing(pose, bits.below, stand, *place) for place in places.tolist()]
    return found


def _places(bits: ModelBits, stand: Stand, clues: Clues, yaws: int) -> NDArray[np.float64]:
    """Places (N, 3) on a stand that bits agree on and that bear a peek: x, y (m) and yaw (rad)."""
    scene = clues.bits
    low, high = stand.low - BEYOND * bits.reach, stand.high + BEYOND * bits.reach
    votes = _vote(*scene, stand.support, stand.base, bits.start, bits.xy, bits.azimuth, low, high, bits.reach, yaws)
    peaks = _peaks(votes)
    peaks[:, :2] = low + peaks[:, :2] * CELL
    peaks[:, 2] *= 2 * np.pi / yaws
    frame = clues.frames[stand.support]
    return best_places(
        clues.depth, clues.pinhole, frame, bits.points, bits.normals, peaks, stand.base, clues.noise, PROPOSED
    )


def _standing(pose: Pose, below: float, stand: Stand, x: float, y: float, yaw: float) -> Hypothesis:
    c, s = np.cos(yaw), np.sin(yaw)
    T = np.eye(4)
    T[:3, :3] = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ pose.R
    T[:3, 3] = x, y, stand.base + below
    return Hypothesis(T, stand.base, stand.support, turns=not pose.is_round, carried=stand.seen)


def warm_up() -> None:
    """Compile the kernels (or load them from their cache)."""
    one, kind, corner = np.zeros(1), np.zeros(1, np.int8), np.zeros(2)
    start = np.zeros(KINDS + 1, np.int64)
    _peaks(_vote(np.zeros((1, 3)), one, kind, kind, 0, 0.0, start, np.zeros((1, 2)), one, corner, corner, 0.1, 1))


@njit(cache=True, nogil=True)
def _vote(
    points: NDArray[np.float64],
    azimuth: NDArray[np.float64],
    kind: NDArray[np.int8],
    over: NDArray[np.int8],
    support: int,
    base: float,
    start: NDArray[np.int64],
    xy: NDArray[np.float64],
    model_azimuth: NDArray[np.float64],
    low: NDArray[np.float64],
    high: NDArray[np.float64],
    reach: float,
    yaws: int,
) -> NDArray[np.int16]:
    """Votes (yaws, rows, columns) for the place of the model's origin between the low and the high corner (2,)."""
    columns, rows = int((high[0] - low[0]) / CELL) + 3, int((high[1] - low[1]) / CELL) + 3
    votes = np.zeros((yaws, rows, columns), np.int16)
    cosines, sines = np.empty(720), np.empty(720)
    for k in range(720):
        cosines[k], sines[k] = np.cos(k * np.pi / 360), np.sin(k * np.pi / 360)
    layers = (len(start) - 1) // KINDS
    for i in range(len(points)):
        if over[i] != support or not (low[0] - reach < points[i, 0] < high[0] + reach):
            continue
        layer = int(np.floor((points[i, 2] - base) / LAYER + 0.5))
        if layer < 0 or layer >= layers or not (low[1] - reach < points[i, 1] < high[1] + reach):
            continue
        key = layer * KINDS + kind[i]
        for j in range(start[key], start[key + 1]):
            fine = int(np.floor((azimuth[i] - model_azimuth[j]) * (360 / np.pi) + 0.5)) % 720
            x = points[i, 0] - (cosines[fine] * xy[j, 0] - sines[fine] * xy[j, 1])
            y = points[i, 1] - (sines[fine] * xy[j, 0] + cosines[fine] * xy[j, 1])
            column, row = int(np.floor((x - low[0]) / CELL + 0.5)), int(np.floor((y - low[1]) / CELL + 0.5))
            if 0 <= row < rows and 0 <= column < columns:
                votes[((fine * yaws + 360) // 720) % yaws, row, column] += 1
    return votes


@njit(cache=True, nogil=True)
def _peaks(votes: NDArray[np.int16]) -> NDArray[np.float64]:  # noqa: C901  one compiled loop
    """Column, row and yaw (N, 3), in cells, of the places with most votes in and around them, best first."""
    yaws, rows, columns = votes.shape
    turn = 1 if yaws > 1 else 0
    least = max(2.0, LEAST_SHARE * votes.max())
    strong = np.argwhere(votes[:, 1 : rows - 1, 1 : columns - 1] >= least)
    strong[:, 1:] += 1
    sums = np.zeros(len(strong), np.int64)
    for i in range(len(strong)):
        y, r, c = strong[i, 0], strong[i, 1], strong[i, 2]
        for dy in range(-turn, turn + 1):
            layer = votes[(y + dy) % yaws]
            for dr in range(-1, 2):
                sums[i] += layer[r + dr, c - 1] + layer[r + dr, c] + layer[r + dr, c + 1]
    taken = np.zeros(votes.shape, np.bool_)
    found = np.empty((PEAKS, 3))
    count = 0
    for i in np.argsort(-sums, kind="mergesort"):
        y, r, c = strong[i, 0], strong[i, 1], strong[i, 2]
        if sums[i] < FEWEST or count == PEAKS:
            break
        if taken[y, r, c]:
            continue
        sx, sy, turned = 0.0, 0.0, 0.0
        for dy in range(-turn, turn + 1):
            for dr in range(-1, 2):
                for dc in range(-1, 2):
                    share = votes[(y + dy) % yaws, r + dr, c + dc] / sums[i]
                    sx, sy, turned = sx + share * dc, sy + share * dr, turned + share * dy
        found[count, 0], found[count, 1], found[count, 2] = c + sx, r + sy, y + turned
        count += 1
        for dy in range(-2 * turn, 2 * turn + 1):
            for dr in range(max(0, r - 2), min(rows, r + 3)):
                for dc in range(max(0, c - 2), min(columns, c + 3)):
                    taken[(y + dy) % yaws, dr, dc] = True
    return found[:count]
