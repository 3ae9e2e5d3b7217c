"""What recognisers look at: the smooth pieces of a scene in the frame of the surface they stand over."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
from numba import njit

from zsight_core.bits import Bits, bits_of
from zsight_core.transform import inverse
from zsight_core.wholes import Cells

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from zsight_core.scene import Scene

__all__ = ["Clues", "Hypothesis", "Layer", "Piece", "clues_of", "ends_of", "warm_up"]

LEVEL = float(np.cos(np.radians(14.0)))
"""A piece whose mean normal is this near to up is flat: a top that may carry things."""

STEEP = 0.5
"""Upward part of the normal below which a cell cannot be of a top."""

HEIGHT_GATE = 0.004
"""Metres, besides two and a half standard deviations of depth, that a top may lie from where the shape says."""

SMALLEST_TOP = 20
"""Cells of a level piece that something may stand on."""

UNSEEN = 0.02
"""Metres over a surface from which something may stand on what is not seen."""

LOWEST_UNSEEN = 0.04
"""Metres; lower things show too little of their sides to tell what they stand on when that is not seen."""

REACH = 0.025
"""Metres along each axis between cells of one layer or clump that are neighbours in the image."""

SMALLEST_LAYER = 5
"""Cells."""


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


@dataclass(frozen=True, eq=False)
class Piece:
    """A smooth piece of surface, or all of a segment."""

    points: NDArray[np.float64]
    """(N, 3) metres in the support's frame."""
    normals: NDArray[np.float64]
    """(N, 3) unit, toward the camera, in the support's frame; zeros where unknown."""
    normal: NDArray[np.float64]
    """(3,) mean."""
    segment: int
    """Label of the segment, 0 for none."""
    support: int
    height: float
    """Metres: median of its points' heights."""
    low: NDArray[np.float64]
    """(3,) low corner."""
    high: NDArray[np.float64]
    """(3,)"""

    @property
    def is_level(self) -> bool:
        """True for a top."""
        return bool(self.normal[2] > LEVEL)


Top = tuple[float, "NDArray[np.float64]", "NDArray[np.float64]", int]
"""Height, low and high corner (2,) and support of a level piece."""


class Layer(NamedTuple):
    """Cells that hang together and lie at one height: a top, or what is seen of it."""

    xy: NDArray[np.float64]
    """(N, 2) metres in the support's frame."""
    support: int


class Stand(NamedTuple):
    """A level place on which something may stand."""

    base: float
    """Height over the surface, metres."""
    low: NDArray[np.float64]
    """(2,) low corner of what is seen of it, x and y, support's frame."""
    high: NDArray[np.float64]
    """(2,)"""
    support: int
    seen: bool
    """False where only what stands on it is seen."""


@dataclass(frozen=True, eq=False)
class Clues:
    """All pieces of a scene, and its segments as pieces."""

    cells: Cells
    grid: NDArray[np.int32]
    """(R, C) number of the cell at each place of the image, or -1."""
    pieces: list[Piece]
    segments: list[Piece]
    eyes: list[NDArray[np.float64]]
    """Per support the camera's place (3,), metres, in the support's frame."""
    gates: NDArray[np.float64]
    """(N,) metres; how far each cell may lie from the height a shape says."""
    tops: list[Top]
    """Height, low and high corner (2,) and support of each level piece that may carry something."""
    levels: list[list[float]]
    """Per support the heights on which something may stand."""
    bits: Bits
    carriers: list[Top]
    """Those tops above which something is seen."""
    depth: NDArray[np.float32]
    pinhole: tuple[float, float, float, float]
    noise: float
    frames: list[NDArray[np.float64]]
    """T_optical_support (4, 4) of each support."""
    corners: list[NDArray[np.float64]]
    """Per support the low and the high corner (2, 2), x and y, of what stands over it."""

    def bases(self, support: int) -> list[float]:
        """Heights over a surface on which something may stand: the surface itself and level tops, 4 mm apart."""
        return self.levels[support]

    def tops_of(self, tall: float, support: int) -> list[tuple[float, bool]]:
        """Heights over a surface on which something this tall may stand, and whether what carries it is seen.

        Besides the surface and level tops that is what lies the object's own height below any level piece.
        """
        known = [(base, True) for base in self.levels[support]]
        if tall < LOWEST_UNSEEN:
            return known
        for piece in self.pieces:
            base = piece.height - tall
            if piece.is_level and piece.support == support and base > UNSEEN and len(piece.points) >= 8:
                known += [] if any(abs(base - other) < 0.006 for other, _ in known) else [(base, False)]
        return known

    def near(self, place: NDArray[np.float64], reach: float, support: int) -> Clues:
        """What is within reach, metres, of a place (3,) over a support."""
        low, high = place - reach, place + reach
        cells, numbers = self.cells, np.flatnonzero(self._within(self.cells.points, low, high, self.cells.support, support))
        grid = np.full_like(self.grid, -1)
        grid[cells.row[numbers], cells.column[numbers]] = np.arange(len(numbers), dtype=np.int32)
        some = Cells(*(column[numbers] for column in cells[:5]), cells.start)
        bits = self._within(self.bits.points, low, high, self.bits.support, support)

        def close(pieces: list[Piece]) -> list[Piece]:
            return [p for p in pieces if p.support == support and (p.low < high).all() and (p.high > low).all()]

        def standing(tops: list[Top]) -> list[Top]:
            return [t for t in tops if t[3] == support and (t[1] < high[:2]).all() and (t[2] > low[:2]).all()]

        corners = [np.zeros((2, 2)) for _ in self.corners]
        corners[support] = np.array([np.maximum(self.corners[support][0], low[:2]), np.minimum(self.corners[support][1], high[:2])])
        return replace(
            self, cells=some, grid=grid, gates=self.gates[numbers], bits=Bits(*(column[bits] for column in self.bits)),
            pieces=close(self.pieces), segments=close(self.segments), tops=standing(self.tops),
            carriers=standing(self.carriers), corners=corners,
        )

    @staticmethod
    def _within(
        points: NDArray[np.float64], low: NDArray[np.float64], high: NDArray[np.float64], over: NDArray[np.int8], support: int
    ) -> NDArray[np.bool_]:
        inside: NDArray[np.bool_] = ((points > low) & (points < high)).all(axis=1) & (over == support)
        return inside

    def stands(self, tall: float) -> list[Stand]:
        """Where something this tall may stand: surfaces, level tops, and below level pieces of its own height."""
        found = [
            Stand(0.0, *corners, support, seen=True) for support, corners in enumerate(self.corners) if corners.any()
        ]
        found += [Stand(height, low, high, support, seen=True) for height, low, high, support in self.carriers]
        if tall < LOWEST_UNSEEN:
            return found
        for height, low, high, support in self.tops:
            base = height - tall
            if base > UNSEEN and not any(abs(base - other.base) < 0.006 and _overlap(low, high, other) for other in found):
                found.append(Stand(base, low, high, support, seen=False))
        return found

    def layers(self, height: float, support: int) -> list[Layer]:
        """What lies at a height over a surface, metres, without what is steep, in connected pieces."""
        cells = self.cells
        number = _layers(
            cells.row, cells.column, cells.points, cells.normals, cells.support, self.gates, self.grid, height, support
        )
        order = np.argsort(number, kind="stable")
        cuts = np.flatnonzero(np.diff(number[order])) + 1
        groups = np.split(order, cuts)
        return [
            Layer(np.ascontiguousarray(cells.points[members, :2]), support)
            for members in groups
            if len(members) >= SMALLEST_LAYER and number[members[0]] >= 0
        ]

    def supports(self) -> range:
        """Numbers of the surfaces."""
        return range(len(self.eyes))

    def is_carried(self, xy: NDArray[np.float64], reach: float, base: float, support: int) -> bool:
        """True where something at this height is seen within reach of a place (2,), or the base is the surface."""
        if base == 0:
            return True
        for height, low, high, over in self.tops:
            near = (xy > low - reach).all() and (xy < high + reach).all()
            if over == support and abs(height - base) < 0.006 and near:
                return True
        return False


_known: WeakKeyDictionary[Scene, Clues] = WeakKeyDictionary()


def clues_of(scene: Scene) -> Clues:
    """Collect the pieces of a scene, once."""
    clues = _known.get(scene)
    if clues is None:
        clues = _known[scene] = _collect(scene)
    return clues


def ends_of(values: NDArray[np.float64], share: float) -> tuple[float, float]:
    """Values (N,) that leave this share below and above."""
    ordered = np.sort(values)
    skip = int(share * (len(ordered) - 1) + 0.5)
    return float(ordered[skip]), float(ordered[-1 - skip])


def _collect(scene: Scene) -> Clues:
    cells, view = scene.cells, scene.view
    T_optical_cloud = inverse(view.T_cloud_optical)
    frames = [inverse(T_optical_cloud @ s.T_camera_support) for s in scene.supports]
    pieces: list[Piece] = []
    grouped: dict[int, list[NDArray[np.int64]]] = {}
    for k in range(len(cells.start) - 1):
        members = np.arange(cells.start[k], cells.start[k + 1])
        segment = int(scene.owner[k])
        pieces.append(_piece(cells, members, segment))
        grouped.setdefault(segment, []).append(members)
    segments = [_piece(cells, np.concatenate(m), segment) for segment, m in sorted(grouped.items()) if segment >= 2]
    grid = np.full(scene.patches.label.shape, -1, np.int32)
    grid[cells.row, cells.column] = np.arange(len(cells.row), dtype=np.int32)
    z = view.depth[cells.row * scene.patches.step, cells.column * scene.patches.step].astype(np.float64)
    gates = HEIGHT_GATE + 2.5 * scene.noise * z * z
    tops = [
        (piece.height, piece.points[:, :2].min(axis=0), piece.points[:, :2].max(axis=0), piece.support)
        for piece in sorted(pieces, key=lambda piece: piece.height)
        if piece.is_level and len(piece.points) >= SMALLEST_TOP
    ]
    levels = [[0.0] for _ in frames]
    for height, _, _, support in tops:
        if height > levels[support][-1] + 0.004:
            levels[support].append(height)
    eyes = [T[:3, 3] for T in frames]
    step = scene.patches.step
    bits = bits_of(cells, grid, np.ascontiguousarray(view.depth[::step, ::step]), gates)
    carriers = [top for top in tops if top[0] > UNSEEN / 2 and _carries(cells, *top)]
    corners = [_corners(cells, support) for support in range(len(frames))]
    return Clues(cells, grid, pieces, segments, eyes, gates, tops, levels, bits, carriers, view.depth, view.pinhole, scene.noise, [inverse(T) for T in frames], corners)


def _carries(cells: Cells, height: float, low: NDArray[np.float64], high: NDArray[np.float64], support: int) -> bool:
    """True where enough is seen above a top to be something."""
    xy = cells.points[:, :2]
    above = (cells.support == support) & (cells.points[:, 2] > height + 0.006)
    above &= ((xy > low - 0.01) & (xy < high + 0.01)).all(axis=1)
    return int(above.sum()) >= SMALLEST_TOP


def _overlap(low: NDArray[np.float64], high: NDArray[np.float64], stand: Stand) -> bool:
    return bool(stand.base > 0 and (low < stand.high + 0.01).all() and (high > stand.low - 0.01).all())


def _corners(cells: Cells, support: int) -> NDArray[np.float64]:
    """Low and high corner (2, 2), x and y, of the cells over a support."""
    xy = cells.points[cells.support == support, :2]
    return np.array([xy.min(axis=0), xy.max(axis=0)]) if len(xy) else np.zeros((2, 2))


def warm_up() -> None:
    """Compile the kernels (or load them from their cache)."""
    place, points, grid = np.zeros(1, np.int64), np.zeros((1, 3)), np.zeros((1, 1), np.int32)
    _connect(place, place, points, np.full(1, -1, np.int32), grid)
    _layers(place, place, points, points, np.zeros(1, np.int8), np.ones(1), grid, 0.0, 0)


def _piece(cells: Cells, members: NDArray[np.int64], segment: int) -> Piece:
    points, normals = cells.points[members], cells.normals[members]
    mean = normals.sum(axis=0)
    mean /= max(float(np.linalg.norm(mean)), 1e-9)
    return Piece(
        points, normals, mean, segment, int(cells.support[members[0]]), float(np.sort(points[:, 2])[len(points) // 2]), points.min(axis=0), points.max(axis=0)
    )


@njit(cache=True, nogil=True)
def _connect(
    row: NDArray[np.int64],
    column: NDArray[np.int64],
    points: NDArray[np.float64],
    number: NDArray[np.int32],
    grid: NDArray[np.int32],
) -> NDArray[np.int32]:
    """Number, in place, connected groups of the cells (N,) that are -1; image neighbours must be near in space."""
    queue = np.empty(len(row), np.int64)
    groups = 0
    for seed in range(len(row)):
        if number[seed] != -1:
            continue
        number[seed] = groups
        queue[0] = seed
        head, tail = 0, 1
        while head < tail:
            i = queue[head]
            head += 1
            for dr in range(-1, 2):
                for dc in range(-1, 2):
                    r, c = row[i] + dr, column[i] + dc
                    if not (0 <= r < grid.shape[0] and 0 <= c < grid.shape[1]):
                        continue
                    j = grid[r, c]
                    if j >= 0 and number[j] == -1:
                        apart = 0.0
                        for a in range(3):
                            apart = max(apart, abs(points[i, a] - points[j, a]))
                        if apart < REACH:
                            number[j] = groups
                            queue[tail] = j
                            tail += 1
        groups += 1
    return number


@njit(cache=True, nogil=True)
def _layers(
    row: NDArray[np.int64],
    column: NDArray[np.int64],
    points: NDArray[np.float64],
    normals: NDArray[np.float64],
    over: NDArray[np.int8],
    gates: NDArray[np.float64],
    grid: NDArray[np.int32],
    height: float,
    support: int,
) -> NDArray[np.int32]:
    """Number of the connected layer each cell belongs to (N,), or -1."""
    count = len(row)
    number = np.full(count, -2, np.int32)
    for i in range(count):
        inside = over[i] == support and abs(points[i, 2] - height) < gates[i]
        if inside and (normals[i, 2] > STEEP or not normals[i].any()):
            number[i] = -1
    return _connect(row, column, points, number, grid)
