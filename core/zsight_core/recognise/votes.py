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
from zsight_core.clues import Hypothesis, Stand
from zsight_core.model_bits import LAYER, model_bits
from zsight_core.peek import best_places

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from zsight_core.clues import Clues
    from zsight_core.model_bits import ModelBits
    from zsight_core.scene import Checkpoint
    from zsight_core.solid import Solid

__all__ = ["Pose", "turned", "vote", "warm_up"]

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

PROPOSED = 60
"""Places proposed, a pose and stand."""

TURNS = 24
"""Steps of yaw in which a solid is tried where it was found."""

STANDS_AT_ONCE = 8
"""Stands between two checkpoints."""

_TURNS = 720
"""Steps of a full turn in which bits are turned."""

_A_RADIAN = _TURNS / (2 * np.pi)
"""Steps."""

_COSINES, _SINES = (f(np.arange(2 * _TURNS + 1) * 2 * np.pi / _TURNS) / CELL for f in (np.cos, np.sin))
"""Of two full turns, so that sums of two turns need not be wound back; cells a metre."""


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
        stands = clues.stands(pose.tall)
        for first in range(0, len(stands), STANDS_AT_ONCE):
            checkpoint("propose", number / len(poses))
            some = stands[first : first + STANDS_AT_ONCE]
            found += _standing(
                pose, bits, some, *_places(bits, some, clues, 1 if pose.is_round else YAWS // bits.order)
            )
    return found


def turned(solid: Solid, poses: Sequence[Pose], clues: Clues, found: Hypothesis) -> list[Hypothesis]:
    """How else the solid may rest where it was found: the best place near by for each pose and step of yaw."""
    others = []
    for pose in poses:
        bits, place = model_bits(solid, pose.R, is_round=pose.is_round), found.T_support_model[:2, 3]
        around = (1 - BEYOND) * bits.reach
        stand = Stand(found.base, place - around, place + around, found.support, found.carried)
        others += _standing(pose, bits, [stand], *_places(bits, [stand], clues, TURNS // bits.order, each_yaw=True))
    return others


def _places(
    bits: ModelBits, stands: list[Stand], clues: Clues, yaws: int, *, each_yaw: bool = False
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Places (N, 3) on stands that bits agree on and that bear a peek: x, y (m) and yaw (rad); their stands (N,)."""
    lows = np.maximum(np.array([stand.low for stand in stands]) - BEYOND * bits.reach, clues.middles[0])
    highs = np.minimum(np.array([stand.high for stand in stands]) + BEYOND * bits.reach, clues.middles[1])
    return _propose(
        *clues.bits,
        bits.start,
        bits.polar,
        bits.reach,
        np.array([stand.support for stand in stands]),
        np.array([stand.base for stand in stands]),
        lows,
        highs,
        yaws,
        bits.order,
        clues.depth,
        clues.pinhole,
        clues.stacked,
        bits.samples,
        clues.noise,
        each_yaw,
    )


def _standing(
    pose: Pose, bits: ModelBits, stands: list[Stand], places: NDArray[np.float64], numbers: NDArray[np.int64]
) -> list[Hypothesis]:
    c, s = np.cos(places[:, 2]), np.sin(places[:, 2])
    T = np.zeros((len(places), 4, 4))
    T[:, 0, 0], T[:, 0, 1], T[:, 1, 0], T[:, 1, 1], T[:, 2, 2], T[:, 3, 3] = c, -s, s, c, 1.0, 1.0
    T[:, :3, :3] = T[:, :3, :3] @ pose.R
    T[:, :2, 3] = places[:, :2]
    T[:, 2, 3] = np.array([stand.base for stand in stands])[numbers] + bits.below
    found = []
    for place, number in zip(T, numbers.tolist(), strict=True):
        stand = stands[number]
        found.append(Hypothesis(place, stand.base, stand.support, turns=not pose.is_round, carried=stand.seen))
    return found


def warm_up() -> None:
    """Compile the kernels (or load them from their cache)."""
    one, kind, corner = np.zeros(1), np.zeros(1, np.int8), np.zeros((1, 2))
    start, point, depth = np.zeros(KINDS + 1, np.int64), np.zeros((1, 3)), np.ones((4, 4), np.float32)
    bits = (point, one, kind, kind, start, point, 0.1)
    number, frames, samples = np.zeros(1, np.int64), np.eye(4)[np.newaxis], np.zeros((1, 7))
    _propose(*bits, number, one, corner, corner, 1, 1, depth, (1.0, 1.0, 0.0, 0.0), frames, samples, 1e-3, False)


@njit(cache=True, nogil=True, error_model="numpy")
def _propose(
    points: NDArray[np.float64],
    azimuth: NDArray[np.float64],
    kind: NDArray[np.int8],
    over: NDArray[np.int8],
    start: NDArray[np.int64],
    polar: NDArray[np.float64],
    reach: float,
    supports: NDArray[np.int64],
    bases: NDArray[np.float64],
    lows: NDArray[np.float64],
    highs: NDArray[np.float64],
    yaws: int,
    order: int,
    depth: NDArray[np.float32],
    pinhole: tuple[float, float, float, float],
    frames: NDArray[np.float64],
    samples: NDArray[np.float64],
    noise: float,
    each_yaw: bool,
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Places (N, 3) and their stands (N,); stands are supports (S,), bases (S,), and corners (S, 2) (m).

    Yaws are steps of the turn, a full one over order, after which the model looks as before; with each_yaw there is one
    place for each of them.
    """
    most = 0
    for s in range(len(bases)):
        columns, rows = _cells(lows[s], highs[s])
        most = max(most, yaws * rows * columns)
    votes, twice = np.empty(most, np.int16), np.empty(most, np.int32)
    taken = np.zeros(most, np.bool_)
    places, numbers = np.empty((PROPOSED * len(bases), 3)), np.empty(PROPOSED * len(bases), np.int64)
    yaw_of = np.empty(2 * _TURNS + 1, np.int32)
    for way in range(2 * _TURNS + 1):
        yaw_of[way] = (way * yaws * order + _TURNS // 2) // _TURNS % yaws
    steps = polar.copy()
    for j in range(len(polar)):
        for k in range(1, 3):
            steps[j, k] = polar[j, k] * _A_RADIAN + 0.5
    full = 2 * np.pi / order
    count = 0
    for s in range(len(bases)):
        columns, rows = _cells(lows[s], highs[s])
        board = votes[: yaws * rows * columns].reshape(yaws, rows, columns)
        base, low, high = bases[s], lows[s], highs[s]
        model = start, steps, reach, yaw_of
        again = _vote(points, azimuth, kind, over, supports[s], base, *model, low, high, board, twice)
        if each_yaw:
            peaks = _best_of_each_yaw(board)
        else:
            peaks = _peaks(board, twice[:again], taken[: yaws * rows * columns].reshape(yaws, rows, columns))
        for i in range(len(peaks)):
            peaks[i, 0], peaks[i, 1] = low[0] + peaks[i, 0] * CELL, low[1] + peaks[i, 1] * CELL
            peaks[i, 2] *= full / yaws
        axes = 2 if each_yaw else 3
        best = best_places(depth, pinhole, frames[supports[s]], samples, peaks, full, base, noise, PROPOSED, axes)
        for i in range(len(best)):
            places[count], numbers[count] = best[i], s
            count += 1
    return places[:count], numbers[:count]


@njit(cache=True, nogil=True, error_model="numpy")
def _cells(low: NDArray[np.float64], high: NDArray[np.float64]) -> tuple[int, int]:
    """Columns and rows of cells between two corners (2,), which may be crossed where nothing is near."""
    return max(3, int((high[0] - low[0]) / CELL) + 3), max(3, int((high[1] - low[1]) / CELL) + 3)


@njit(cache=True, nogil=True, error_model="numpy")
def _vote(
    points: NDArray[np.float64],
    azimuth: NDArray[np.float64],
    kind: NDArray[np.int8],
    over: NDArray[np.int8],
    support: int,
    base: float,
    start: NDArray[np.int64],
    polar: NDArray[np.float64],
    reach: float,
    yaw_of: NDArray[np.int32],
    low: NDArray[np.float64],
    high: NDArray[np.float64],
    votes: NDArray[np.int16],
    twice: NDArray[np.int32],
) -> int:
    """Count votes (yaws, rows, columns) for the place of the model's origin between the low and the high corner (2,).

    Turns of the model's bits are in steps and half a step more, so that cut off they are rounded.

    Returns:
        How many cells were voted for more than once; their numbers are in twice.
    """
    votes[:] = 0
    rows, columns = votes.shape[1:]
    cells = votes.reshape(-1)
    layers, count = (len(start) - 1) // KINDS, 0
    for i in range(len(points)):
        if over[i] != support or not (low[0] - reach < points[i, 0] < high[0] + reach):
            continue
        layer = int(np.floor((points[i, 2] - base) / LAYER + 0.5))
        if layer < 0 or layer >= layers or not (low[1] - reach < points[i, 1] < high[1] + reach):
            continue
        px, py = (points[i, 0] - low[0]) / CELL + 0.5, (points[i, 1] - low[1]) / CELL + 0.5
        faces = azimuth[i] * _A_RADIAN + (0.0 if azimuth[i] >= 0 else _TURNS)
        key = layer * KINDS + kind[i]
        for j in range(start[key], start[key + 1]):
            way = int(faces + polar[j, 1])
            x, y = px - _COSINES[way] * polar[j, 0], py - _SINES[way] * polar[j, 0]
            if not (0 <= x < columns and 0 <= y < rows):
                continue
            cell = (yaw_of[int(faces + polar[j, 2])] * rows + int(y)) * columns + int(x)
            cells[cell] += 1
            if cells[cell] == 2:
                twice[count] = cell
                count += 1
    return count


@njit(cache=True, nogil=True, error_model="numpy")
def _peaks(  # noqa: C901  one compiled loop
    votes: NDArray[np.int16], twice: NDArray[np.int32], taken: NDArray[np.bool_]
) -> NDArray[np.float64]:
    """Column, row and yaw (N, 3), in cells, of the places with most votes in and around them, best first.

    Args:
        votes: (yaws, rows, columns).
        twice: numbers of the cells with more than one vote.
        taken: as votes; all False, and left so.
    """
    yaws, rows, columns = votes.shape
    turn = 1 if yaws > 1 else 0
    cells = votes.reshape(-1)
    most = 0
    for cell in twice:
        most = max(most, cells[cell])
    least = max(2.0, LEAST_SHARE * most)
    strong, sums = np.empty(len(twice), np.int32), np.empty(len(twice), np.int32)
    count, highest = 0, 0
    for cell in twice:
        if cells[cell] < least:
            continue
        y, r, c = cell // (rows * columns), cell // columns % rows, cell % columns
        if not (0 < r < rows - 1 and 0 < c < columns - 1):
            continue
        total = 0
        for dy in range(-turn, turn + 1):
            middle = (_around(y + dy, yaws) * rows + r) * columns + c
            for at in range(middle - columns, middle + columns + 1, columns):
                total += cells[at - 1] + cells[at] + cells[at + 1]
        if total >= FEWEST:
            strong[count], sums[count] = cell, total
            highest = max(highest, total)
            count += 1
    found, kept = np.empty((PEAKS, 3)), np.empty(PEAKS, np.int32)
    peaks = 0
    for i in _descending(sums[:count], highest):
        if peaks == PEAKS:
            break
        cell = strong[i]
        y, r, c = cell // (rows * columns), cell // columns % rows, cell % columns
        if taken[y, r, c]:
            continue
        sx, sy, turned = 0.0, 0.0, 0.0
        for dy in range(-turn, turn + 1):
            middle = (_around(y + dy, yaws) * rows + r) * columns + c
            for dr in range(-1, 2):
                for dc in range(-1, 2):
                    share = cells[middle + dr * columns + dc] / sums[i]
                    sx, sy, turned = sx + share * dc, sy + share * dr, turned + share * dy
        found[peaks, 0], found[peaks, 1], found[peaks, 2] = c + sx, r + sy, y + turned
        kept[peaks] = cell
        peaks += 1
        _take(taken, y, r, c, turn, True)
    for cell in kept[:peaks]:
        _take(taken, cell // (rows * columns), cell // columns % rows, cell % columns, turn, False)
    return found[:peaks]


@njit(cache=True, nogil=True, error_model="numpy")
def _best_of_each_yaw(votes: NDArray[np.int16]) -> NDArray[np.float64]:
    """Column, row and yaw (yaws, 3), in cells, of the place with most votes in and around it at each step of yaw."""
    yaws, rows, columns = votes.shape
    best = np.zeros((yaws, 3))
    for y in range(yaws):
        most = -1
        for r in range(1, rows - 1):
            for c in range(1, columns - 1):
                total, right, down = 0, 0, 0
                for dr in range(-1, 2):
                    for dc in range(-1, 2):
                        count = votes[y, r + dr, c + dc]
                        total, right, down = total + count, right + dc * count, down + dr * count
                if total > most:
                    most = total
                    best[y, 0], best[y, 1], best[y, 2] = c + right / max(total, 1), r + down / max(total, 1), y
    return best


@njit(cache=True, nogil=True, error_model="numpy")
def _around(y: int, yaws: int) -> int:
    """A step of yaw that may be some beyond the first or last one."""
    return int(y + yaws if y < 0 else (y - yaws if y >= yaws else y))


@njit(cache=True, nogil=True, error_model="numpy")
def _take(taken: NDArray[np.bool_], y: int, r: int, c: int, turn: int, value: bool) -> None:
    """Mark the cells around a peak."""
    yaws, rows, columns = taken.shape
    for dy in range(-2 * turn, 2 * turn + 1):
        layer = _around(y + dy, yaws)
        for dr in range(max(0, r - 2), min(rows, r + 3)):
            for dc in range(max(0, c - 2), min(columns, c + 3)):
                taken[layer, dr, dc] = value


@njit(cache=True, nogil=True, error_model="numpy")
def _descending(sums: NDArray[np.int32], highest: int) -> NDArray[np.int32]:
    """Order (N,) of whole numbers from the highest, equal ones as they come (a counting sort)."""
    place = np.zeros(highest + 2, np.int32)
    for total in sums:
        place[highest - total + 1] += 1
    for k in range(highest + 1):
        place[k + 1] += place[k]
    order = np.empty(len(sums), np.int32)
    for i in range(len(sums)):
        slot = highest - sums[i]
        order[place[slot]] = i
        place[slot] += 1
    return order
