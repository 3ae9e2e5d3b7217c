"""Oriented bits of a model in one of the poses it rests in, sorted by what a bit of a scene shows of itself."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from zsight_core.jit import njit
from zsight_core.search.bits import CLASS_WIDTH, KINDS, RIM, STEEP_CELL

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from zsight_core.solid import Solid

__all__ = ["LAYER", "ModelBits", "model_bits"]

SPACING = 0.008
"""Metres between bits."""

LAYER = 0.008
"""Metres; bits are compared by height in layers of this thickness, overlapping by half."""

LEVEL_FACE = 0.95
"""Least upward part of the normal of a face that is the top of something."""

SAMPLES = 160
"""Points of the surface by which a place is peeked at."""

ORDERS = (4, 3, 2)
"""How many turns about the vertical to a full one are tried for symmetry."""

SAME = 1e-4
"""Metres within which a turned vertex is another one."""


class ModelBits(NamedTuple):
    """Bits of a solid in one pose, in a frame with z up: x and y from the model's origin, z from its foot."""

    start: NDArray[np.int64]
    """(layers * KINDS + 1,) where the bits of each layer and kind begin."""
    faced: NDArray[np.float32]
    """(3, N), one bit in a column: from it to the model's origin, seen from above, along the way it faces and to the
    left of that, metres; and the turn from that way to the model's x axis, as a share of a full one, 0..1."""
    layers: int
    order: int
    """Turns about the vertical to a full one that leave it as it is; only bits of the first such turn are here."""
    reach: float
    """Metres from the model's origin to its farthest bit, seen from above."""
    below: float
    """Metres from the model's origin down to its foot."""
    samples: NDArray[np.float32]
    """(7, M) points spread over the surface, metres, outward normals, and the products of both."""


class _Bits(NamedTuple):
    points: NDArray[np.float64]
    """(N, 3)"""
    ways: NDArray[np.float64]
    """(N, 3) unit, outward."""


def model_bits(solid: Solid, R: NDArray[np.float64], *, is_round: bool) -> ModelBits:
    """Bits of a solid that is turned by R (3, 3); of a round one those of one meridian stand for all."""
    return _model_bits(solid.vertices.tobytes(), solid.faces.tobytes(), R.astype(np.float64).tobytes(), is_round)


@lru_cache(maxsize=256)
def _model_bits(vertices: bytes, faces: bytes, rotation: bytes, is_round: bool) -> ModelBits:
    corners = np.frombuffer(vertices).reshape(-1, 3) @ np.frombuffer(rotation).reshape(3, 3).T
    below = -float(corners[:, 2].min())
    corners = corners + np.array([0.0, 0.0, below])
    triangles = corners[np.frombuffer(faces, np.int32).reshape(-1, 3)]
    surface, rim = _scattered(triangles), _rim(triangles)
    some = np.linspace(0, len(surface.points) - 1, min(len(surface.points), SAMPLES)).astype(np.int64)
    some = np.random.default_rng(0).permutation(some)  # any part of them is spread over the surface as well
    along = (surface.points[some] * surface.ways[some]).sum(axis=1)
    samples = np.column_stack([surface.points[some], surface.ways[some], along]).T.astype(np.float32, order="C")
    order = _order(corners)
    if is_round:
        surface, rim = _meridian(surface), _meridian(rim)
    else:
        surface, rim = _first_turn(surface, order), _first_turn(rim, order)
    key, bits, layers = _sorted(surface, rim)
    start = np.searchsorted(key, np.arange(layers * KINDS + 1))
    reach = float(np.linalg.norm(corners[:, :2], axis=1).max()) + SPACING
    return ModelBits(start, _faced(bits), layers, order, reach, below, samples)


def _faced(bits: _Bits) -> NDArray[np.float32]:
    x, y = bits.points[:, 0], bits.points[:, 1]
    across = np.maximum(np.hypot(bits.ways[:, 0], bits.ways[:, 1]), 1e-12)
    c, s = bits.ways[:, 0] / across, bits.ways[:, 1] / across
    turn = -np.arctan2(bits.ways[:, 1], bits.ways[:, 0]) / (2 * np.pi) % 1.0
    return np.stack([-(c * x + s * y), s * x - c * y, turn]).astype(np.float32)


def _order(corners: NDArray[np.float64]) -> int:
    """The largest number of turns to a full one that put all corners (V, 3) onto corners."""
    upwards = corners[np.argsort(corners[:, 2], kind="stable")]
    for order in ORDERS:
        c, s = np.cos(2 * np.pi / order), np.sin(2 * np.pi / order)
        if _lie_on(upwards @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]), upwards, SAME):
            return order
    return 1


@njit(cache=True, nogil=True, error_model="numpy")
def _lie_on(points: NDArray[np.float64], corners: NDArray[np.float64], same: float) -> bool:
    """True where each of the points (N, 3) is within `same` of one of the corners (V, 3); both go upwards."""
    low = 0
    for i in range(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        while low < len(corners) and corners[low, 2] < z - same:
            low += 1
        near, k = False, low
        while not near and k < len(corners) and corners[k, 2] <= z + same:
            dx, dy, dz = corners[k, 0] - x, corners[k, 1] - y, corners[k, 2] - z
            near = dx * dx + dy * dy + dz * dz < same * same
            k += 1
        if not near:
            return False
    return True


def _first_turn(bits: _Bits, order: int) -> _Bits:
    """Bits of the first of the turns that are alike: those of the others would vote for the same places again."""
    first = np.arctan2(bits.points[:, 1], bits.points[:, 0]) % (2 * np.pi) < 2 * np.pi / order
    return _Bits(bits.points[first], bits.ways[first])


def _sorted(surface: _Bits, rim: _Bits) -> tuple[NDArray[np.int64], _Bits, int]:
    """Key of layer and kind (N,), ascending, the bits, and how many layers; a bit is in all layers it is near."""
    steep = np.hypot(surface.ways[:, 0], surface.ways[:, 1]) > STEEP_CELL
    surface = _Bits(surface.points[steep], surface.ways[steep])
    class_ = np.arccos(np.clip(surface.ways[:, 2], -1, 1)) / CLASS_WIDTH
    layers = int(max(surface.points[:, 2].max(initial=0.0), rim.points[:, 2].max(initial=0.0)) / LAYER) + 3
    keys, members = [], []
    for up in (0.25, 0.75):
        layer = np.floor(surface.points[:, 2] / LAYER + up)
        for steeper in (-0.25, 0.25):
            keys.append(layer * KINDS + np.clip(np.floor(class_ + steeper), 0, RIM - 1))
            members.append(np.arange(len(surface.points)))
        keys.append(np.floor(rim.points[:, 2] / LAYER + up) * KINDS + RIM)
        members.append(len(surface.points) + np.arange(len(rim.points)))
    key, member = np.concatenate(keys).astype(np.int64), np.concatenate(members)
    points, ways = np.concatenate([surface.points, rim.points]), np.concatenate([surface.ways, rim.ways])
    alike = np.column_stack([key, (points[member, :2] * 1e4).round(), (ways[member, :2] * 1e2).round()])
    chosen = np.unique(alike, axis=0, return_index=True)[1]  # those one above the other vote for the same places
    return key[chosen], _Bits(points[member[chosen]], ways[member[chosen]]), layers


def _scattered(triangles: NDArray[np.float64]) -> _Bits:
    """Bits about SPACING apart on the triangles (F, 3, 3)."""
    points, ways = [np.zeros((0, 3))], [np.zeros((0, 3))]
    for a, b, c in triangles:
        across = np.cross(b - a, c - a)
        twice = float(np.linalg.norm(across))
        if twice < 1e-12:
            continue
        n = max(1, round(float(np.sqrt(twice)) / SPACING))
        u, v = (grid.ravel() for grid in np.meshgrid((np.arange(n) + 1 / 3) / n, (np.arange(n) + 1 / 3) / n))
        inside = u + v < 1
        points.append(a + np.outer(u[inside], b - a) + np.outer(v[inside], c - a))
        ways.append(np.tile(across / twice, (int(inside.sum()), 1)))
    return _thinned(_Bits(np.concatenate(points), np.concatenate(ways)), 2.0)


def _rim(triangles: NDArray[np.float64]) -> _Bits:
    """Bits along the borders of level faces that look up."""
    across = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    level = triangles[across[:, 2] > LEVEL_FACE * np.maximum(np.linalg.norm(across, axis=1), 1e-12)]
    borders: dict[tuple[float, ...], tuple[NDArray[np.float64], NDArray[np.float64]]] = {}
    for corners in level.round(6):
        for k in range(3):
            a, b = corners[k], corners[(k + 1) % 3]
            if borders.pop((*b, *a), None) is None:
                borders[(*a, *b)] = (a, b)
    points, ways = [np.zeros((0, 3))], [np.zeros((0, 3))]
    for a, b in borders.values():
        length = max(float(np.linalg.norm(b - a)), 1e-12)
        n = max(1, round(length / SPACING))
        points.append(a + np.outer((np.arange(n) + 0.5) / n, b - a))
        ways.append(np.tile(np.array([b[1] - a[1], a[0] - b[0], 0.0]) / length, (n, 1)))
    return _Bits(np.concatenate(points), np.concatenate(ways))


def _meridian(bits: _Bits) -> _Bits:
    """Each bit turned about z so that it lies over the x axis, without repetitions."""
    points, ways = bits
    inward = (points[:, :2] * ways[:, :2]).sum(axis=1) < 0
    far = np.where(inward, -1.0, 1.0) * np.hypot(points[:, 0], points[:, 1])
    nothing = np.zeros(len(far))
    turned = np.column_stack([far, nothing, points[:, 2]])
    return _thinned(_Bits(turned, np.column_stack([np.hypot(ways[:, 0], ways[:, 1]), nothing, ways[:, 2]])), 4.0)


def _thinned(bits: _Bits, ways: float) -> _Bits:
    """One bit a cube of SPACING and way to face, in so many steps: fine triangles vote no more often than others."""
    key = np.column_stack([np.floor(bits.points / SPACING), np.round(bits.ways * ways)])
    chosen = np.sort(np.unique(key, axis=0, return_index=True)[1])
    return _Bits(bits.points[chosen], bits.ways[chosen])


def warm_up() -> None:
    """Compile the kernel (or load it from its cache)."""
    _lie_on(np.zeros((1, 3)), np.zeros((1, 3)), 1.0)
