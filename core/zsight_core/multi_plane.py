"""All planes of an organised cloud at once."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from zsight_core.disjoint_sets import root_of, unite
from zsight_core.errors import GeometryError, PointsError
from zsight_core.image_normals import load_row, mark_edges, mark_near, normals_of_row
from zsight_core.jit import njit
from zsight_core.moments import plane_of_sums
from zsight_core.plane import Plane, PlaneFit
from zsight_core.points import is_organised
from zsight_core.scratch import scratch
from zsight_core.words import words_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from zsight_core.points import Points
    from zsight_core.words import Layout

__all__ = ["PlanesOfImage", "planes_of_image", "warm_up"]

_WINDOW = 5
"""Cells (of 2 x 2 pixels) along the edge of the square from which a normal is taken."""

_TURN, _STEP = 1.5, 2.0
"""Cells lie twice as far apart as pixels: how much more the normals and the distances of two of them may differ."""

_ONE_SURFACE = 3.0
"""How many times the angle of neighbours the normals of two regions may differ that are pieces of one surface."""

_CELL: Layout = (4, 0, 1, 2)

_MOST = 255
"""Regions that are followed at most; pixels carry their number in a byte, 0 for none."""


@dataclass(frozen=True)
class PlanesOfImage:
    """The planes of an organised cloud, the one with most pixels first.

    ``labels`` int32 (H, W): number of the pixel's plane, -1 in none. ``fits``: each plane, fitted to the smooth inside
    of its region; ``inliers`` counts the pixels of its label.
    """

    labels: NDArray[np.int32]
    fits: tuple[PlaneFit, ...]


def planes_of_image(
    points: Points,
    least: int = 1000,
    angle: float = math.radians(3.0),
    distance: float = 0.02,
    depth_change: float = 0.02,
) -> PlanesOfImage:
    """Find planes as connected regions of like normals, take in their borders, and join the pieces of one surface.

    Method: after Trevor, Gedikli, Rusu and Christensen, Efficient organized point cloud segmentation with connected
    components (2013), as PCL has it: neighbours are linked where their normals and plane distances agree; a plane is
    fitted to each region of linked ones; regions grow over pixels within `distance` of their plane. Two things differ.
    Normals are taken, and linked, for squares of 2 x 2 pixels. And adjoining regions whose planes agree become one: a
    carpet is one plane, where the noise of normals breaks it into several for PCL (docs/decisions/0050).

    Args:
        points: (H, W), organised, metres; z is the depth, of either sign.
        least: smallest number of pixels of a plane.
        angle: greatest, radians, between the normals of neighbouring pixels; pieces of one surface may differ by three
            times as much.
        distance: greatest, metres, of a pixel from its plane; of neighbouring pixels' planes at 1 m depth, growing with
            the square of depth; half of it between the pieces of one surface (root of the mean square).
        depth_change: neighbours whose depths differ by more than 2 (1 + |z|) times this are on two surfaces.

    Raises:
        PointsError: the cloud is not organised.
        GeometryError: a threshold is not above zero.
    """
    if not is_organised(points):
        raise PointsError(f"cloud has shape {points.shape}; expected rows and columns of an image: use ransac_plane")
    if not (least > 0 and 0 < angle < math.pi and distance > 0 and depth_change > 0):
        raise GeometryError(f"thresholds are {least}, {angle}, {distance}, {depth_change}; expected numbers above zero")
    cloud = words_of(points)
    if min(cloud.shape) < 2 * _WINDOW:
        return PlanesOfImage(np.full(cloud.shape, -1, np.int32), ())
    shape = (cloud.shape[0] // 2, cloud.shape[1] // 2)
    labels = scratch("planes labels", cloud.shape, np.uint8)
    root, sums = _segment(
        cloud.words,
        cloud.layout,
        scratch("planes cells", (math.prod(shape) * _CELL[0],), np.float32),
        scratch("planes edges", (2, *shape), np.uint8),
        scratch("planes runs", (math.prod(shape), 4), np.int32),
        labels,
        least,
        angle,
        distance,
        depth_change,
    )
    return _result(labels, root, sums, least)


def _result(labels: NDArray[np.uint8], root: NDArray[np.int64], sums: NDArray[np.float64], least: int) -> PlanesOfImage:
    """Number the joined regions by size and fit each once more to the sums of its parts."""
    number = np.full(_MOST + 1, -1, np.int32)
    out = np.empty(labels.shape, np.int32)
    sizes = np.bincount(root, weights=_histogram(labels.reshape(-1))[: len(root)], minlength=len(root))
    fits: list[PlaneFit] = []
    for region in np.argsort(-sizes, kind="stable"):
        if sizes[region] < least or region == 0:
            continue
        plane, variances = plane_of_sums(sums[root == region].sum(axis=0))
        number[: len(root)][root == region] = len(fits)
        fits.append(PlaneFit(Plane(plane[:3], float(plane[3])), int(sizes[region]), math.sqrt(max(variances[0], 0.0))))
    _look_up(labels.reshape(-1), number, out.reshape(-1))
    return PlanesOfImage(out, tuple(fits))


@njit(cache=True, nogil=True)
def _segment(
    words: NDArray[np.float32],
    layout: Layout,
    cells: NDArray[np.float32],
    edges: NDArray[np.uint8],
    runs: NDArray[np.int32],
    labels: NDArray[np.uint8],
    least: int,
    angle: float,
    distance: float,
    depth_change: float,
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Label the pixels; one kernel, since each one that is loaded from the cache costs some milliseconds.

    Args:
        words: the cloud.
        layout: of the words.
        cells: room for means of 2 x 2 pixels, 16 bytes each.
        edges: (2, H / 2, W / 2) room for marks.
        runs: room for stretches of linked cells, a row for each cell.
        labels: (H, W) gets the number of each pixel's region, 0 for none.
        least: as of `planes_of_image`, and so are the following.
        angle: radians.
        distance: metres.
        depth_change: factor.

    Returns:
        For each region the one that it is part of (R,), and sums over the cells of each (R, 10).
    """
    columns = edges.shape[2]
    _shrink(words, layout, labels.shape[1], cells, columns)
    mark_edges(cells, _CELL, columns, np.float32(depth_change), edges[0])
    mark_near(edges[0], _WINDOW, edges[1])
    cosine = np.float32(math.cos(min(_TURN * angle, math.pi)))
    linked = runs[: _link(cells, edges[1], cosine, np.float32(_STEP * distance), runs)]
    number = _large_regions(linked, max(4, least // 8))
    sums = _region_sums(cells, columns, linked, number)
    planes, flat = _planes_of_sums(sums)
    _paint(linked, number, flat, labels)
    _grow(words, layout, planes.astype(np.float32), np.float32(distance), labels)
    cosine_of_one = math.cos(min(_ONE_SURFACE * angle, math.pi))
    return _joined(_borders(labels), sums, planes, cosine_of_one, distance / 2), sums


@njit(cache=True, nogil=True)
def _shrink(words: NDArray[np.float32], layout: Layout, width: int, cells: NDArray[np.float32], columns: int) -> None:
    above, below = np.empty((3, width), np.float32), np.empty((3, width), np.float32)
    for r in range(len(cells) // (4 * columns)):
        load_row(words, layout, 2 * r, above)
        load_row(words, layout, 2 * r + 1, below)
        row = cells[4 * columns * r : 4 * columns * (r + 1)]
        for axis in range(3):
            _halve(above[axis], below[axis], axis, row)


@njit(cache=True, nogil=True)
def _halve(above: NDArray[np.float32], below: NDArray[np.float32], axis: int, cells: NDArray[np.float32]) -> None:
    quarter = np.float32(0.25)
    for c in range(len(cells) // 4):
        cells[4 * c + axis] = (above[2 * c] + above[2 * c + 1] + below[2 * c] + below[2 * c + 1]) * quarter


@njit(cache=True, nogil=True)
def _link(
    cells: NDArray[np.float32], near: NDArray[np.uint8], cosine: Any, distance: Any, runs: NDArray[np.int32]
) -> int:
    """Stretches of linked cells in a row, (R, 4): row, first column, column behind the last, root of its region."""
    height, width = near.shape
    ring = np.empty((_WINDOW, 3, width), np.float32)
    sums, dots = np.empty((4, width), np.float32), np.empty(width, np.float32)
    normal, before = np.empty((4, width), np.float32), np.empty((4, width), np.float32)
    right, up = np.zeros(width, np.uint8), np.empty(width, np.uint8)
    of, of_before = np.full(width, -1, np.int32), np.full(width, -1, np.int32)
    parent = np.arange(height * width)
    used = 0
    half = _WINDOW // 2
    for last in range(_WINDOW - 1, height):
        first = last if last >= _WINDOW else 0
        for r in range(first, last + 1):
            load_row(cells, _CELL, r, ring[r % _WINDOW])
        r = last - half
        normals_of_row(ring, last, sums, normal)
        free = near[r]
        free[:half] = 1
        free[width - half :] = 1
        depth = ring[r % _WINDOW, 2]
        _dots(normal[:3, :-1], normal[:3, 1:], dots[:-1])
        _alike(dots[:-1], normal[3, :-1], normal[3, 1:], depth[:-1], cosine, distance, right[:-1])
        _both(free[:-1], free[1:], right[:-1])
        used = _append_runs(free, right, r, of, runs, used)
        if r > half:
            _dots(normal[:3], before[:3], dots)
            _alike(dots, normal[3], before[3], depth, cosine, distance, up)
            _both(free, near[r - 1], up)
            _join(up, of, of_before, parent)
        normal, before = before, normal
        of, of_before = of_before, of
    for k in range(used):
        runs[k, 3] = root_of(parent, k)
    return used


@njit(cache=True, nogil=True, fastmath={"contract"})
def _dots(normal: NDArray[np.float32], other: NDArray[np.float32], dots: NDArray[np.float32]) -> None:
    x, y, z, a, b, c = normal[0], normal[1], normal[2], other[0], other[1], other[2]
    for i in range(len(dots)):
        dots[i] = x[i] * a[i] + y[i] * b[i] + z[i] * c[i]


@njit(cache=True, nogil=True)
def _alike(
    dots: NDArray[np.float32],
    one: NDArray[np.float32],
    other: NDArray[np.float32],
    depth: NDArray[np.float32],
    cosine: Any,
    distance: Any,
    alike: NDArray[np.uint8],
) -> None:
    """1 where normals, by their scalar product, and plane distances agree."""
    for c in range(len(alike)):
        alike[c] = (dots[c] > cosine) & (abs(one[c] - other[c]) < distance * depth[c] * depth[c])


@njit(cache=True, nogil=True)
def _both(near: NDArray[np.uint8], other: NDArray[np.uint8], marks: NDArray[np.uint8]) -> None:
    """Leave only marks where both are free."""
    one = np.uint8(1)
    for c in range(len(marks)):
        marks[c] &= (near[c] | other[c]) ^ one


@njit(cache=True, nogil=True)
def _append_runs(
    near: NDArray[np.uint8], right: NDArray[np.uint8], r: int, of: NDArray[np.int32], runs: NDArray[np.int32], used: int
) -> int:
    """Add the runs of a row; `of` gets the run of each cell."""
    c = 0
    while c < len(near):
        if near[c]:
            c += 1
            continue
        first = c
        while c + 1 < len(near) and right[c]:
            c += 1
        c += 1
        runs[used, 0], runs[used, 1], runs[used, 2] = r, first, c
        of[first:c] = used
        used += 1
    return used


@njit(cache=True, nogil=True)
def _join(
    up: NDArray[np.uint8], of: NDArray[np.int32], of_before: NDArray[np.int32], parent: NDArray[np.int64]
) -> None:
    """Unite runs with those above that they are linked to."""
    mine, other = np.int32(-1), np.int32(-1)
    for c in range(len(up)):
        if up[c] and (of[c] != mine or of_before[c] != other):
            mine, other = of[c], of_before[c]
            unite(parent, mine, other)


@njit(cache=True, nogil=True)
def _large_regions(runs: NDArray[np.int32], least: int) -> NDArray[np.int32]:
    """New number for each region: 1, 2, ... for those of at least so many cells, the largest first; 0 for others."""
    sizes = np.zeros(len(runs), np.int64)
    for k in range(len(runs)):
        sizes[runs[k, 3]] += runs[k, 2] - runs[k, 1]
    large = np.flatnonzero(sizes >= least)
    order = np.argsort(-sizes[large], kind="mergesort")
    number = np.zeros(len(runs), np.int32)
    for place in range(min(len(order), _MOST)):
        number[large[order[place]]] = place + 1
    return number


@njit(cache=True, nogil=True)
def _region_sums(
    cells: NDArray[np.float32], width: int, runs: NDArray[np.int32], number: NDArray[np.int32]
) -> NDArray[np.float64]:
    """Count and first and second moments (R, 10) of the cells of each region."""
    most = number.max() if len(number) else 0
    sums = np.zeros((most + 1, 10))
    for k in range(len(runs)):
        region = number[runs[k, 3]]
        if region > 0:
            first, last = runs[k, 0] * width + runs[k, 1], runs[k, 0] * width + runs[k, 2]
            _add_run(cells[4 * first : 4 * last], sums[region])
    return sums


@njit(cache=True, nogil=True, fastmath={"reassoc", "nsz", "contract"})  # a sum in any order is as good
def _add_run(cells: NDArray[np.float32], sums: NDArray[np.float64]) -> None:
    n = len(cells) // 4
    sx = sy = sz = sxx = sxy = sxz = syy = syz = szz = 0.0
    for i in range(n):
        x, y, z = np.float64(cells[4 * i]), np.float64(cells[4 * i + 1]), np.float64(cells[4 * i + 2])
        sx += x
        sy += y
        sz += z
        sxx += x * x
        sxy += x * y
        sxz += x * z
        syy += y * y
        syz += y * z
        szz += z * z
    sums[0] += n
    sums[1] += sx
    sums[2] += sy
    sums[3] += sz
    sums[4] += sxx
    sums[5] += sxy
    sums[6] += sxz
    sums[7] += syy
    sums[8] += syz
    sums[9] += szz


@njit(cache=True, nogil=True)
def _planes_of_sums(sums: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Planes (R, 4) of sums (R, 10), and which regions are flat, by PCL's bound on the curvature, 0.001."""
    planes, flat = np.zeros((len(sums), 4)), np.zeros(len(sums), np.bool_)
    for region in range(1, len(sums)):
        planes[region], variances = plane_of_sums(sums[region])
        flat[region] = variances[0] <= 1e-3 * variances.sum() and variances[1] > 1e-12 * variances[2]
    return planes, flat


@njit(cache=True, nogil=True)
def _paint(
    runs: NDArray[np.int32], number: NDArray[np.int32], flat: NDArray[np.bool_], labels: NDArray[np.uint8]
) -> None:
    """Give the pixels of the cells of each run the number of its region."""
    labels[:] = 0
    for k in range(len(runs)):
        region = number[runs[k, 3]]
        if flat[region]:
            r, first, end = 2 * runs[k, 0], 2 * runs[k, 1], 2 * runs[k, 2]
            labels[r, first:end] = region
            labels[r + 1, first:end] = region


@njit(cache=True, nogil=True)
def _grow(
    words: NDArray[np.float32],
    layout: Layout,
    planes: NDArray[np.float32],
    distance: Any,
    labels: NDArray[np.uint8],
) -> None:
    """Spread labels to pixels within `distance` of their plane: one sweep right and down, one left and up, as PCL's."""
    height, width = labels.shape
    front = np.zeros((width + 7) // 8 * 8, np.uint8)
    for r in range(height - 1):
        _mark_front(labels[r, :-1], labels[r, 1:], front[: width - 1])
        front[width - 1] = 0
        _mark_below(labels[r], labels[r + 1], front[:width])
        _advance(words, layout, planes, distance, labels, r, 1, front)
    for r in range(height - 1, 0, -1):
        _mark_front(labels[r, 1:], labels[r, :-1], front[1:width])
        front[0] = 0
        _mark_below(labels[r], labels[r - 1], front[:width])
        _advance(words, layout, planes, distance, labels, r, -1, front)


@njit(cache=True, nogil=True)
def _mark_front(row: NDArray[np.uint8], beside: NDArray[np.uint8], front: NDArray[np.uint8]) -> None:
    """1 where a pixel has a label and the one beside it none."""
    for c in range(len(front)):
        front[c] = (row[c] != 0) & (beside[c] == 0)


@njit(cache=True, nogil=True)
def _mark_below(row: NDArray[np.uint8], following: NDArray[np.uint8], front: NDArray[np.uint8]) -> None:
    for c in range(len(front)):
        front[c] |= np.uint8((row[c] != 0) & (following[c] == 0))


@njit(cache=True, nogil=True)
def _advance(
    words: NDArray[np.float32],
    layout: Layout,
    planes: NDArray[np.float32],
    distance: Any,
    labels: NDArray[np.uint8],
    r: int,
    side: int,
    front: NDArray[np.uint8],
) -> None:
    """Pass labels on from the front pixels of a row: right and down for side 1; left and up, from the right, for -1."""
    step, at_x, at_y, at_z = layout
    width = labels.shape[1]
    row, following = labels[r], labels[r + side]
    eights = front.view(np.uint64)
    for turn in range(len(eights)):
        eight = turn if side > 0 else len(eights) - 1 - turn
        if eights[eight] == 0:
            continue
        for k in range(8):
            c = 8 * eight + (k if side > 0 else 7 - k)
            if front[c] == 0:
                continue
            label = row[c]
            beside = c + side
            if 0 <= beside < width and row[beside] == 0:
                at = step * (r * width + beside)
                if _gap(planes, label, words[at + at_x], words[at + at_y], words[at + at_z]) < distance:
                    row[beside] = label
                    front[beside] = 1
            if following[c] == 0:
                at = step * ((r + side) * width + c)
                if _gap(planes, label, words[at + at_x], words[at + at_y], words[at + at_z]) < distance:
                    following[c] = label


@njit(cache=True, nogil=True)
def _gap(planes: NDArray[np.float32], k: int, x: Any, y: Any, z: Any) -> Any:
    """Distance of a point from plane k of (K, 4) nx, ny, nz, d; NaN at a hole."""
    return abs(planes[k, 0] * x + planes[k, 1] * y + planes[k, 2] * z - planes[k, 3])


@njit(cache=True, nogil=True)
def _borders(labels: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Which regions adjoin, (256, 256), as seen in every fourth row and column."""
    touch = np.zeros((_MOST + 1, _MOST + 1), np.bool_)
    height, width = labels.shape
    for r in range(0, height, 4):
        for c in range(width - 1):
            touch[labels[r, c], labels[r, c + 1]] = True
    for r in range(height - 1):
        for c in range(0, width, 4):
            touch[labels[r, c], labels[r + 1, c]] = True
    return touch | touch.T


@njit(cache=True, nogil=True)
def _joined(
    touch: NDArray[np.bool_], sums: NDArray[np.float64], planes: NDArray[np.float64], cosine: float, distance: float
) -> NDArray[np.int64]:
    """For each region the one whose part it becomes, itself if none."""
    parent = np.arange(len(planes))
    for a in range(1, len(planes)):
        for b in range(a + 1, len(planes)):
            large, small = (a, b) if sums[a, 0] >= sums[b, 0] else (b, a)
            turned = (planes[large, :3] * planes[small, :3]).sum()
            if touch[a, b] and turned >= cosine and _rms(sums[small], planes[large]) <= distance:
                unite(parent, a, b)
    for region in range(len(parent)):
        parent[region] = root_of(parent, region)
    return parent


@njit(cache=True, nogil=True)
def _rms(sums: NDArray[np.float64], plane: NDArray[np.float64]) -> float:
    """Root of the mean squared distance from a plane of the points with these (10,) sums."""
    x, y, z, d = plane
    n, sx, sy, sz, xx, xy, xz, yy, yz, zz = sums
    square = x * x * xx + y * y * yy + z * z * zz + 2.0 * (x * y * xy + x * z * xz + y * z * yz)
    return math.sqrt(max((square - 2.0 * d * (x * sx + y * sy + z * sz)) / n + d * d, 0.0))


@njit(cache=True, nogil=True)
def _histogram(labels: NDArray[np.uint8]) -> NDArray[np.int64]:
    """How often each byte occurs, (256,)."""
    counts = np.zeros((4, 256), np.int64)
    for i in range(0, len(labels) - 3, 4):
        counts[0, labels[i]] += 1
        counts[1, labels[i + 1]] += 1
        counts[2, labels[i + 2]] += 1
        counts[3, labels[i + 3]] += 1
    for i in range(len(labels) // 4 * 4, len(labels)):
        counts[0, labels[i]] += 1
    total: NDArray[np.int64] = counts.sum(axis=0)
    return total


@njit(cache=True, nogil=True)
def _look_up(labels: NDArray[np.uint8], number: NDArray[np.int32], out: NDArray[np.int32]) -> None:
    """Number of each label; eight at a time, as mostly they are equal."""
    count = len(labels) // 8
    eights = labels[: 8 * count].view(np.uint64)
    for k in range(count):
        one = number[labels[8 * k]]
        if eights[k] == np.uint64(labels[8 * k]) * np.uint64(0x0101010101010101):
            out[8 * k : 8 * k + 8] = one
        else:
            for i in range(8 * k, 8 * k + 8):
                out[i] = number[labels[i]]
    for i in range(8 * count, len(labels)):
        out[i] = number[labels[i]]


def warm_up() -> None:
    """Compile the kernels of this file."""
    from zsight_core.points import from_xyz

    v, u = np.mgrid[0:48, 0:48]
    planes_of_image(from_xyz(np.stack([u * 0.01, v * 0.01, np.ones((48, 48))], axis=-1)), least=100)
