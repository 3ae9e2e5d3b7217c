"""The scene stage: what there is before anybody asks for an object.

``understand`` turns one cloud into support surfaces and the segments that stand on them; every query shares the result.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from time import perf_counter
from typing import TYPE_CHECKING

import numpy as np

from zsight_core import holes, wholes
from zsight_core import segments as seg
from zsight_core import support as sup
from zsight_core import view as vw
from zsight_core.holes import Hole, find_holes
from zsight_core.jit import njit
from zsight_core.scene_limits import SceneLimits
from zsight_core.transform import inverse
from zsight_core.wholes import Cells, join_parts
from zsight_core.words import words_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from zsight_core.points import Points
    from zsight_core.segments import Patches
    from zsight_core.support import Support
    from zsight_core.view import View

__all__ = ["TOO_LARGE", "TOO_SMALL", "Checkpoint", "Scene", "Segment", "go_on", "understand", "warm_up"]

Checkpoint = Callable[[str, float], None]
"""Called with the stage's name and the fraction done; raises errors.Cancelled to stop."""

TOO_SMALL, TOO_LARGE = 1, 2
"""Fates of patches that are of no thing."""

_GRID_CELL = 0.02
"""Metres; outlines are looked up on a grid of this cell."""

CHUNK = 32
"""Pixels of a row that are passed over at once where none is of interest."""

_USUAL = SceneLimits()


@dataclass(frozen=True, eq=False)
class Segment:
    """A piece of the cloud that is one object as far as its shape tells."""

    label: int
    """Its number in Scene.labels, from 2."""
    points: int
    """Pixels."""
    centroid: NDArray[np.float64]
    """(3,) metres, cloud frame."""
    size: NDArray[np.float64]
    """(3,) extents along the axes of box, metres."""
    T_camera_box: NDArray[np.float64]
    """(4, 4) centre and axes of a box around it, z along the support's normal, in the cloud's frame."""
    support: int
    """Number of the support surface it stands over."""
    low: float
    """Metres above the support of its lowest part seen."""
    high: float
    """Metres above the support of its highest part seen."""


@dataclass(frozen=True, eq=False)
class Scene:
    """What stands where, in the cloud's frame."""

    supports: list[Support]
    """Best first; empty where no surface was found."""
    labels: NDArray[np.int32]
    """Shape of the cloud: -1 no data, 0 neither, 1 support surface, 2.. one number an object."""
    segments: list[Segment]
    """One an object label, in order."""
    holes: list[Hole]
    """Where the surfaces show no depth, largest first."""
    timings_ms: dict[str, float]
    """Milliseconds by stage."""
    view: View
    """Depth image and pinhole."""
    noise: float
    """Standard deviation of 1 / z, 1/m."""
    kind: NDArray[np.uint8]
    """(H, W) of the view: NO_DATA, OTHER, SURFACE, OBJECT."""
    over: NDArray[np.int8]
    """(H, W) of the view: number of the support surface a pixel belongs to, or -1."""
    pixel_labels: NDArray[np.int32]
    """(H, W) of the view, as labels."""
    patches: Patches
    """Smooth pieces of the objects."""
    owner: NDArray[np.int32]
    """(K,) label of each patch, 0 where it is of no object."""
    fate: NDArray[np.uint8]
    """(K,) why a patch is of no object: TOO_SMALL, TOO_LARGE; else 0."""
    cells: Cells
    """Where those pieces are, in the support's frame."""
    T_world_camera: NDArray[np.float64] | None
    limits: SceneLimits


def go_on(stage: str, fraction: float) -> None:
    """The checkpoint that never stops anything."""


def understand(
    points: Points,
    *,
    T_world_camera: NDArray[np.float64] | None = None,
    known_height: float | None = None,
    limits: SceneLimits = _USUAL,
    checkpoint: Checkpoint = go_on,
) -> Scene:
    """Support surfaces and what stands on them.

    Args:
        points: (H, W) organised or (1, N) cloud, metres.
        T_world_camera: (4, 4) pose of the cloud's frame in a world with z up; None: gravity is unknown, the dominant
            plausible plane is the support.
        known_height: world z of the support surface, metres, where it is known; needs T_world_camera.
        limits: what counts as a thing.
        checkpoint: called between stages.

    Raises:
        PointsError: nothing finite in the cloud, or not in metres.
        Cancelled: raised by the checkpoint.
    """
    timings: dict[str, float] = {}
    clock = _Clock(timings)
    checkpoint("view", 0.0)
    view = vw.see(points)
    clock.stamp("view")
    checkpoint("support", 0.2)
    up, height = _gravity(view, T_world_camera, known_height)
    supports, noise = sup.find_supports(view, up=up, known_height=height)
    if T_world_camera is not None:
        supports = [_with_height(support, T_world_camera) for support in supports]
    clock.stamp("support")
    checkpoint("segments", 0.5)
    kind, over = _kinds(view, supports, noise, limits)
    clock.stamp("heights")
    patches = seg.grow_patches(view, kind, noise)
    clock.stamp("patches")
    checkpoint("segments", 0.8)
    owner = seg.join_patches(view, patches, noise)
    clock.stamp("join")
    cells = _cells_of(view, supports, patches, over)
    depth = view.depth[:: patches.step, :: patches.step]
    owner = join_parts(cells, patches, depth, owner, _colours_of(points, view, patches)) + 2
    clock.stamp("wholes")
    pixel_labels = _paint(view.depth, kind, patches.label, owner, patches.step, noise)
    pixel_labels, owner, fate, found = _measure(view, supports, over, pixel_labels, owner, noise, limits)
    labels = _of_points(points, view, pixel_labels)
    clock.stamp("segments")
    missing = find_holes(view, kind, supports)
    clock.stamp("holes")
    return Scene(
        supports,
        labels,
        found,
        missing,
        timings,
        view,
        noise,
        kind,
        over,
        pixel_labels,
        patches,
        owner,
        fate,
        cells,
        T_world_camera,
        limits,
    )


def warm_up() -> None:
    """Compile all kernels of the scene stage (or load them from their cache)."""
    vw.warm_up()
    sup.warm_up()
    seg.warm_up()
    depth = np.ones((16, 16), np.float32)
    planes, frames = np.zeros((1, 4)), np.zeros((1, 4, 4))
    grids, corners = np.ones((1, 2, 2), np.bool_), np.zeros((1, 2))
    kind, _ = _classify(
        depth, 8.0, 8.0, 8.0, 8.0, planes, frames, grids, corners, np.zeros((1, 16, 2)), 1e-3, 3e-3, 0.6
    )
    labels = _paint(depth, kind, np.zeros((8, 8), np.int32), np.zeros(1, np.int32), 2, 1e-3)
    over = np.zeros((16, 16), np.int8)
    normal = np.zeros((8, 8, 3), np.float32)
    _collect(depth, 8.0, 8.0, 8.0, 8.0, np.zeros((8, 8), np.int32), normal, 2, over, frames, np.array([0, 64]))
    _mean_colours(np.zeros(1024, np.uint32), 4, 3, np.zeros((8, 8), np.int32), 2, np.array([64]), 16)
    wholes.warm_up()
    holes.warm_up()
    _extents(depth, 8.0, 8.0, 8.0, 8.0, labels, over, frames, 3)
    _renumber(labels, np.zeros(3, np.int32))
    _grid_of(np.zeros((3, 2)), 0.0, 0.0, 2, 2, 0.02, 0.0)
    _rows_within(np.zeros(3), np.zeros(3), 2)


def _cells_of(view: View, supports: list[Support], patches: Patches, over: NDArray[np.int8]) -> Cells:
    """The patches' cells in the frame of their support."""
    T_optical_cloud = inverse(view.T_cloud_optical)
    frames = np.array([inverse(T_optical_cloud @ s.T_camera_support) for s in supports]).reshape(-1, 4, 4)
    start = np.concatenate([[0], np.cumsum(patches.count)])
    return Cells(
        *_collect(view.depth, *view.pinhole, patches.label, patches.normal, patches.step, over, frames, start), start
    )


def _colours_of(points: Points, view: View, patches: Patches) -> NDArray[np.float64] | None:
    """Mean red, green and blue (K, 3) of each patch, where the cloud is a coloured image."""
    if view.pixel is not None:
        return None
    words = words_of(points)
    if words.colour < 0:
        return None
    bits = words.words.view(np.uint32)
    return _mean_colours(
        bits, words.layout[0], words.colour, patches.label, patches.step, patches.count, points.shape[1]
    )


class _Clock:
    """Stamps the time since the last stamp."""

    def __init__(self, timings: dict[str, float]) -> None:
        self.timings = timings
        self.last = perf_counter()

    def stamp(self, stage: str) -> None:
        now = perf_counter()
        self.timings[stage] = (now - self.last) * 1e3
        self.last = now


def _gravity(
    view: View, T_world_camera: NDArray[np.float64] | None, known_height: float | None
) -> tuple[NDArray[np.float64] | None, tuple[NDArray[np.float64], float] | None]:
    """Up (3,) in the optical frame, and the known height as a plane of the optical frame."""
    if T_world_camera is None:
        if view.pixel is not None and not np.allclose(view.T_cloud_optical[:3, 3], 0):
            return np.array([0.0, 0.0, -1.0]), None  # drawn from above: the cloud's own z is up
        return None, None
    T_world_optical = T_world_camera @ view.T_cloud_optical
    up = T_world_optical[2, :3].copy()
    if known_height is None:
        return up, None
    return up, (up, known_height - float(T_world_optical[2, 3]))


def _with_height(support: Support, T_world_camera: NDArray[np.float64]) -> Support:
    from dataclasses import replace

    return replace(support, height=float((T_world_camera @ support.T_camera_support)[2, 3]))


def _kinds(
    view: View, supports: list[Support], noise: float, limits: SceneLimits
) -> tuple[NDArray[np.uint8], NDArray[np.int8]]:
    """Kind of each pixel and the support it belongs to, the highest support first."""
    order = sorted(range(len(supports)), key=lambda k: _rank(supports[k], supports))
    planes = np.zeros((len(order), 4))
    frames = np.zeros((len(order), 4, 4))
    lows, grids = np.zeros((len(order), 2)), []
    reach = max(limits.margin + _GRID_CELL, 2 * _GRID_CELL)
    T_optical_cloud = inverse(view.T_cloud_optical)
    for i, k in enumerate(order):
        T_optical_support = T_optical_cloud @ supports[k].T_camera_support
        planes[i, :3] = T_optical_support[:3, 2]
        planes[i, 3] = T_optical_support[:3, 2] @ T_optical_support[:3, 3]
        frames[i] = inverse(T_optical_support)
        lows[i] = supports[k].outline.min(axis=0) - reach
        spans = supports[k].outline.max(axis=0) - lows[i] + reach
        rows, columns = (int(min(np.ceil(span / _GRID_CELL), 400)) for span in spans[::-1])
        grids.append(_grid_of(supports[k].outline, lows[i, 0], lows[i, 1], rows, columns, _GRID_CELL, limits.margin))
    rows = max((len(grid) for grid in grids), default=1)
    columns = max((grid.shape[1] for grid in grids), default=1)
    stacked = np.zeros((len(order), rows, columns), np.bool_)
    for i, grid in enumerate(grids):
        stacked[i, : grid.shape[0], : grid.shape[1]] = grid
    spans = np.array(
        [_spans(view, inverse(frames[i]), supports[k].outline, limits.margin) for i, k in enumerate(order)]
    )
    spans = spans.reshape(-1, view.depth.shape[0], 2)
    kind, over = _classify(
        view.depth, *view.pinhole, planes, frames, stacked, lows, spans, noise, limits.lowest, limits.highest
    )
    if order and order != sorted(order):
        over = np.array([*order, -1], np.int8)[over]
    return kind, over


def _spans(
    view: View, T_optical_support: NDArray[np.float64], outline: NDArray[np.float64], margin: float
) -> NDArray[np.float64]:
    """First and last column (H, 2) of each image row within a surface's outline and its margin."""
    out = outline - outline.mean(axis=0)
    wider = outline + margin * out / np.maximum(np.linalg.norm(out, axis=1, keepdims=True), 1e-9)
    corners = wider @ T_optical_support[:3, :2].T + T_optical_support[:3, 3]
    corners[:, 2] = np.maximum(corners[:, 2], 0.05)
    u, v = corners[:, 0] / corners[:, 2] * view.fx + view.cx, corners[:, 1] / corners[:, 2] * view.fy + view.cy
    spans: NDArray[np.float64] = _rows_within(u, v, view.depth.shape[0])
    return spans


def _rank(support: Support, supports: list[Support]) -> float:
    """Lower for a higher surface."""
    reference = supports[0]
    return -float(reference.normal @ support.T_camera_support[:3, 3] - reference.distance)


def _measure(
    view: View,
    supports: list[Support],
    over: NDArray[np.int8],
    labels: NDArray[np.int32],
    owner: NDArray[np.int32],
    noise: float,
    limits: SceneLimits,
) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.uint8], list[Segment]]:
    """Segments with their boxes; those that are noise or furniture lose their label, the others are renumbered."""
    count = int(owner.max()) + 1 if owner.size else 2
    T_optical_cloud = inverse(view.T_cloud_optical)
    frames = np.array([inverse(T_optical_cloud @ s.T_camera_support) for s in supports]).reshape(-1, 4, 4)
    rows = _extents(view.depth, *view.pinhole, labels, over, frames, count)
    renumber = np.zeros(max(count, 2), np.int32)
    renumber[:2] = 0, 1
    fate = np.zeros(max(count, 2), np.uint8)
    found: list[Segment] = []
    least = max(12, limits.smallest * view.depth.size / 307_200)
    for k in range(2, count):
        pixels, low, high, centre, size = (
            rows[k, 0],
            rows[k, 1:4],
            rows[k, 4:7],
            rows[k, 7:10],
            rows[k, 4:7] - rows[k, 1:4],
        )
        base = int(rows[k, 10])
        if pixels < least or size.max() > limits.largest:
            fate[k] = TOO_SMALL if pixels < least else TOO_LARGE
            continue
        if pixels < 10 * least and rows[k, 6] < 2.2 * _tolerance(
            view, supports[base], low + size / 2, noise, limits.lowest
        ):
            renumber[k] = 1  # a ripple of the surface
            continue
        label = len(found) + 2
        renumber[k] = label
        T = supports[base].T_camera_support.copy()
        T[:3, 3] = (T @ np.append((low + high) / 2, 1.0))[:3]
        centroid = (supports[base].T_camera_support @ np.append(centre, 1.0))[:3]
        found.append(Segment(label, int(pixels), centroid, size, T, base, float(low[2]), float(high[2])))
    _renumber(labels, renumber)
    return labels, renumber[owner], fate[owner], found


def _tolerance(view: View, support: Support, place: NDArray[np.float64], noise: float, lowest: float) -> float:
    """Metres above the support from which a pixel there is of an object."""
    point = (inverse(view.T_cloud_optical) @ support.T_camera_support @ np.append(place, 1.0))[:3]
    normal = inverse(view.T_cloud_optical)[:3, :3] @ support.normal
    return float(lowest + 3 * noise * point[2] * abs(normal @ point))


def _of_points(points: Points, view: View, pixel_labels: NDArray[np.int32]) -> NDArray[np.int32]:
    """Labels in the shape of the cloud."""
    if view.pixel is None:
        return pixel_labels
    labels = np.where(view.pixel >= 0, pixel_labels.reshape(-1)[view.pixel], -1)
    return labels.astype(np.int32).reshape(points.shape)


@njit(cache=True, nogil=True, error_model="numpy")
def _grid_of(
    outline: NDArray[np.float64], x0: float, y0: float, rows: int, columns: int, cell: float, margin: float
) -> NDArray[np.bool_]:
    """Cells (rows, columns) whose centre lies in the counter-clockwise convex outline or within margin of it."""
    grid = np.ones((rows, columns), np.bool_)
    for k in range(len(outline)):
        ax, ay = outline[k, 0], outline[k, 1]
        bx, by = outline[(k + 1) % len(outline), 0], outline[(k + 1) % len(outline), 1]
        length = max(np.hypot(bx - ax, by - ay), 1e-9)
        for r in range(rows):
            y = y0 + (r + 0.5) * cell
            for c in range(columns):
                x = x0 + (c + 0.5) * cell
                if ((bx - ax) * (y - ay) - (by - ay) * (x - ax)) / length < -margin:
                    grid[r, c] = False
    return grid


@njit(cache=True, nogil=True, error_model="numpy")
def _rows_within(u: NDArray[np.float64], v: NDArray[np.float64], height: int) -> NDArray[np.float64]:
    """First and last column (H, 2) of each image row within a polygon with corners u, v (K,); crossed where none."""
    spans = np.empty((height, 2))
    spans[:, 0], spans[:, 1] = np.inf, -np.inf
    for k in range(len(u)):
        j = (k + 1) % len(u)
        if abs(v[j] - v[k]) < 1e-9:
            continue
        slope = (u[j] - u[k]) / (v[j] - v[k])
        for row in range(max(0, int(np.ceil(min(v[k], v[j])))), min(height - 1, int(np.floor(max(v[k], v[j])))) + 1):
            at = u[k] + (row - v[k]) * slope
            spans[row, 0], spans[row, 1] = min(spans[row, 0], at), max(spans[row, 1], at)
    return spans


@njit(cache=True, nogil=True, error_model="numpy")
def _classify(
    depth: NDArray[np.float32],
    fx: float,
    fy: float,
    cx: float,
    cy: float,
    planes: NDArray[np.float64],
    frames: NDArray[np.float64],
    grids: NDArray[np.bool_],
    lows: NDArray[np.float64],
    spans: NDArray[np.float64],
    noise: float,
    lowest: float,
    highest: float,
) -> tuple[NDArray[np.uint8], NDArray[np.int8]]:
    """Kind and support of each pixel; supports come highest first, planes (S, 4) and frames T_support_optical."""
    height, width = depth.shape
    kind = np.empty((height, width), np.uint8)
    over = np.full((height, width), -1, np.int8)
    low, huge, spread = np.float32(lowest), np.float32(highest), np.float32(3 * noise)
    for v in range(height):
        y = (v - cy) / fy
        line, row = depth[v], kind[v]
        for u in range(width):
            row[u] = 1 if line[u] > 0 else 0
        for s in range(len(planes)):
            T = frames[s]
            per_u, first = (
                np.float32(planes[s, 0] / fx),
                np.float32(planes[s, 1] * y + planes[s, 2] - planes[s, 0] * cx / fx),
            )
            d = np.float32(planes[s, 3])
            left, right = spans[s, v, 0], spans[s, v, 1]
            for u in range(width):  # no grid here: the compiler does several pixels at a time
                z = line[u]
                slant = per_u * np.float32(u) + first
                h = slant * z - d
                tolerance = low + spread * z * z * abs(slant)
                on = (abs(h) <= tolerance) & (u >= left) & (u <= right)
                above = (h > tolerance) & (h < huge)
                level = np.uint8(2) if on else (np.uint8(4) if above else np.uint8(1))
                row[u] = level if row[u] == 1 else row[u]
            mine, number = over[v], np.int8(s)
            for u in range(width):
                mine[u] = number if (row[u] == 2) & (mine[u] < 0) else mine[u]
            for u0 in range(0, width, CHUNK):
                if u0 + CHUNK <= width and _highest(row, u0) < 4:
                    continue
                for u in range(u0, min(u0 + CHUNK, width)):
                    if row[u] != 4:
                        continue
                    z, x = line[u], (u - cx) / fx
                    c = int(((T[0, 0] * x + T[0, 1] * y + T[0, 2]) * z + T[0, 3] - lows[s, 0]) * (1 / _GRID_CELL))
                    r = int(((T[1, 0] * x + T[1, 1] * y + T[1, 2]) * z + T[1, 3] - lows[s, 1]) * (1 / _GRID_CELL))
                    row[u] = 1
                    if 0 <= r < grids.shape[1] and 0 <= c < grids.shape[2] and grids[s, r, c]:
                        row[u] = 3
                        mine[u] = number
    return kind, over


@njit(cache=True, nogil=True, error_model="numpy")
def _highest(row: NDArray[np.uint8], first: int) -> int:
    """Highest of a chunk of a row of kinds."""
    most, start = np.uint8(0), np.uint64(first)
    for i in range(CHUNK):
        most = max(most, row[start + np.uint64(i)])
    return int(most)


@njit(cache=True, nogil=True, error_model="numpy")
def _collect(
    depth: NDArray[np.float32],
    fx: float,
    fy: float,
    cx: float,
    cy: float,
    label: NDArray[np.int32],
    normal: NDArray[np.float32],
    step: int,
    over: NDArray[np.int8],
    frames: NDArray[np.float64],
    start: NDArray[np.int64],
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64], NDArray[np.float64], NDArray[np.int8]]:
    """Row, column, point, normal and support of each cell, patch by patch, in the frame of its support."""
    total = start[-1]
    row, column = np.empty(total, np.int64), np.empty(total, np.int64)
    points, normals, support = np.empty((total, 3)), np.empty((total, 3)), np.empty(total, np.int8)
    place = start.copy()
    for r in range(label.shape[0]):
        for c in range(label.shape[1]):
            k = label[r, c]
            if k < 0:
                continue
            i = place[k]
            place[k] += 1
            row[i], column[i], support[i] = r, c, over[r * step, c * step]
            T = frames[support[i]]
            z = depth[r * step, c * step]
            x, y = (c * step - cx) / fx * z, (r * step - cy) / fy * z
            for a in range(3):
                points[i, a] = T[a, 0] * x + T[a, 1] * y + T[a, 2] * z + T[a, 3]
                normals[i, a] = T[a, 0] * normal[r, c, 0] + T[a, 1] * normal[r, c, 1] + T[a, 2] * normal[r, c, 2]
    return row, column, points, normals, support


@njit(cache=True, nogil=True, error_model="numpy")
def _mean_colours(
    bits: NDArray[np.uint32],
    words: int,
    at: int,
    label: NDArray[np.int32],
    step: int,
    count: NDArray[np.int64],
    width: int,
) -> NDArray[np.float64]:
    """Mean red, green, blue (K, 3) of the cells of each patch; `words` a point, the packed colour at word `at`."""
    colour = np.zeros((len(count), 3))
    for r in range(label.shape[0]):
        for c in range(label.shape[1]):
            k = label[r, c]
            if k >= 0:
                packed = bits[(r * step * width + c * step) * words + at]
                for channel in range(3):
                    colour[k, channel] += (packed >> np.uint32(16 - 8 * channel)) & np.uint32(255)
    for k in range(len(count)):
        colour[k] /= max(count[k], 1)
    return colour


@njit(cache=True, nogil=True, error_model="numpy")
def _paint(
    depth: NDArray[np.float32],
    kind: NDArray[np.uint8],
    cell_label: NDArray[np.int32],
    owner: NDArray[np.int32],
    step: int,
    noise: float,
) -> NDArray[np.int32]:
    """Labels (H, W): each object pixel takes that of the nearest cells around whose depth is nearest."""
    height, width = depth.shape
    labels = np.empty((height, width), np.int32)
    for v in range(height):
        r0 = v // step
        for u in range(width):
            labels[v, u] = np.int32(kind[v, u]) - 1
        for u in range(width):
            if kind[v, u] != 3:
                continue
            labels[v, u] = 0
            c0 = u // step
            z = depth[v, u]
            nearest = 0.012 + 4 * noise * z * z
            for reach in range(1, 4):
                for r in range(max(0, r0 - reach + 1), min(cell_label.shape[0], r0 + reach + 1)):
                    for c in range(max(0, c0 - reach + 1), min(cell_label.shape[1], c0 + reach + 1)):
                        if cell_label[r, c] >= 0:
                            gap = abs(depth[r * step, c * step] - z)
                            if gap < nearest:
                                nearest = gap
                                labels[v, u] = owner[cell_label[r, c]]
                if labels[v, u] != 0:
                    break
    return labels


@njit(cache=True, nogil=True, error_model="numpy")
def _renumber(labels: NDArray[np.int32], renumber: NDArray[np.int32]) -> None:
    """Change labels from 2 in place."""
    for v in range(labels.shape[0]):
        for u in range(labels.shape[1]):
            if labels[v, u] >= 2:
                labels[v, u] = renumber[labels[v, u]]


@njit(cache=True, nogil=True, error_model="numpy")
def _extents(
    depth: NDArray[np.float32],
    fx: float,
    fy: float,
    cx: float,
    cy: float,
    labels: NDArray[np.int32],
    over: NDArray[np.int8],
    frames: NDArray[np.float64],
    count: int,
) -> NDArray[np.float64]:
    """Per label (count, 11): pixels, lows x y z, highs x y z, means x y z in the support's frame, support."""
    rows = np.zeros((count, 11))
    rows[:, 1:4] = np.inf
    rows[:, 4:7] = -np.inf
    rows[:, 10] = -1
    for v in range(depth.shape[0]):
        y = (v - cy) / fy
        for u in range(depth.shape[1]):
            k = labels[v, u]
            if k < 2 or over[v, u] < 0:
                continue
            m = rows[k]
            if m[10] < 0:
                m[10] = over[v, u]
            T = frames[int(m[10])]
            z = depth[v, u]
            x = (u - cx) / fx
            m[0] += 1
            for a in range(3):
                value = (T[a, 0] * x + T[a, 1] * y + T[a, 2]) * z + T[a, 3]
                m[1 + a] = min(m[1 + a], value)
                m[4 + a] = max(m[4 + a], value)
                m[7 + a] += value
    for k in range(count):
        for a in range(3):
            rows[k, 7 + a] /= max(rows[k, 0], 1.0)
    return rows
