"""One-point votes: every oriented bit of the scene says where a solid would have to stand to have such a bit there.

A surface holds two of a solid's rotations and its height. What is left, x, y and yaw, follows from one oriented bit: a
bit of surface of a certain height and steepness, or a bit of the rim of a level top, can only be one of those bits of
the model that have the same height and steepness, and the direction it faces gives the yaw. Where many bits agree,
the solid may stand (a generalised Hough transform, Ballard 1981, over x, y and yaw). Nothing is parted into objects
first, so that touching, stacked and half hidden things vote as well as others.
"""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numba import njit

from zsight_core.bits import CLASSES, CLASS_WIDTH, RIM

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from zsight_core.clues import Clues, Hypothesis, Stand
    from zsight_core.solid import Solid

__all__ = ["Pose", "hypotheses", "warm_up"]

CELL = 0.010
"""Metres; votes are counted in cells of this size in x and y."""

YAWS = 36
"""Votes are counted in so many steps of yaw."""

SPACING = 0.008
"""Metres between the bits of a model."""

LAYER = 0.008
"""Metres; bits are compared by height in layers of this thickness, overlapping by half."""

LEVEL_FACE = 0.95
"""Least upward part of the normal of a face that is the top of something."""

FEWEST = 6
"""Votes in a cell and its neighbours below which nothing is proposed."""

MOST = 300
"""Places a pose and height that are looked at."""

KEPT = 40
"""Places proposed a pose and height."""

PEEKS = 80
"""Points of the model at which a place is peeked at."""

PEEKED = 0.25
"""Share of them that must be there, less those that are seen through."""

SLACK = 0.012
"""Metres in depth within which a point is there."""

INSET = 0.0


class Pose(NamedTuple):
    """One way in which a solid rests."""

    R: NDArray[np.float64]
    """(3, 3) from the model to a frame with z up."""
    tall: float
    """Metres."""
    round: bool = False
    """True where turning it about the vertical changes nothing."""


class _Table(NamedTuple):
    """Bits of a solid in one pose, by layer and class."""

    start: NDArray[np.int64]
    """(layers * (CLASSES + 1) + 1,) where the bits of each begin."""
    xy: NDArray[np.float64]
    """(N, 2) metres from the model's origin."""
    azimuth: NDArray[np.float64]
    """(N,) radians."""
    layers: int
    reach: float
    """Metres from the model's origin to its farthest bit, seen from above."""
    below: float
    """Metres from the model's origin down to its foot."""
    points: NDArray[np.float64]
    """(M, 3) spread over the surface, from the model's origin, z from its foot."""
    normals: NDArray[np.float64]
    """(M, 3) outward."""


def hypotheses(solid: Solid, poses: Sequence[Pose], clues: Clues) -> list[Hypothesis]:
    """Where the solid may rest in one of the poses."""
    found: list[Hypothesis] = []
    for pose in poses:
        table = _table(solid.vertices.tobytes(), solid.faces.tobytes(), pose.R.tobytes(), pose.round)
        for stand in clues.stands(pose.tall):
            found += _standing(table, pose, stand, clues)
    return found


def _standing(table: _Table, pose: Pose, stand: Stand, clues: Clues) -> list[Hypothesis]:
    from zsight_core.clues import Hypothesis

    bits = clues.bits
    wider = 0.6 * table.reach
    window = np.array([stand.low - wider, stand.high + wider])
    votes = _vote(
        bits.points, bits.azimuth, bits.kind, bits.support, stand.support, stand.base,
        table.start, table.xy, table.azimuth, table.layers, window, table.reach, 1 if pose.round else YAWS,
    )
    peaks = _peaks(votes, FEWEST, MOST)
    if not len(peaks):
        return []
    places = np.column_stack([window[0, 0] + peaks[:, 1] * CELL, window[0, 1] + peaks[:, 2] * CELL, peaks[:, 3] * (2 * np.pi / YAWS)])
    places, scores = _best_places(
        clues.depth, clues.pinhole, clues.frames[stand.support], table.points, table.normals, places, stand.base,
        clues.noise, KEPT,
    )
    found = []
    for k in range(len(places)):
        x, y, yaw = places[k]
        c, s = np.cos(yaw), np.sin(yaw)
        T = np.eye(4)
        T[:3, :3] = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ pose.R
        T[:3, 3] = x, y, stand.base + table.below
        found.append(Hypothesis(T, stand.base, stand.support, turns=not pose.round, carried=stand.seen))
    return found


@lru_cache(maxsize=256)
def _table(vertices: bytes, faces: bytes, rotation: bytes, is_round: bool) -> _Table:
    """Bits of a solid."""
    corners = np.frombuffer(vertices).reshape(-1, 3) @ np.frombuffer(rotation).reshape(3, 3).T
    triangles = corners[np.frombuffer(faces, np.int32).reshape(-1, 3)]
    points, normals = _scatter(triangles)
    some = np.linspace(0, len(points) - 1, min(len(points), PEEKS)).astype(np.int64)
    few, ways = points[some], normals[some]
    rim, outward = _rims(triangles)
    low = float(corners[:, 2].min())
    if is_round:  # one meridian stands for all
        points, normals = _turned_to_front(points, normals)
        rim, outward = _turned_to_front(rim, outward)
    steep = np.hypot(normals[:, 0], normals[:, 1]) > 0.3
    points, normals = points[steep], normals[steep]
    angle = np.arccos(np.clip(normals[:, 2], -1, 1)) / CLASS_WIDTH
    everything = np.concatenate([points, points, rim])
    azimuth = np.concatenate([np.tile(np.arctan2(normals[:, 1], normals[:, 0]), 2), np.arctan2(outward[:, 1], outward[:, 0])])
    kinds = np.concatenate([np.floor(angle + 0.25), np.floor(angle - 0.25), np.full(len(rim), RIM)]).astype(np.int64)
    heights = (everything[:, 2] - low) / LAYER
    layers = int(heights.max()) + 3
    keys, members = [], []
    for shift in (0.25, 0.75):
        layer = np.floor(heights + shift).astype(np.int64)
        keys.append(layer * (CLASSES + 1) + kinds)
        members.append(np.arange(len(everything)))
    key, member = np.concatenate(keys), np.concatenate(members)
    inside = (kinds[member] >= 0)
    key, member = key[inside], member[inside]
    unique = np.unique(np.column_stack([key, everything[member, :2].round(4) * 1e4, azimuth[member].round(3) * 1e3]), axis=0, return_index=True)[1]
    key, member = key[unique], member[unique]
    order = np.argsort(key, kind="stable")
    start = np.searchsorted(key[order], np.arange(layers * (CLASSES + 1) + 1))
    chosen = member[order]
    reach = float(np.linalg.norm(corners[:, :2], axis=1).max()) + CELL
    few = few - np.array([0.0, 0.0, low]) - INSET * ways
    return _Table(start, np.ascontiguousarray(everything[chosen, :2]), azimuth[chosen], layers, reach, -low, few, ways)


def _turned_to_front(
    points: NDArray[np.float64], ways: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Points (N, 3) and the ways they face, each turned about z so that it lies over the x axis, without repetitions."""
    far, level = np.hypot(points[:, 0], points[:, 1]), np.hypot(ways[:, 0], ways[:, 1])
    sign = np.where((points[:, :2] * ways[:, :2]).sum(axis=1) < 0, -1.0, 1.0)
    turned = np.column_stack([far * sign, np.zeros(len(far)), points[:, 2]])
    facing = np.column_stack([level, np.zeros(len(far)), *ways[:, 2:].T])
    key = np.column_stack([turned / SPACING, facing * 4]).round()
    chosen = np.sort(np.unique(key, axis=0, return_index=True)[1])
    return turned[chosen], facing[chosen]


def _scatter(triangles: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Points (N, 3) about SPACING apart on the triangles (F, 3, 3), and their normals."""
    points, normals = [], []
    for a, b, c in triangles:
        across = np.cross(b - a, c - a)
        area = float(np.linalg.norm(across)) / 2
        if area < 1e-12:
            continue
        n = max(1, round(float(np.sqrt(2 * area)) / SPACING))
        u, v = np.meshgrid((np.arange(n) + 1 / 3) / n, (np.arange(n) + 1 / 3) / n)
        keep = (u + v < 1).ravel()
        u, v = u.ravel()[keep], v.ravel()[keep]
        there = a + np.outer(u, b - a) + np.outer(v, c - a)
        points.append(there)
        normals.append(np.tile(across / (2 * area), (len(there), 1)))
    return _thinned(np.concatenate(points), np.concatenate(normals))


def _thinned(points: NDArray[np.float64], normals: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """One point a cube of SPACING and way to face: fine triangles would vote more often than large ones."""
    key = np.column_stack([np.floor(points / SPACING), np.round(normals * 2)])
    chosen = np.sort(np.unique(key, axis=0, return_index=True)[1])
    return points[chosen], normals[chosen]


def _rims(triangles: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Points (N, 3) on the borders of level faces that look up, and the level way outward (N, 2)."""
    across = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    level = triangles[across[:, 2] > LEVEL_FACE * np.maximum(np.linalg.norm(across, axis=1), 1e-12)]
    edges: dict[tuple[float, ...], tuple[NDArray[np.float64], NDArray[np.float64]]] = {}
    for corners in level.round(6):
        for k in range(3):
            a, b = corners[k], corners[(k + 1) % 3]
            if edges.pop((*b, *a), None) is None:
                edges[(*a, *b)] = (a, b)
    points, outward = [np.zeros((0, 3))], [np.zeros((0, 2))]
    for a, b in edges.values():
        length = float(np.linalg.norm(b - a))
        n = max(1, round(length / SPACING))
        there = a + np.outer((np.arange(n) + 0.5) / n, b - a)
        points.append(there)
        outward.append(np.tile(np.array([b[1] - a[1], a[0] - b[0]]) / max(length, 1e-12), (n, 1)))
    return np.concatenate(points), np.concatenate(outward)


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
    layers: int,
    window: NDArray[np.float64],
    reach: float,
    yaws: int,
) -> NDArray[np.int16]:
    """Votes (YAWS, rows, columns) for the place of the model's origin within the window, low and high corner (2, 2)."""
    columns = int((window[1, 0] - window[0, 0]) / CELL) + 3
    rows = int((window[1, 1] - window[0, 1]) / CELL) + 3
    votes = np.zeros((yaws, rows, columns), np.int16)
    cosines, sines = np.empty(720), np.empty(720)
    for k in range(720):
        cosines[k], sines[k] = np.cos(k * np.pi / 360), np.sin(k * np.pi / 360)
    x0, y0 = window[0, 0], window[0, 1]
    for i in range(len(points)):
        if over[i] != support:
            continue
        if not (x0 - reach < points[i, 0] < window[1, 0] + reach and y0 - reach < points[i, 1] < window[1, 1] + reach):
            continue
        layer = int(np.floor((points[i, 2] - base) / LAYER + 0.5))
        if layer < 0 or layer >= layers:
            continue
        key = layer * (CLASSES + 1) + kind[i]
        for j in range(start[key], start[key + 1]):
            turn = (azimuth[i] - model_azimuth[j]) * (360 / np.pi)
            fine = int(np.floor(turn + 0.5)) % 720
            x = points[i, 0] - (cosines[fine] * xy[j, 0] - sines[fine] * xy[j, 1])
            y = points[i, 1] - (sines[fine] * xy[j, 0] + cosines[fine] * xy[j, 1])
            column, row = int((x - x0) / CELL + 0.5), int((y - y0) / CELL + 0.5)
            yaw = ((fine * yaws + 360) // 720) % yaws
            if 0 <= row < rows and 0 <= column < columns:
                votes[yaw, row, column] += 1
    return votes


@njit(cache=True, nogil=True)
def _peaks(votes: NDArray[np.int16], fewest: int, most: int) -> NDArray[np.float64]:  # noqa: C901  one compiled loop
    """Most agreed places (N, 4): votes there and around, column, row and yaw as fractions of cells; best first."""
    yaws, rows, columns = votes.shape
    highest = votes.max()
    least = max(2, highest // 20)
    total = 0
    for y in range(yaws):
        for r in range(rows):
            for c in range(columns):
                if votes[y, r, c] >= least:
                    total += 1
    around = 1 if yaws > 1 else 0
    sums, places = np.empty(total, np.int64), np.empty((total, 3), np.int64)
    count = 0
    for y in range(yaws):
        for r in range(1, rows - 1):
            for c in range(1, columns - 1):
                if votes[y, r, c] < least:
                    continue
                sum_ = 0
                for dy in range(-around, around + 1):
                    for dr in range(-1, 2):
                        for dc in range(-1, 2):
                            sum_ += votes[(y + dy) % yaws, r + dr, c + dc]
                sums[count] = sum_
                places[count, 0], places[count, 1], places[count, 2] = y, r, c
                count += 1
    order = np.argsort(-sums[:count], kind="mergesort")
    found = np.empty((most, 4))
    kept = np.empty((most, 3), np.int64)
    number = 0
    for k in order:
        if sums[k] < fewest or number == most:
            break
        y, r, c = places[k]
        near = False
        for q in range(number):
            turn = abs(kept[q, 0] - y)
            turn = min(turn, yaws - turn)
            if turn <= 2 and abs(kept[q, 1] - r) <= 2 and abs(kept[q, 2] - c) <= 2:
                near = True
                break
        if near:
            continue
        kept[number] = places[k]
        weight, sy, sr, sc = 0.0, 0.0, 0.0, 0.0
        for dy in range(-around, around + 1):
            for dr in range(-1, 2):
                for dc in range(-1, 2):
                    v = votes[(y + dy) % yaws, r + dr, c + dc]
                    weight += v
                    sy += v * dy
                    sr += v * dr
                    sc += v * dc
        found[number, 0] = sums[k]
        found[number, 1], found[number, 2], found[number, 3] = c + sc / weight, r + sr / weight, y + sy / weight
        number += 1
    return found[:number]


@njit(cache=True, nogil=True)
def _best_places(
    depth: NDArray[np.float32],
    pinhole: tuple[float, float, float, float],
    T_optical_support: NDArray[np.float64],
    points: NDArray[np.float64],
    normals: NDArray[np.float64],
    places: NDArray[np.float64],
    base: float,
    noise: float,
    most: int,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The best of some places (N, 3) after a climb, without repetitions, best first, and their scores."""
    scores = np.empty(len(places))
    for i in range(len(places)):
        scores[i] = _peek(depth, pinhole, T_optical_support, points, normals, places[i], base, noise)
    order = np.argsort(-scores, kind="mergesort")[:most]
    kept, heights = np.empty((most, 3)), np.empty(most)
    count = 0
    for i in order:
        if scores[i] < PEEKED / 2:
            break
        place, score = places[i].copy(), scores[i]
        step = 1.0
        while step > 0.4:
            better = False
            for axis in range(3):
                for sign in (-1.0, 1.0):
                    trial = place.copy()
                    trial[axis] += sign * step * (CELL / 2 if axis < 2 else np.pi / YAWS / 2)
                    reached = _peek(depth, pinhole, T_optical_support, points, normals, trial, base, noise)
                    if reached > score:
                        place, score, better = trial, reached, True
            if not better or step < 1:
                step /= 2
        if score < PEEKED:
            continue
        again = False
        for q in range(count):
            turn = abs(kept[q, 2] - place[2]) % (2 * np.pi)
            turn = min(turn, 2 * np.pi - turn)
            if turn < 0.12 and abs(kept[q, 0] - place[0]) < 0.006 and abs(kept[q, 1] - place[1]) < 0.006:
                again = True
        if not again:
            kept[count], heights[count] = place, score
            count += 1
    order = np.argsort(-heights[:count], kind="mergesort")
    return kept[order], heights[order]


@njit(cache=True, nogil=True)
def _peek(
    depth: NDArray[np.float32],
    pinhole: tuple[float, float, float, float],
    T_optical_support: NDArray[np.float64],
    points: NDArray[np.float64],
    normals: NDArray[np.float64],
    place: NDArray[np.float64],
    base: float,
    noise: float,
) -> float:
    """Share of the facing points of the model that are there, less twice those seen through, at a place (3,)."""
    fx, fy, cx, cy = pinhole
    height, width = depth.shape
    T = T_optical_support
    c, s = np.cos(place[2]), np.sin(place[2])
    facing, there, score = 0, 0, 0.0
    for k in range(len(points)):
        x = c * points[k, 0] - s * points[k, 1] + place[0]
        y = s * points[k, 0] + c * points[k, 1] + place[1]
        z = points[k, 2] + base
        nx, ny, nz = c * normals[k, 0] - s * normals[k, 1], s * normals[k, 0] + c * normals[k, 1], normals[k, 2]
        px = T[0, 0] * x + T[0, 1] * y + T[0, 2] * z + T[0, 3]
        py = T[1, 0] * x + T[1, 1] * y + T[1, 2] * z + T[1, 3]
        pz = T[2, 0] * x + T[2, 1] * y + T[2, 2] * z + T[2, 3]
        qx = T[0, 0] * nx + T[0, 1] * ny + T[0, 2] * nz
        qy = T[1, 0] * nx + T[1, 1] * ny + T[1, 2] * nz
        qz = T[2, 0] * nx + T[2, 1] * ny + T[2, 2] * nz
        if pz < 0.05 or qx * px + qy * py + qz * pz > -0.15 * pz:
            continue
        u, v = int(fx * px / pz + cx + 0.5), int(fy * py / pz + cy + 0.5)
        if not (0 <= u < width and 0 <= v < height) or depth[v, u] <= 0:
            continue
        facing += 1
        off = (depth[v, u] - pz) / (SLACK + 3 * noise * pz * pz)
        if abs(off) < 1:
            there += 1
            score += 1 - 0.5 * off * off
        elif off > 0:
            score -= 2
    return score / facing if there >= 4 else -2.0


def warm_up() -> None:
    """Compile the kernels (or load them from their cache)."""
    one, kind = np.zeros(1), np.zeros(1, np.int8)
    start = np.array([0, 1])
    votes = _vote(np.zeros((1, 3)), one, kind, kind, 0, 5.0, start, np.zeros((1, 2)), one, 1, np.zeros((2, 2)), 0.1, 1)
    _peaks(votes, 1, 1)
    depth, point = np.ones((4, 4), np.float32), np.zeros((1, 3))
    _best_places(depth, (1.0, 1.0, 0.0, 0.0), np.eye(4), point, point, point, 0.0, 1e-3, 1)
