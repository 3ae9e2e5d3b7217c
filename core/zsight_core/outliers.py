"""Points that stand alone: left out by how many others are near, or by how far the nearest others are."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from zsight_core.errors import GeometryError
from zsight_core.jit import njit
from zsight_core.neighbour_grid import block_around, grid_of
from zsight_core.statistics import count_finite
from zsight_core.take import take
from zsight_core.words import words_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from zsight_core.points import Points
    from zsight_core.words import Layout, Words

__all__ = ["remove_radius_outliers", "remove_statistical_outliers", "warm_up"]

_SAMPLE = 32
"""Points whose neighbours tell how wide cells must be."""

_FARTHEST = 1e18
"""Metres; the square of a greater distance is more than float32 holds."""


def remove_radius_outliers(points: Points, radius: float, least: int, out: Points | None = None) -> Points:
    """The points that have at least so many others within a radius: (1, M), all fields kept; what PCL's filter keeps.

    Args:
        points: (H, W), metres; holes are left out.
        radius: metres.
        least: other points.
        out: room for the result, contiguous, at least M points; the result is then a view of it.

    Raises:
        GeometryError: radius or `least` not above zero, or the radius so small that the grid overflows.
    """
    if not (math.isfinite(radius) and radius > 0 and least > 0):
        raise GeometryError(f"{least} points within {radius} m; expected numbers above zero")
    keep = np.zeros(points.size, np.bool_)
    grid = grid_of(words_of(points), radius)
    _crowded(grid.xyz, grid.starts, grid.keys, grid.order, radius, least + 1, keep)
    del grid
    return take(points, keep.reshape(points.shape), out)


def remove_statistical_outliers(
    points: Points, neighbours: int, deviations: float, out: Points | None = None
) -> Points:
    """The points whose neighbours are not unusually far: (1, M), all fields kept; what PCL's filter keeps.

    Method (Rusu et al. 2008): for each point the mean distance of its nearest neighbours; kept are those where it is
    at most the mean of these means plus so many of their standard deviations. Neighbours are sought in cells about as
    wide as the farthest of them is far; where that does not reach far enough, in cells twice as wide, and so on.

    Args:
        points: (H, W), metres; holes are left out.
        neighbours: how many, itself not counted.
        deviations: standard deviations above the mean.
        out: room for the result, contiguous, at least M points; the result is then a view of it.

    Raises:
        GeometryError: `neighbours` not above zero; fewer points than that; `deviations` is NaN; a coordinate above
            1e18 m, whose square float32 does not hold.
    """
    cloud, count = words_of(points), count_finite(points)
    if not 0 < neighbours < max(count, 1) or math.isnan(deviations):
        raise GeometryError(
            f"{neighbours} neighbours in {count} points, {deviations} deviations; expected fewer neighbours than points"
        )
    far = _mean_distances(cloud, count, neighbours)
    mean, spread = _mean_and_deviation(far)
    keep = far <= mean + deviations * spread  # False for the NaN of a hole
    return take(points, keep.reshape(points.shape), out)


@njit(cache=True, nogil=True)
def _mean_and_deviation(values: NDArray[np.float32]) -> tuple[float, float]:
    """Mean and standard deviation (of a sample) of those that are not NaN, without a copy of them."""
    count, total = 0, 0.0
    for value in values:
        if not math.isnan(value):
            count, total = count + 1, total + value
    mean, squares = total / count, 0.0
    for value in values:
        if not math.isnan(value):
            squares += (value - mean) * (value - mean)
    return mean, math.sqrt(squares / (count - 1))


def _mean_distances(cloud: Words, count: int, neighbours: int) -> NDArray[np.float32]:
    """Mean distance (N,) of the nearest neighbours of each of `count` finite points, NaN at holes."""
    far = np.empty(cloud.count, np.float32)
    edge = _first_edge(cloud, count, neighbours + 1, far)
    far[:] = np.nan
    while _add_distances_in(cloud, edge, neighbours + 1, far):
        edge *= 2
    return far


def _add_distances_in(cloud: Words, edge: float, count: int, far: NDArray[np.float32]) -> int:
    """`_add_distances` in cells of this edge; the grid is gone before a coarser one is made."""
    grid = grid_of(cloud, edge)
    return _add_distances(grid.xyz, grid.starts, grid.keys, grid.order, edge, count, far)


def _first_edge(cloud: Words, finite: int, count: int, room: NDArray[np.float32]) -> float:
    """A cell's edge that reaches the `count`-th nearest of half of the points, as a sample of the finite ones tells.

    Wide enough for most, it would be far too wide where points are dense: a camera sees what is near four to twenty
    times as densely as what is far. To try again with twice the edge costs less.
    """
    sample = np.linspace(0, finite - 1, _SAMPLE).astype(np.int64)
    farthest = _choose(cloud.words, cloud.layout, sample)
    if farthest > _FARTHEST:
        raise GeometryError(f"a point is {farthest:.3g} m away; expected at most {_FARTHEST:g} m: remove it with a box")
    reach = _reaches(cloud.words, cloud.layout, sample, count, room)
    return max(float(np.median(reach)), farthest * 1e-5, 1e-6)


@njit(cache=True, nogil=True)
def _choose(words: NDArray[np.float32], layout: Layout, sample: NDArray[np.int64]) -> float:
    """Turn ascending numbers among the finite points into numbers among all; returns the greatest coordinate."""
    step, at_x, at_y, at_z = layout
    seen, chosen, farthest = 0, 0, 0.0
    for i in range(len(words) // step):
        x, y, z = abs(words[step * i + at_x]), abs(words[step * i + at_y]), abs(words[step * i + at_z])
        if x < np.inf and y < np.inf and z < np.inf:
            while chosen < len(sample) and sample[chosen] == seen:
                sample[chosen] = i
                chosen += 1
            seen += 1
            farthest = max(farthest, x, y, z)
    return farthest


@njit(cache=True, nogil=True)
def _reaches(
    words: NDArray[np.float32], layout: Layout, sample: NDArray[np.int64], count: int, squares: NDArray[np.float32]
) -> NDArray[np.float64]:
    """How far the `count`-th nearest point is from each of the sample; `squares` (N,) is room for distances."""
    step, at_x, at_y, at_z = layout
    point = np.empty(3, np.float32)
    x, y, z = words[at_x::step], words[at_y::step], words[at_z::step]
    reach = np.empty(len(sample))
    for k in range(len(sample)):
        point[0], point[1], point[2] = x[sample[k]], y[sample[k]], z[sample[k]]
        _squares(x, y, z, point, squares)
        reach[k] = math.sqrt(_limit_of_least(squares, count, np.nanmax(squares)))
    return reach


@njit(cache=True, nogil=True)
def _add_distances(
    xyz: NDArray[np.float32],
    starts: NDArray[np.int32],
    keys: NDArray[np.int64],
    order: NDArray[np.int32],
    edge: float,
    count: int,
    far: NDArray[np.float32],
) -> int:
    """Mean distance of the `count` nearest points, itself (0 m) not counted, where all are sure to lie in the block.

    Returns:
        For how many points they are not.
    """
    missing = 0
    room, squares, rows = np.empty((3, 1024), np.float32), np.empty(1024, np.float32), np.zeros(9, np.int64)
    inverse = 1.0 / edge
    for cell in range(len(keys)):
        unknown = False
        for i in range(starts[cell], starts[cell + 1]):
            unknown |= math.isnan(far[order[i]])
        if not unknown:
            continue
        room, found = block_around(xyz, starts, keys, cell, rows, room)
        if found < count:
            for i in range(starts[cell], starts[cell + 1]):
                missing += math.isnan(far[order[i]])
            continue
        squares = np.empty(room.shape[1], np.float32) if room.shape[1] > len(squares) else squares
        for i in range(starts[cell], starts[cell + 1]):
            if math.isnan(far[order[i]]):
                near = squares[:found]
                _squares(room[0], room[1], room[2], xyz[:, i], near)
                sure = np.float32(_sure(xyz[:, i], inverse, edge))
                last = _limit_of_least(near, count, sure * sure)
                if last < np.inf:
                    far[order[i]] = _sum_of_least(near, last, count) / (count - 1)
                else:
                    missing += 1
    return missing


@njit(cache=True, nogil=True)
def _sure(point: NDArray[np.float32], inverse: float, edge: float) -> float:
    """How far from a point its own and the 26 cells around reach at least; a little less, for the rounding."""
    least = np.inf
    for axis in range(3):
        place = point[axis] * inverse - np.floor(point[axis] * inverse)
        least = min(least, 1.0 + place, 2.0 - place)
    return least * edge * (1.0 - 1e-5)


@njit(cache=True, nogil=True)
def _squares(
    x: NDArray[np.float32],
    y: NDArray[np.float32],
    z: NDArray[np.float32],
    point: NDArray[np.float32],
    out: NDArray[np.float32],
) -> None:
    """Squared distances from a point."""
    px, py, pz = point[0], point[1], point[2]
    for i in range(len(out)):
        dx, dy, dz = x[i] - px, y[i] - py, z[i] - pz
        out[i] = dx * dx + dy * dy + dz * dz


@njit(cache=True, nogil=True, error_model="numpy")
def _limit_of_least(squares: NDArray[np.float32], count: int, most: Any) -> Any:
    """The `count`-th least of numbers >= 0, or one between it and the next; infinity where fewer are up to `most`.

    By counting those up to a limit, which takes one instruction for eight of them; no selection that swaps comes near.
    The limit is guessed in proportion (on a surface, as many points lie within a radius as its square says) and halved
    in turns, by its bits, which are ordered as the numbers are.
    """
    number = np.full(1, most, np.float32)
    bits = number.view(np.int32)
    low, high = np.int32(-1), bits[0]
    fewer, more = 0, _count_up_to(squares, number[0])
    below, above = np.float32(0), number[0]
    if more < count:
        return np.float32(np.inf)
    turn = 0
    while more > count and high - low > 1:
        number[0] = below + (above - below) * np.float32((count - fewer + 0.5) / (more - fewer))
        if turn & 1 or not low < bits[0] < high:
            bits[0] = low + (high - low) // 2
        turn += 1
        found = _count_up_to(squares, number[0])
        if found >= count:
            high, above, more = bits[0], number[0], found
        else:
            low, below, fewer = bits[0], number[0], found
    return above


@njit(cache=True, nogil=True)
def _count_up_to(squares: NDArray[np.float32], limit: Any) -> Any:
    count = np.int32(0)
    for i in range(len(squares)):
        count += np.int32(1) if squares[i] <= limit else np.int32(0)
    return np.int64(count)


@njit(cache=True, nogil=True, fastmath={"reassoc", "nsz", "contract"})  # a sum in any order is as good
def _sum_of_least(squares: NDArray[np.float32], last: Any, count: int) -> float:
    """Sum of the roots of the `count` least squares, which are those up to `last`, but for ties."""
    total, used = np.float32(0), np.float32(0)
    for i in range(len(squares)):
        near = squares[i] <= last
        total += np.sqrt(squares[i]) if near else np.float32(0)
        used += np.float32(1) if near else np.float32(0)
    return float(total) - (float(used) - count) * math.sqrt(last)


@njit(cache=True, nogil=True)
def _crowded(
    xyz: NDArray[np.float32],
    starts: NDArray[np.int32],
    keys: NDArray[np.int64],
    index: NDArray[np.int32],
    radius: float,
    least: int,
    keep: NDArray[np.bool_],
) -> None:
    """Mark the points with so many, themselves included, within the radius."""
    limit = np.float32(radius) * np.float32(radius)
    room, rows = np.empty((3, 1024), np.float32), np.zeros(9, np.int64)
    for cell in range(len(keys)):
        room, count = block_around(xyz, starts, keys, cell, rows, room)
        if count < least:
            continue
        for i in range(starts[cell], starts[cell + 1]):
            near = 0
            for start in range(0, count, 256):
                end = min(start + 256, count)
                near += _within(room[0, start:end], room[1, start:end], room[2, start:end], xyz[:, i], limit)
                if near >= least:
                    keep[index[i]] = True
                    break


@njit(cache=True, nogil=True)
def _within(
    x: NDArray[np.float32], y: NDArray[np.float32], z: NDArray[np.float32], point: NDArray[np.float32], limit: Any
) -> Any:
    """How many points lie within a squared distance of a point."""
    px, py, pz = point[0], point[1], point[2]
    near = np.int32(0)
    for i in range(len(x)):
        dx, dy, dz = x[i] - px, y[i] - py, z[i] - pz
        near += np.int32(1) if dx * dx + dy * dy + dz * dz <= limit else np.int32(0)
    return np.int64(near)


def warm_up() -> None:
    """Compile the kernels of this file."""
    from zsight_core.points import from_xyz

    remove_radius_outliers(from_xyz(np.zeros((3, 3))), 1.0, 1)
    remove_statistical_outliers(from_xyz(np.eye(4, 3)), 2, 1.0)
