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

from zsight_core.jit import njit
from zsight_core.search.bits import KINDS
from zsight_core.search.clues import Hypothesis, Stand
from zsight_core.search.model_bits import LAYER, model_bits
from zsight_core.search.peek import best_places

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from zsight_core.scene import Checkpoint
    from zsight_core.search.clues import Clues
    from zsight_core.search.model_bits import ModelBits
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

SPILL = 16
"""Cells after those of a board in which votes for places beyond it are counted, in turn: to count in one cell again and
again is slow."""

CHUNK = 16
"""Cells that are passed over at once where none has enough votes; at most SPILL."""


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
        *clues.bits[:-1],
        bits.start,
        bits.faced,
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
    bits = (point, one, corner, kind, kind, start, np.zeros((3, 1), np.float32), 0.1)
    number, frames, samples = np.zeros(1, np.int64), np.eye(4)[np.newaxis], np.zeros((7, 1), np.float32)
    _propose(*bits, number, one, corner, corner, 1, 1, depth, (1.0, 1.0, 0.0, 0.0), frames, samples, 1e-3, False)


@njit(cache=True, nogil=True, error_model="numpy")
def _propose(
    points: NDArray[np.float64],
    azimuth: NDArray[np.float64],
    ways: NDArray[np.float64],
    kind: NDArray[np.int8],
    over: NDArray[np.int8],
    start: NDArray[np.int64],
    faced: NDArray[np.float32],
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
    samples: NDArray[np.float32],
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
    votes, sums = np.empty(most + SPILL, np.int16), np.zeros((2, most), np.int16)
    taken, strong = np.zeros(most, np.bool_), np.empty(most, np.int32)
    near, cells = np.empty(len(points) + 1, np.int32), np.empty(faced.shape[1], np.int32)
    places, numbers = np.empty((PROPOSED * len(bases), 3)), np.empty(PROPOSED * len(bases), np.int64)
    full = 2 * np.pi / order
    count = 0
    for s in range(len(bases)):
        columns, rows = _cells(lows[s], highs[s])
        shape, model = (yaws, rows, columns), (start, faced, reach, yaws * order)
        base, low, high = bases[s], lows[s], highs[s]
        _vote(points, azimuth, ways, kind, over, supports[s], base, *model, low, high, shape, votes, near, cells)
        if each_yaw:
            peaks = _best_of_each_yaw(votes[: yaws * rows * columns].reshape(shape))
        else:
            peaks = _peaks(votes, shape, sums, strong, taken)
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


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _vote(
    points: NDArray[np.float64],
    azimuth: NDArray[np.float64],
    ways: NDArray[np.float64],
    kind: NDArray[np.int8],
    over: NDArray[np.int8],
    support: int,
    base: float,
    start: NDArray[np.int64],
    faced: NDArray[np.float32],
    reach: float,
    turns: int,
    low: NDArray[np.float64],
    high: NDArray[np.float64],
    shape: tuple[int, int, int],
    votes: NDArray[np.int16],
    near: NDArray[np.int32],
    cells: NDArray[np.int32],
) -> None:
    """Count votes for the place of the model's origin between the low and the high corner (2,).

    Args:
        points: of the scene's bits, as in Bits.
        azimuth: likewise.
        ways: likewise.
        kind: likewise.
        over: likewise.
        support: number of the surface.
        base: height of the model's foot over it, metres.
        start: of the model's bits, as in ModelBits.
        faced: likewise.
        reach: likewise.
        turns: steps of yaw to a full turn.
        low: metres.
        high: metres.
        shape: steps of yaw, rows and columns of the board of cells.
        votes: (yaws * rows * columns + SPILL or more,) of each cell; what was there is lost.
        near: (N + 1,) room for the numbers of bits.
        cells: room for the cells that one of the scene's bits votes for, as many as there are bits of the model.
    """
    single, whole = np.float32, np.int32
    yaws, rows, columns = shape
    beyond = yaws * rows * columns
    votes[: beyond + SPILL] = 0
    layers, count = (len(start) - 1) // KINDS, 0
    left, right, below, above = low[0] - reach, high[0] + reach, low[1] - reach, high[1] + reach
    first, last = base - 0.5 * LAYER, base + (layers - 0.5) * LAYER
    for i in range(len(points)):  # no way out of the loop, for such are guessed wrong half of the time
        near[count] = i
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        is_near = (over[i] == support) & (x > left) & (x < right) & (y > below) & (y < above)
        count += 1 if is_near & (z >= first) & (z < last) else 0
    nothing, half, one_in = single(0), single(0.5), single(1.0 / yaws)
    across, along, turn = single(columns), single(rows), single(turns)
    n, layer_size, row_size, spill = whole(yaws), whole(rows * columns), whole(columns), whole(beyond)
    for q in range(count):
        i = near[q]
        key = int((points[i, 2] - first) / LAYER) * KINDS + kind[i]
        one, end = start[key], start[key + 1]
        ahead, aside, turned, chosen = faced[0, one:end], faced[1, one:end], faced[2, one:end], cells[: end - one]
        px, py = single((points[i, 0] - low[0]) / CELL + 0.5), single((points[i, 1] - low[1]) / CELL + 0.5)
        c, s = single(ways[i, 0] / CELL), single(ways[i, 1] / CELL)
        faces = single(azimuth[i] / (2 * np.pi) % 1.0)
        for j in range(len(chosen)):  # nothing but sums here: the compiler does several votes at a time
            x = px + c * ahead[j] - s * aside[j]
            y = py + s * ahead[j] + c * aside[j]
            yaw = whole((faces + turned[j]) * turn + half)
            yaw -= n * whole((single(yaw) + half) * one_in)
            inside = (x >= nothing) & (x < across) & (y >= nothing) & (y < along)
            cell = yaw * layer_size + whole(y) * row_size + whole(x)
            chosen[j] = cell if inside else spill + whole(j) % whole(SPILL)
        for j in range(len(chosen)):
            votes[np.uint32(chosen[j])] += 1


@njit(cache=True, nogil=True, error_model="numpy")
def _peaks(  # noqa: C901  one compiled loop
    votes: NDArray[np.int16],
    shape: tuple[int, int, int],
    sums: NDArray[np.int16],
    strong: NDArray[np.int32],
    taken: NDArray[np.bool_],
) -> NDArray[np.float64]:
    """Column, row and yaw (N, 3), in cells, of the places with most votes in and around them, best first.

    Args:
        votes: as of _vote.
        shape: likewise.
        sums: (2, C) room for numbers of each cell.
        strong: (C,) room for numbers of cells.
        taken: (C,) one a cell; all False, and left so.
    """
    yaws, rows, columns = shape
    size = rows * columns
    cells, turn = votes[: yaws * size], 1 if yaws > 1 else 0
    around = _sums_around(cells, shape, sums)
    most = np.int16(0)
    for cell in range(len(cells)):
        most = max(most, cells[cell])
    least = int(max(2.0, np.ceil(LEAST_SHARE * most)))
    count, highest = 0, 0
    for yaw in range(yaws):
        for row in range(yaw * size + columns, (yaw + 1) * size - columns, columns):
            for first in range(row + 1, row + columns - 1, CHUNK):
                if _most_of_chunk(votes, first) < least:
                    continue
                for cell in range(first, min(first + CHUNK, row + columns - 1)):
                    if cells[cell] >= least and around[cell] >= FEWEST:
                        strong[count] = cell
                        highest = max(highest, around[cell])
                        count += 1
    found = np.empty((PEAKS, 3))
    peaks = 0
    for i in _descending(around[strong[:count]], highest):
        if peaks == PEAKS:
            break
        cell = strong[i]
        if taken[cell]:
            continue
        y, r, c = cell // size, cell // columns % rows, cell % columns
        right, down, turned = 0, 0, 0
        for dy in range(-turn, turn + 1):
            middle = (_around(y + dy, yaws) * rows + r) * columns + c
            for dr in range(-1, 2):
                at = middle + dr * columns
                total = cells[at - 1] + cells[at] + cells[at + 1]
                right, down, turned = right + cells[at + 1] - cells[at - 1], down + dr * total, turned + dy * total
        share = 1.0 / around[cell]
        found[peaks, 0], found[peaks, 1], found[peaks, 2] = c + right * share, r + down * share, y + turned * share
        peaks += 1
        for dy in range(-2 * turn, 2 * turn + 1):
            layer = _around(y + dy, yaws) * rows
            for dr in range(max(0, r - 2), min(rows, r + 3)):
                for at in range((layer + dr) * columns + max(0, c - 2), (layer + dr) * columns + min(columns, c + 3)):
                    taken[at] = True
    taken[: yaws * size] = False
    return found[:peaks]


@njit(cache=True, nogil=True, error_model="numpy")
def _sums_around(cells: NDArray[np.int16], shape: tuple[int, int, int], sums: NDArray[np.int16]) -> NDArray[np.int16]:
    """Votes (C,) in each cell (C,) and its neighbours; not told at the border of a board."""
    yaws, rows, columns = shape
    end, size = len(cells), rows * columns
    one, two = sums[0, :end], sums[1, :end]
    _add(cells[: end - 2], cells[1 : end - 1], cells[2:], one[1 : end - 1])
    _add(one[: end - 2 * columns], one[columns : end - columns], one[2 * columns :], two[columns : end - columns])
    if yaws == 1:
        return two
    for yaw in range(yaws):
        before, after = _around(yaw - 1, yaws) * size, _around(yaw + 1, yaws) * size
        here = yaw * size
        _add(two[before : before + size], two[here : here + size], two[after : after + size], one[here : here + size])
    return one


@njit(cache=True, nogil=True, error_model="numpy")
def _add(a: NDArray[np.int16], b: NDArray[np.int16], c: NDArray[np.int16], total: NDArray[np.int16]) -> None:
    for i in range(len(total)):
        total[i] = a[i] + b[i] + c[i]


@njit(cache=True, nogil=True, error_model="numpy")
def _most_of_chunk(votes: NDArray[np.int16], first: int) -> int:
    most, start = np.int16(0), np.uint32(first)
    for i in range(CHUNK):
        most = max(most, votes[start + np.uint32(i)])
    return int(most)


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
def _descending(sums: NDArray[np.int16], highest: int) -> NDArray[np.int32]:
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
