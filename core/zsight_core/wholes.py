"""Segments made whole: parts of one object that do not meet in the image.

Three things part what belongs together. A hollow thing shows its inside across a jump in depth; something in front
cuts what is behind it in two; noise and handles leave crumbs along edges. Three rules join them again, each by what a
solid body on a surface must be like: insides belong to the rim they reach, two faces in one plane with something nearer
between them are one face, and what stands within the footprint of a higher thing is part of it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from zsight_core.jit import njit

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from zsight_core.segments import Patches

__all__ = ["Cells", "join_parts", "warm_up"]

CRUMB = 30
"""Cells; smaller segments next to a larger one are crumbs of it."""

HANDLE = 200
"""Cells; smaller segments on the side of a larger one of the same colour are handles of it."""

HANDLE_SHARE = 0.2
"""A handle has at most this share of the cells of what it is on."""

SAME_COLOUR = 40.0
"""Largest difference between the mean colours (0..255 a channel) of a handle and what it is on."""

SAME_HEIGHT = 0.015
"""Metres by which two parts of one rim or one top may differ in height."""

SAME_PLANE = 0.010
"""Metres by which two faces may miss each other's plane and still be one."""

PARALLEL = float(np.cos(np.radians(12.0)))
"""Least cosine between two pieces of one face."""

LEVEL = 0.9
"""Least upward part of the normal of a top."""

SMALLEST_FACE = 15
"""Cells of a piece of a face that something cuts in two."""

HOLLOW = 0.25
"""Mean cosine between level normals and the way to the middle from which a surface is the inside of something."""

OVERHANG = 0.004
"""Metres beyond a footprint that still count as within."""

WAYS = 24
"""Directions in which footprints are measured."""

_BIN = 0.0015
_BINS = 420


class Cells(NamedTuple):
    """The cells of all patches, patch by patch, in the frame of the support they stand over."""

    row: NDArray[np.int64]
    """(N,)"""
    column: NDArray[np.int64]
    """(N,)"""
    points: NDArray[np.float64]
    """(N, 3) metres."""
    normals: NDArray[np.float64]
    """(N, 3) unit, toward the camera; zeros where unknown."""
    support: NDArray[np.int8]
    """(N,)"""
    start: NDArray[np.int64]
    """(K + 1,) where each patch begins."""


class _Parts(NamedTuple):
    """What is known of each segment (S,) while they are made whole."""

    size: NDArray[np.int64]
    """Cells."""
    high: NDArray[np.float64]
    """Metres; 97 of 100 cells are lower."""
    hollow: NDArray[np.float64]
    reach: NDArray[np.float64]
    """(S, WAYS) metres; how far the footprint goes in each direction."""
    colour: NDArray[np.float64]
    """(S, 3) mean."""


@dataclass(eq=False)
class _Work:
    cells: Cells
    near: NDArray[np.int64]
    """(K, K) cells of one patch with the other within three cells."""
    colour: NDArray[np.float64] | None
    """(K, 3) mean colour of each patch."""
    owner: NDArray[np.int32]
    known: tuple[bytes, _Parts] | None = None
    """The owners for which parts was asked last, and what it was."""

    @cached_property
    def sums(self) -> tuple[NDArray[np.float64], NDArray[np.int32], NDArray[np.float64]]:
        """Of each patch: sums of x and y (K, 2), cells by height (K, bins), and reach (K, WAYS)."""
        return _sums(self.cells.start, self.cells.points)

    def parts(self) -> _Parts:
        state = self.owner.tobytes()
        if self.known is None or self.known[0] != state:
            colour = np.zeros((len(self.owner), 3)) if self.colour is None else self.colour
            cells = self.cells
            facts = _facts(cells.start, cells.points, cells.normals, self.owner, colour, self.sums)
            self.known = (state, _Parts(*facts))
        return self.known[1]

    def borders(self) -> NDArray[np.int64]:
        """(S, S) as near, for segments."""
        return _merge_borders(self.near, self.owner)


def join_parts(
    cells: Cells,
    patches: Patches,
    depth: NDArray[np.float32],
    owner: NDArray[np.int32],
    colour: NDArray[np.float64] | None = None,
) -> NDArray[np.int32]:
    """Join segments that are parts of one object.

    Args:
        cells: cells of the patches.
        patches: smooth pieces.
        depth: (R, C) of the cells, metres.
        owner: (K,) segment of each patch, from 0.
        colour: (K, 3) mean red, green, blue of each patch, or None.

    Returns:
        (K,) segment of each patch, from 0, some numbers unused.
    """
    work = _Work(cells, _near(patches.label, len(owner)), colour, owner.copy())
    for _ in range(3):
        before = work.owner.copy()
        _join_insides(work)
        _join_faces_cut_in_two(work, patches, depth)
        _join_crumbs(work)
        if (work.owner == before).all():
            break
    return work.owner


def warm_up() -> None:
    """Compile the kernels (or load them from their cache)."""
    label, owner = np.zeros((4, 4), np.int32), np.zeros(1, np.int32)
    points = np.zeros((16, 3))
    rows = np.repeat(np.arange(4), 4)
    cells = Cells(rows, rows, points, points, np.zeros(16, np.int8), np.array([0, 16]))
    depth = np.ones((8, 8), np.float32)[::2, ::2]
    work = _Work(cells, _near(label, 1), None, owner)
    work.borders()
    parts = work.parts()
    known = parts.size, parts.high, parts.reach, parts.colour, False, work.borders()
    _crumb(np.zeros(1, np.int64), 0, points, cells.start, owner, *known)
    _faces(cells.row, cells.column, points, points, cells.start, points[:1], points[:1], depth, owner, parts.high)


def _join_insides(work: _Work) -> None:
    """A hollow surface joins the neighbour that borders it most and reaches its rim."""
    parts, borders = work.parts(), work.borders()
    for number in np.flatnonzero((parts.hollow > HOLLOW) & (parts.size >= CRUMB)):
        fits = (borders[number] > 0) & (np.abs(parts.high - parts.high[number]) < SAME_HEIGHT) & (parts.size > 0)
        fits[number] = False
        if fits.any():
            best = int(np.argmax(np.where(fits, borders[number], 0)))
            work.owner[work.owner == number] = best
            parts, borders = work.parts(), work.borders()


def _join_faces_cut_in_two(work: _Work, patches: Patches, depth: NDArray[np.float32]) -> None:
    """Two segments with a piece each of one face, and something nearer between, are one object."""
    cells = work.cells
    _faces(
        cells.row,
        cells.column,
        cells.points,
        cells.normals,
        cells.start,
        patches.mean_normal,
        patches.centroid,
        depth,
        work.owner,
        work.parts().high,
    )


def _join_crumbs(work: _Work) -> None:
    """What stands within the footprint of a higher neighbour, small bits beside one, and handles, are part of it."""
    parts, borders, cells = work.parts(), work.borders(), work.cells
    order, place, coloured = np.argsort(parts.size, kind="stable"), 0, work.colour is not None
    while True:
        known = parts.size, parts.high, parts.reach, parts.colour, coloured, borders
        place, other = _crumb(order, place, cells.points, cells.start, work.owner, *known)
        if other < 0:
            return
        work.owner[work.owner == order[place]] = other
        parts, borders, place = work.parts(), work.borders(), place + 1


@njit(cache=True, nogil=True, error_model="numpy")
def _crumb(
    order: NDArray[np.int64],
    first: int,
    points: NDArray[np.float64],
    start: NDArray[np.int64],
    owner: NDArray[np.int32],
    size: NDArray[np.int64],
    high: NDArray[np.float64],
    reach: NDArray[np.float64],
    colour: NDArray[np.float64],
    coloured: bool,
    borders: NDArray[np.int64],
) -> tuple[int, int]:
    """Place in the order, from the first on, of a segment that is part of a larger one, and which; -1 where none is.

    Of each segment the larger neighbours are tried, those with the longest border first.
    """
    for place in range(first, len(order)):
        small = order[place]
        if size[small] == 0:
            continue
        left = borders[small].copy()
        while True:
            large, most = -1, 0
            for k in range(len(size)):
                if left[k] > most and size[k] > size[small]:
                    large, most = k, left[k]
            if large < 0:
                break
            left[large] = 0
            below = high[small] - high[large]
            if below > SAME_HEIGHT:
                continue
            within = _share_within(points, start, owner, small, reach[large])
            if (within > 0.85 and below < 0.005) or (size[small] < CRUMB and within > 0.3):
                return place, large
            if not coloured or size[small] > min(HANDLE, HANDLE_SHARE * size[large]):
                continue
            apart = 0.0
            for a in range(3):
                apart = max(apart, abs(colour[small, a] - colour[large, a]))
            if apart < SAME_COLOUR and most > 2 * np.sqrt(size[small]):
                return place, large
    return len(order), -1


@njit(cache=True, nogil=True, error_model="numpy")
def _near(label: NDArray[np.int32], count: int) -> NDArray[np.int64]:
    """Cells (K, K) of one patch that have the other as the next one within three cells in a row or column."""
    near = np.zeros((count, count), np.int64)
    for r in range(label.shape[0]):
        for c in range(label.shape[1]):
            a = label[r, c]
            if a < 0:
                continue
            for way in range(2):
                for apart in range(1, 4):
                    j, i = r + (apart, 0)[way], c + (0, apart)[way]
                    if j < label.shape[0] and i < label.shape[1] and label[j, i] >= 0:
                        b = label[j, i]
                        if a != b:
                            near[a, b] += 1
                            near[b, a] += 1
                        break
    return near


@njit(cache=True, nogil=True, error_model="numpy")
def _merge_borders(near: NDArray[np.int64], owner: NDArray[np.int32]) -> NDArray[np.int64]:
    """Sum near over the patches of each two segments."""
    count = len(owner)
    borders = np.zeros((count, count), np.int64)
    for p in range(count):
        for q in range(count):
            if owner[p] != owner[q]:
                borders[owner[p], owner[q]] += near[p, q]
    return borders


@njit(cache=True, nogil=True, error_model="numpy")
def _sums(
    start: NDArray[np.int64], points: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.int32], NDArray[np.float64]]:
    """Of each patch: sums of x and y (K, 2), cells by height (K, bins), and reach (K, WAYS)."""
    count = len(start) - 1
    middle, bins = np.zeros((count, 2)), np.zeros((count, _BINS), np.int32)
    reach = np.full((count, WAYS), -np.inf)
    ways = np.empty((WAYS, 2))
    for k in range(WAYS):
        ways[k, 0], ways[k, 1] = np.cos(2 * np.pi * k / WAYS), np.sin(2 * np.pi * k / WAYS)
    for p in range(count):
        for i in range(start[p], start[p + 1]):
            x, y, z = points[i, 0], points[i, 1], points[i, 2]
            middle[p, 0] += x
            middle[p, 1] += y
            bins[p, min(_BINS - 1, max(0, int(z / _BIN)))] += 1
            for k in range(WAYS):
                reach[p, k] = max(reach[p, k], x * ways[k, 0] + y * ways[k, 1])
    return middle, bins, reach


@njit(cache=True, nogil=True, error_model="numpy")
def _facts(  # noqa: C901  one compiled loop over patches and cells; splitting it would pass a dozen arrays around
    start: NDArray[np.int64],
    points: NDArray[np.float64],
    normals: NDArray[np.float64],
    owner: NDArray[np.int32],
    colour: NDArray[np.float64],
    sums: tuple[NDArray[np.float64], NDArray[np.int32], NDArray[np.float64]],
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """The fields of _Parts."""
    segments = len(owner)
    count, middle = np.zeros(segments, np.int64), np.zeros((segments, 2))
    bins = np.zeros((segments, _BINS), np.int64)
    reach, mean = np.full((segments, WAYS), -np.inf), np.zeros((segments, 3))
    for p in range(len(owner)):
        s = owner[p]
        size = start[p + 1] - start[p]
        count[s] += size
        for a in range(3):
            mean[s, a] += size * colour[p, a]
        for a in range(2):
            middle[s, a] += sums[0][p, a]
        for k in range(_BINS):
            bins[s, k] += sums[1][p, k]
        for k in range(WAYS):
            reach[s, k] = max(reach[s, k], sums[2][p, k])
    high = np.zeros(segments)
    for s in range(segments):
        if count[s] == 0:
            continue
        middle[s] /= count[s]
        mean[s] /= count[s]
        left = int(0.03 * count[s])
        k = _BINS - 1
        while k > 0 and left >= bins[s, k]:
            left -= bins[s, k]
            k -= 1
        high[s] = (k + 0.5) * _BIN
    inward, steep = np.zeros(segments), np.zeros(segments)
    for p in range(len(owner)):
        s = owner[p]
        for i in range(start[p], start[p + 1]):
            nx, ny = normals[i, 0], normals[i, 1]
            if nx * nx + ny * ny < 0.25:
                continue
            dx, dy = middle[s, 0] - points[i, 0], middle[s, 1] - points[i, 1]
            steep[s] += 1
            inward[s] += (nx * dx + ny * dy) / max(np.sqrt(dx * dx + dy * dy), 1e-6)
    hollow = np.full(segments, -1.0)
    for s in range(segments):
        if steep[s] > 20:
            hollow[s] = inward[s] / steep[s]
    return count, high, hollow, reach, mean


@njit(cache=True, nogil=True, error_model="numpy")
def _share_within(
    points: NDArray[np.float64],
    start: NDArray[np.int64],
    owner: NDArray[np.int32],
    segment: int,
    reach: NDArray[np.float64],
) -> float:
    """Share of a segment's cells that stand within a footprint given by its reach (WAYS,)."""
    inside, count = 0, 0
    ways = np.empty((WAYS, 2))
    for k in range(WAYS):
        j = (k * 5) % WAYS  # directions far apart first, to be out sooner
        ways[k, 0], ways[k, 1] = np.cos(2 * np.pi * j / WAYS), np.sin(2 * np.pi * j / WAYS)
    for p in range(len(owner)):
        if owner[p] != segment:
            continue
        for i in range(start[p], start[p + 1]):
            count += 1
            out = False
            for k in range(WAYS):
                if points[i, 0] * ways[k, 0] + points[i, 1] * ways[k, 1] > reach[(k * 5) % WAYS] + OVERHANG:
                    out = True
                    break
            if not out:
                inside += 1
    return inside / max(count, 1)


@njit(cache=True, nogil=True, error_model="numpy")
def _faces(
    row: NDArray[np.int64],
    column: NDArray[np.int64],
    points: NDArray[np.float64],
    normals: NDArray[np.float64],
    start: NDArray[np.int64],
    mean_normal: NDArray[np.float64],
    centroid: NDArray[np.float64],
    depth: NDArray[np.float32],
    owner: NDArray[np.int32],
    high: NDArray[np.float64],
) -> None:
    """Give two segments one number, in place, where they hold two pieces of one face with something nearer between."""
    count = len(owner)
    for p in range(count):
        for q in range(p + 1, count):
            if owner[p] == owner[q] or min(start[p + 1] - start[p], start[q + 1] - start[q]) < SMALLEST_FACE:
                continue
            if abs(high[owner[p]] - high[owner[q]]) > SAME_HEIGHT:
                continue
            cosine, off_p, off_q = 0.0, 0.0, 0.0
            for a in range(3):
                cosine += mean_normal[p, a] * mean_normal[q, a]
                off_p += mean_normal[p, a] * (centroid[q, a] - centroid[p, a])
                off_q += mean_normal[q, a] * (centroid[q, a] - centroid[p, a])
            if cosine < PARALLEL:
                continue
            if normals[start[p] : start[p + 1], 2].mean() > LEVEL:
                if not _nearer_between(row, column, start, depth, p, q):
                    continue
                same = _one_top(points[start[p] : start[p + 1]], points[start[q] : start[q + 1]])
            else:
                same = max(abs(off_p), abs(off_q)) < SAME_PLANE and _nearer_between(row, column, start, depth, p, q)
            if not same:
                continue
            old, new = owner[q], owner[p]
            for k in range(count):
                if owner[k] == old:
                    owner[k] = new


@njit(cache=True, nogil=True, error_model="numpy")
def _one_top(p: NDArray[np.float64], q: NDArray[np.float64]) -> bool:
    """True for two level patches (N, 3) of one height that share a straight edge."""
    if abs(np.median(p[:, 2]) - np.median(q[:, 2])) > SAME_HEIGHT / 2:
        return False
    for k in range(180):
        c, s = np.cos(k * np.pi / 90), np.sin(k * np.pi / 90)
        edge_p, length_p = _edge(p, c, s)
        edge_q, length_q = _edge(q, c, s)
        if abs(edge_p - edge_q) < 0.005 and min(length_p, length_q) > 0.025:
            return True
    return False


@njit(cache=True, nogil=True, error_model="numpy")
def _edge(xyz: NDArray[np.float64], c: float, s: float) -> tuple[float, float]:
    """How far points (N, 3) reach toward (c, s), and how long the edge there is."""
    reach = -np.inf
    for i in range(len(xyz)):
        reach = max(reach, c * xyz[i, 0] + s * xyz[i, 1])
    low, high = np.inf, -np.inf
    for i in range(len(xyz)):
        if c * xyz[i, 0] + s * xyz[i, 1] > reach - 0.007:
            along = c * xyz[i, 1] - s * xyz[i, 0]
            low, high = min(low, along), max(high, along)
    return reach, high - low


@njit(cache=True, nogil=True, error_model="numpy")
def _nearer_between(
    row: NDArray[np.int64],
    column: NDArray[np.int64],
    start: NDArray[np.int64],
    depth: NDArray[np.float32],
    p: int,
    q: int,
) -> bool:
    """True where the straight way in the image from one patch to the other passes only itself and nearer things."""
    r0, c0 = row[start[p] : start[p + 1]].mean(), column[start[p] : start[p + 1]].mean()
    r1, c1 = row[start[q] : start[q + 1]].mean(), column[start[q] : start[q + 1]].mean()
    w0, w1 = 0.0, 0.0
    for i in range(start[p], start[p + 1]):
        w0 += 1.0 / depth[row[i], column[i]]
    for i in range(start[q], start[q + 1]):
        w1 += 1.0 / depth[row[i], column[i]]
    w0, w1 = w0 / (start[p + 1] - start[p]), w1 / (start[q + 1] - start[q])
    steps = max(1, int(max(abs(r1 - r0), abs(c1 - c0))))
    farther, nearer = 0, 0
    for k in range(steps + 1):
        t = k / steps
        z = depth[int(np.floor(r0 + (r1 - r0) * t + 0.5)), int(np.floor(c0 + (c1 - c0) * t + 0.5))]
        if z <= 0:
            continue
        expected = 1.0 / (w0 + (w1 - w0) * t)
        if z > expected + 0.02:
            farther += 1
        elif z < expected - 0.015:
            nearer += 1
    return farther < 0.05 * (steps + 1) and nearer >= 3
