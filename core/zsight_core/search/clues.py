"""What recognisers look at: oriented bits of a scene, and the places on which something may stand."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple
from weakref import WeakKeyDictionary

import numpy as np

from zsight_core.jit import njit
from zsight_core.search.bits import Bits, bits_of
from zsight_core.transform import inverse

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from zsight_core.scene import Scene
    from zsight_core.wholes import Cells

__all__ = ["NOTHING", "Clues", "Hypothesis", "Piece", "Stand", "clues_of", "warm_up"]

LEVEL = float(np.cos(np.radians(14.0)))
"""A patch whose mean normal is this near to up is flat: a top that may carry things."""

HEIGHT_GATE = 0.004
"""Metres, besides two and a half standard deviations of depth, by which cells of one top may differ in height."""

SMALLEST_TOP = 20
"""Cells of a patch that something may stand on, or that may be of something that stands on what is not seen."""

LOWEST_CARRIER = 0.01
"""Metres over a surface from which a top may carry something."""

UNSEEN = 0.015
"""Metres over a surface from which something may stand on what is not seen."""

LOWEST_UNSEEN = 0.015
"""Metres; lower things show too little of their sides to tell what they stand on when that is not seen."""

ONE_HEIGHT = 0.006
"""Metres within which two heights are one."""

EXPLAINED = 0.8
"""Share of a patch's cells that are explained from which nothing else is thought to end at its height."""

AROUND = 0.01
"""Metres beyond a place that still count as of it."""


class Hypothesis(NamedTuple):
    """A solid might stand here."""

    T_support_model: NDArray[np.float64]
    """(4, 4) in the frame of the surface."""
    base: float
    """Height of its foot over the surface, metres; above 0 where it stands on another object."""
    support: int
    """Number of the surface."""
    turns: bool
    """True where its yaw can be seen; False for a shape that looks the same from all around."""
    carried: bool = True
    """False where nothing is seen that it could stand on: its own lower edges must then be seen."""


class Piece(NamedTuple):
    """All of a segment."""

    points: NDArray[np.float64]
    """(N, 3) metres in the support's frame."""
    segment: int
    """Its label."""
    support: int
    low: NDArray[np.float64]
    """(3,) low corner of a box around the points."""
    high: NDArray[np.float64]
    """(3,)"""

    def beyond(self, place: NDArray[np.float64]) -> NDArray[np.float64]:
        """Metres (K,) along each axis from the box around the points to a place (K,), zero within."""
        k = len(place)
        outside: NDArray[np.float64] = np.maximum(np.maximum(self.low[:k] - place, place - self.high[:k]), 0.0)
        return outside


class Top(NamedTuple):
    """Where a patch reaches its height."""

    height: float
    """Metres over the surface."""
    low: NDArray[np.float64]
    """(2,) low corner of what is seen of it, x and y, support's frame, metres."""
    high: NDArray[np.float64]
    """(2,)"""
    support: int

    def overlaps(self, other: Top | Stand) -> bool:
        """True where both are over one place."""
        apart = (self.low >= other.high + AROUND) | (self.high <= other.low - AROUND)
        return self.support == other.support and not apart.any()


class Stand(NamedTuple):
    """A level place on which something may stand."""

    base: float
    """Height over the surface, metres."""
    low: NDArray[np.float64]
    """(2,) low corner of what is seen of it, x and y, support's frame, metres."""
    high: NDArray[np.float64]
    """(2,)"""
    support: int
    seen: bool
    """False where only what stands on it is seen."""


@dataclass(frozen=True, eq=False)
class Clues:
    """What there is to see in a scene, or in a part of it."""

    bits: Bits
    surfaces: list[Stand]
    """The support surfaces where something stands on them."""
    carriers: list[Stand]
    """Level tops above which something is seen."""
    crests: list[Top]
    """Highest places of all patches, each once."""
    segments: list[Piece]
    depth: NDArray[np.float32]
    """(H, W) metres; 0 where nothing was measured."""
    pinhole: tuple[float, float, float, float]
    noise: float
    """Standard deviation of 1 / z, 1/m."""
    frames: list[NDArray[np.float64]]
    """T_optical_support (4, 4) of each support."""
    pixels: NDArray[np.int64]
    """(C,) number of the pixel of each cell."""
    tops: list[tuple[Top, slice]]
    """Where all patches reach their heights, and which cells are theirs."""
    middles: tuple[NDArray[np.float64], NDArray[np.float64]] = (np.full(2, -np.inf), np.full(2, np.inf))
    """Low and high corner (2,) between which the middle of what stands here must be, x and y, metres."""
    heights: tuple[float, float] = (-np.inf, np.inf)
    """Metres over its surface between which something that stands here must reach."""

    @cached_property
    def stacked(self) -> NDArray[np.float64]:
        """Frames (S, 4, 4)."""
        return np.array(self.frames).reshape(-1, 4, 4)

    def near(
        self,
        place: NDArray[np.float64],
        reach: float,
        apart: float,
        support: int,
        heights: tuple[float, float],
    ) -> Clues:
        """What is near a place over a support.

        Args:
            place: (2,) x and y in the support's frame, metres.
            reach: metres to the farthest bits.
            apart: metres to the farthest middle of what may stand there.
            support: number of the support.
            heights: metres between which something that stands there must reach.
        """
        low, high = place - reach, place + reach
        near = ((self.bits.points[:, :2] > low) & (self.bits.points[:, :2] < high)).all(axis=1)
        near &= self.bits.support == support
        here = Top(0.0, place - apart, place + apart, support)
        return replace(
            self,
            bits=self.bits.only(near),
            surfaces=[stand for stand in self.surfaces if here.overlaps(stand)],
            carriers=[stand for stand in self.carriers if here.overlaps(stand)],
            crests=[top for top in self.crests if here.overlaps(top)],
            middles=(here.low, here.high),
            heights=heights,
        )

    def without(self, explained: NDArray[np.bool_]) -> Clues:
        """What is left where some pixels are explained.

        Args:
            explained: (H * W,) True for pixels that show what is known to be there.
        """
        cells = explained[self.pixels]
        left = ~cells[self.bits.cell]
        tops = [(top, cells_of) for top, cells_of in self.tops if cells[cells_of].mean() < EXPLAINED]
        return replace(
            self,
            bits=self.bits.only(left),
            tops=tops,
            crests=_each_once([top for top, _ in tops]),
        )

    def stands(self, tall: float) -> list[Stand]:
        """Where something this tall may stand: surfaces, level tops, and its own height below what is seen."""
        seen = [*self.surfaces, *self.carriers]
        found = seen.copy()
        if tall >= LOWEST_UNSEEN:
            for top in self.crests:  # none of which is near another one
                base = top.height - tall
                if base > UNSEEN and not any(abs(base - s.base) < ONE_HEIGHT and top.overlaps(s) for s in seen):
                    found.append(Stand(base, top.low, top.high, top.support, seen=False))
        low, high = self.heights
        return [stand for stand in found if stand.base < high and stand.base + tall > low]


NOTHING = Clues(
    Bits(
        np.zeros((0, 3)),
        np.zeros(0),
        np.zeros((0, 2)),
        np.zeros(0, np.int8),
        np.zeros(0, np.int8),
        np.zeros(0, np.int32),
    ),
    [],
    [],
    [],
    [],
    np.zeros((1, 1), np.float32),
    (1.0, 1.0, 0.0, 0.0),
    1e-3,
    [],
    np.zeros(0, np.int64),
    [],
)
"""The clues of a scene in which nothing is seen."""

_known: WeakKeyDictionary[Scene, Clues] = WeakKeyDictionary()


def clues_of(scene: Scene) -> Clues:
    """Collect the clues of a scene, once."""
    clues = _known.get(scene)
    if clues is None:
        clues = _known[scene] = _collect(scene)
    return clues


def _collect(scene: Scene) -> Clues:
    cells, view, step = scene.cells, scene.view, scene.patches.step
    depth = np.ascontiguousarray(view.depth[::step, ::step])
    z = depth[cells.row, cells.column].astype(np.float64)
    grid = np.full(scene.patches.label.shape, -1, np.int32)
    grid[cells.row, cells.column] = np.arange(len(cells.row), dtype=np.int32)
    T_optical_cloud, tops = inverse(view.T_cloud_optical), _tops(cells)
    return Clues(
        bits=bits_of(cells, grid, depth, HEIGHT_GATE + 2.5 * scene.noise * z * z),
        surfaces=[_occupied(cells, k) for k in range(len(scene.supports)) if (cells.support == k).any()],
        carriers=[Stand(*top, seen=True) for top, _, level in tops if level and _carries(cells, top)],
        crests=_each_once([top for top, _, _ in tops]),
        segments=_segments(cells, scene.owner),
        depth=view.depth,
        pinhole=view.pinhole,
        noise=scene.noise,
        frames=[T_optical_cloud @ support.T_camera_support for support in scene.supports],
        pixels=(cells.row * view.depth.shape[1] + cells.column) * step,
        tops=[(top, cells_of) for top, cells_of, _ in tops],
    )


def _tops(cells: Cells) -> list[tuple[Top, slice, bool]]:
    """Where each large patch reaches its height, which cells are its own, and whether it is level."""
    facts = _facts(cells.start, cells.points, cells.normals)
    return [
        (Top(float(fact[0]), fact[2:4], fact[4:], int(cells.support[first])), slice(first, end), bool(fact[1]))
        for fact, first, end in zip(facts, cells.start[:-1].tolist(), cells.start[1:].tolist(), strict=True)
        if fact[0] > -np.inf
    ]


def _each_once(tops: list[Top]) -> list[Top]:
    """Those that repeat no earlier one."""
    if not tops:
        return []
    corners = np.array([(*top.low, *top.high) for top in tops])
    first = _firsts(np.array([top.height for top in tops]), corners, np.array([top.support for top in tops]))
    return [top for top, is_first in zip(tops, first.tolist(), strict=True) if is_first]


@njit(cache=True, nogil=True, error_model="numpy")
def _firsts(
    heights: NDArray[np.float64], corners: NDArray[np.float64], supports: NDArray[np.int64]
) -> NDArray[np.bool_]:
    """True (N,) for tops that repeat no earlier one that is; corners (N, 4) are low x y and high x y."""
    first = np.ones(len(heights), np.bool_)
    for i in range(len(heights)):
        for k in range(i):
            if not first[k] or supports[i] != supports[k] or abs(heights[i] - heights[k]) >= ONE_HEIGHT:
                continue
            apart = False
            for a in range(2):
                apart |= corners[i, a] >= corners[k, 2 + a] + AROUND or corners[i, 2 + a] <= corners[k, a] - AROUND
            first[i] &= apart
    return first


@njit(cache=True, nogil=True, error_model="numpy")
def _facts(start: NDArray[np.int64], points: NDArray[np.float64], normals: NDArray[np.float64]) -> NDArray[np.float64]:
    """Height, whether it is level, low and high corner x y (K, 6) of each patch; -inf for the height of small ones."""
    facts = np.zeros((len(start) - 1, 6))
    for p in range(len(start) - 1):
        size = start[p + 1] - start[p]
        facts[p, 0] = -np.inf
        if size < SMALLEST_TOP:
            continue
        facts[p, 2:4], facts[p, 4:6] = np.inf, -np.inf
        up = np.zeros(3)
        for i in range(start[p], start[p + 1]):
            for a in range(3):
                up[a] += normals[i, a]
            for a in range(2):
                facts[p, 2 + a] = min(facts[p, 2 + a], points[i, a])
                facts[p, 4 + a] = max(facts[p, 4 + a], points[i, a])
        is_level = up[2] > LEVEL * max(np.sqrt((up * up).sum()), 1e-9)
        heights = np.sort(points[start[p] : start[p + 1], 2])
        facts[p, 0] = heights[int((0.5 if is_level else 0.95) * (size - 1))]
        facts[p, 1] = 1.0 if is_level else 0.0
    return facts


def _occupied(cells: Cells, support: int) -> Stand:
    """Where something stands over a support surface."""
    xy = cells.points[cells.support == support, :2]
    return Stand(0.0, xy.min(axis=0), xy.max(axis=0), support, seen=True)


def _carries(cells: Cells, top: Top) -> bool:
    """True where it is high enough to carry something, and enough is seen above it to be something."""
    if top.height <= LOWEST_CARRIER:
        return False
    low, high = top.low - AROUND, top.high + AROUND
    return _above(cells.points, cells.support, top.support, top.height + ONE_HEIGHT, low, high) >= SMALLEST_TOP


@njit(cache=True, nogil=True, error_model="numpy")
def _above(
    points: NDArray[np.float64],
    over: NDArray[np.int8],
    support: int,
    height: float,
    low: NDArray[np.float64],
    high: NDArray[np.float64],
) -> int:
    """Points (N, 3) over a support that are above a height and between two corners (2,)."""
    count = 0
    for i in range(len(points)):
        if over[i] == support and points[i, 2] > height:
            x, y = points[i, 0], points[i, 1]
            count += 1 if low[0] < x < high[0] and low[1] < y < high[1] else 0
    return count


def warm_up() -> None:
    """Compile the kernels (or load them from their cache)."""
    point, corner = np.zeros((1, 3)), np.zeros(2)
    _facts(np.array([0, 1]), point, point)
    _firsts(np.zeros(1), np.zeros((1, 4)), np.zeros(1, np.int64))
    _above(point, np.zeros(1, np.int8), 0, 0.0, corner, corner)


def _segments(cells: Cells, owner: NDArray[np.int32]) -> list[Piece]:
    """One piece a segment, in order of labels."""
    label = np.repeat(owner, np.diff(cells.start))
    return [
        Piece(points, int(segment), int(cells.support[members[0]]), points.min(axis=0), points.max(axis=0))
        for segment in np.unique(owner[owner >= 2])
        if len(members := np.flatnonzero(label == segment))
        for points in (cells.points[members],)
    ]
