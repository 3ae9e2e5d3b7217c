"""What stands on the support surfaces, parted into objects.

Pixels above a surface are grown into smooth patches; patches meet along borders that are convex, flat, concave or a
jump in depth. One object's patches meet convexly, two objects' concavely or not at all (the local convexity of
Stein et al., Object partitioning using local convexity, CVPR 2014). Which patches belong together is decided by adding
up signed border lengths and contracting the strongest first (greedy additive edge contraction, Keuper et al.,
ICCV 2015), so that one accidental convex pixel does not join two objects.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from zsight_core.jit import njit

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from zsight_core.view import View

__all__ = ["NO_DATA", "OBJECT", "OTHER", "SURFACE", "Patches", "grow_patches", "join_patches", "warm_up"]

NO_DATA, OTHER, SURFACE, OBJECT = 0, 1, 2, 3
"""Kinds of pixels: nothing measured; not over a surface; of a surface; above a surface."""

WINDOW = 3
"""Cells to each side over which a normal is taken."""

SAME_PATCH = float(np.cos(np.radians(20.0)))
"""Cosine of the largest angle between a cell's normal and that of the patch it joins."""

CONCAVE = np.radians(40.0)
"""Two patches that meet concavely at more than this angle are parted."""

SMOOTH = np.radians(20.0)
"""Two patches that meet at less than this angle are one, whichever way it bends."""

SMALLEST_PATCH = 6
"""Cells; smaller patches go to a neighbour."""

MOST_PATCHES = 500
"""Larger ones are kept of a scene with more: a crowded table has some 120, and what follows looks at all pairs."""


@dataclass(frozen=True, eq=False)
class Patches:
    """Smooth pieces of surface on a coarse grid of cells: every step-th pixel of every step-th row."""

    step: int
    label: NDArray[np.int32]
    """(R, C) patch number from 0, or -1."""
    normal: NDArray[np.float32]
    """(R, C, 3) unit normal toward the camera, optical frame; zeros where there is none."""
    count: NDArray[np.int64]
    """(K,) cells."""
    centroid: NDArray[np.float64]
    """(K, 3) metres, optical frame."""
    mean_normal: NDArray[np.float64]
    """(K, 3) unit, optical frame."""


def grow_patches(view: View, kind: NDArray[np.uint8], noise: float) -> Patches:
    """Grow smooth patches over the pixels that are OBJECT.

    Args:
        view: depth and pinhole.
        kind: (H, W) NO_DATA, OTHER, SURFACE or OBJECT.
        noise: standard deviation of 1 / z, 1/m.
    """
    step = max(1, round(view.depth.shape[1] / 320))
    depth, cells = _cells(view.depth, kind, step)
    pinhole = (view.fx / step, view.fy / step, view.cx / step, view.cy / step)
    normal = _normals(depth, cells, *pinhole, noise)
    label, count = _largest(*_grow(depth, cells, normal, *pinhole, noise, SAME_PATCH))
    centroid, mean_normal = _summarise(depth, label, normal, len(count), *pinhole)
    return Patches(step, label, normal, count, centroid, mean_normal)


def _largest(label: NDArray[np.int32], count: NDArray[np.int64]) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """Patches (R, C) and their cells (K,) without the smallest ones beyond MOST_PATCHES, numbered anew."""
    if len(count) <= MOST_PATCHES:
        return label, count
    kept = np.sort(np.argsort(-count, kind="stable")[:MOST_PATCHES])
    number = np.full(len(count) + 1, -1, np.int32)  # the last one is that of cells without a patch
    number[kept] = np.arange(MOST_PATCHES)
    return number[label], count[kept]


def join_patches(view: View, patches: Patches, noise: float) -> NDArray[np.int32]:
    """Which object each patch belongs to: (K,) numbers from 0."""
    step = patches.step
    depth = np.ascontiguousarray(view.depth[::step, ::step])
    pinhole = (view.fx / step, view.fy / step, view.cx / step, view.cy / step)
    weights = _border_weights(
        depth, patches.label, patches.normal, len(patches.count), *pinhole, noise, CONCAVE, SMOOTH
    )
    return _contract(weights)


def warm_up() -> None:
    """Compile the kernels (or load them from their cache)."""
    depth = np.ones((24, 24), np.float32)
    kind = np.full((24, 24), OBJECT, np.uint8)
    coarse, cells = _cells(depth, kind, 2)
    normal = _normals(coarse, cells, 10.0, 10.0, 6.0, 6.0, 1e-3)
    label, count = _grow(coarse, cells, normal, 10.0, 10.0, 6.0, 6.0, 1e-3, SAME_PATCH)
    _summarise(coarse, label, normal, len(count), 10.0, 10.0, 6.0, 6.0)
    _contract(_border_weights(coarse, label, normal, len(count), 10.0, 10.0, 6.0, 6.0, 1e-3, CONCAVE, SMOOTH))


@njit(cache=True, nogil=True, error_model="numpy")
def _cells(
    depth: NDArray[np.float32], kind: NDArray[np.uint8], step: int
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Depth (R, C) of every step-th pixel, and whether it is OBJECT."""
    rows, columns = (depth.shape[0] + step - 1) // step, (depth.shape[1] + step - 1) // step
    coarse = np.empty((rows, columns), np.float32)
    cells = np.empty((rows, columns), np.bool_)
    for r in range(rows):
        for c in range(columns):
            coarse[r, c] = depth[r * step, c * step]
            cells[r, c] = kind[r * step, c * step] == 3
    return coarse, cells


@njit(cache=True, nogil=True, error_model="numpy")
def _normals(
    depth: NDArray[np.float32],
    cells: NDArray[np.bool_],
    fx: float,
    fy: float,
    cx: float,
    cy: float,
    noise: float,
) -> NDArray[np.float32]:
    """Unit normals (R, C, 3) of planes fitted in inverse depth to the cells around."""
    rows, columns = depth.shape
    normal = np.zeros((rows, columns, 3), np.float32)
    for r in range(rows):
        for c in range(columns):
            if not cells[r, c]:
                continue
            z0 = depth[r, c]
            w0 = 1.0 / z0
            gate = 0.012 + 4 * noise * z0 * z0
            slope = 1.7 * z0 / fx
            n, sx, sy, sxx, sxy, syy, sw, swx, swy = 0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            for j in range(max(0, r - WINDOW), min(rows, r + WINDOW + 1)):
                for i in range(max(0, c - WINDOW), min(columns, c + WINDOW + 1)):
                    if not cells[j, i]:
                        continue
                    z = depth[j, i]
                    if abs(z - z0) > gate * 0.6 + slope * max(abs(j - r), abs(i - c)):
                        continue
                    x, y, w = (i - c) / fx, (j - r) / fy, 1.0 / z - w0
                    n += 1
                    sx += x
                    sy += y
                    sxx += x * x
                    sxy += x * y
                    syy += y * y
                    sw += w
                    swx += w * x
                    swy += w * y
            if n < 6:
                continue
            mx, my, mw = sx / n, sy / n, sw / n
            a, b, d = sxx - n * mx * mx, sxy - n * mx * my, syy - n * my * my
            p, q = swx - n * mx * mw, swy - n * my * mw
            det = a * d - b * b
            if det <= 1e-2 * a * d or det <= 0:
                continue
            A, B = (d * p - b * q) / det, (a * q - b * p) / det
            C = w0 + mw - A * (mx + (c - cx) / fx) - B * (my + (r - cy) / fy)
            length = -np.sqrt(A * A + B * B + C * C)
            normal[r, c, 0], normal[r, c, 1], normal[r, c, 2] = A / length, B / length, C / length
    return normal


@njit(cache=True, nogil=True, error_model="numpy")
def _grow(  # noqa: C901  one compiled loop over pixels; splitting it would pass a dozen numbers around
    depth: NDArray[np.float32],
    cells: NDArray[np.bool_],
    normal: NDArray[np.float32],
    fx: float,
    fy: float,
    cx: float,
    cy: float,
    noise: float,
    same: float,
) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """Patch of each cell (R, C), flattest cells first, and cells a patch (K,)."""
    rows, columns = depth.shape
    label = np.full((rows, columns), -1, np.int32)
    total = 0
    for r in range(rows):
        for c in range(columns):
            if cells[r, c]:
                total += 1
    # order cells by how much the normals around them differ: 32 bins, stable
    bins = np.full((rows, columns), 255, np.uint8)
    counts = np.zeros(33, np.int64)
    for r in range(rows):
        for c in range(columns):
            if not cells[r, c] or not normal[r, c].any():
                continue
            worst = 1.0
            for k in range(4):
                j, i = r + (2, -2, 0, 0)[k], c + (0, 0, 2, -2)[k]
                if 0 <= j < rows and 0 <= i < columns and cells[j, i]:
                    cosine = (
                        normal[r, c, 0] * normal[j, i, 0]
                        + normal[r, c, 1] * normal[j, i, 1]
                        + normal[r, c, 2] * normal[j, i, 2]
                    )
                    worst = min(worst, cosine)
                else:
                    worst = min(worst, 0.98)
            bins[r, c] = min(31, int((1.0 - worst) * 320))
            counts[bins[r, c] + 1] += 1
    for k in range(32):
        counts[k + 1] += counts[k]
    order = np.empty(counts[32], np.int64)
    for r in range(rows):
        for c in range(columns):
            if bins[r, c] != 255:
                order[counts[bins[r, c]]] = r * columns + c
                counts[bins[r, c]] += 1
    queue = np.empty(total + 1, np.int64)
    sizes = np.zeros(total + 1, np.int64)
    patches = 0
    for seed in order:
        if label[seed // columns, seed % columns] >= 0:
            continue
        head, tail = 0, 1
        queue[0] = seed
        label[seed // columns, seed % columns] = patches
        s0, s1, s2 = 0.0, 0.0, 0.0
        m0, m1, m2 = 0.0, 0.0, 0.0  # mean normal, used once it stands on a few cells
        while head < tail:
            at = queue[head]
            head += 1
            r, c = at // columns, at % columns
            n0, n1, n2 = normal[r, c, 0], normal[r, c, 1], normal[r, c, 2]
            s0, s1, s2 = s0 + n0, s1 + n1, s2 + n2
            if head <= 8 or head % 8 == 0:
                length = np.sqrt(s0 * s0 + s1 * s1 + s2 * s2)
                m0, m1, m2 = s0 / length, s1 / length, s2 / length
            z = depth[r, c]
            x, y = (c - cx) / fx * z, (r - cy) / fy * z
            gate = 0.0025 + 3 * noise * z * z
            for k in range(4):
                j, i = r + (1, -1, 0, 0)[k], c + (0, 0, 1, -1)[k]
                if not (0 <= j < rows and 0 <= i < columns) or not cells[j, i] or label[j, i] >= 0:
                    continue
                if bins[j, i] == 255:
                    continue
                q0, q1, q2 = normal[j, i, 0], normal[j, i, 1], normal[j, i, 2]
                if q0 * m0 + q1 * m1 + q2 * m2 < same:
                    continue
                zq = depth[j, i]
                dx, dy, dz = (i - cx) / fx * zq - x, (j - cy) / fy * zq - y, zq - z
                if abs(n0 * dx + n1 * dy + n2 * dz) > gate and abs(q0 * dx + q1 * dy + q2 * dz) > gate:
                    continue
                label[j, i] = patches
                queue[tail] = j * columns + i
                tail += 1
        sizes[patches] = tail
        patches += 1
    return _fill(depth, cells, label, sizes[:patches], noise)


@njit(cache=True, nogil=True, error_model="numpy")
def _fill(  # noqa: C901  one compiled loop over pixels; splitting it would pass a dozen numbers around
    depth: NDArray[np.float32],
    cells: NDArray[np.bool_],
    label: NDArray[np.int32],
    sizes: NDArray[np.int64],
    noise: float,
) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """Give cells of tiny or no patches to the neighbour nearest in depth; islands become patches; renumber."""
    rows, columns = depth.shape
    renumber = np.full(len(sizes), -1, np.int32)
    kept = 0
    for k in range(len(sizes)):
        if sizes[k] >= SMALLEST_PATCH:
            renumber[k] = kept
            kept += 1
    front = np.empty(rows * columns, np.int64)
    head, tail = 0, 0
    for r in range(rows):
        for c in range(columns):
            if label[r, c] >= 0:
                label[r, c] = renumber[label[r, c]]
                if label[r, c] >= 0:
                    front[tail] = r * columns + c
                    tail += 1
    while head < tail:
        r, c = front[head] // columns, front[head] % columns
        head += 1
        z = depth[r, c]
        gate = 0.008 + 4 * noise * z * z
        for k in range(4):
            j, i = r + (1, -1, 0, 0)[k], c + (0, 0, 1, -1)[k]
            if 0 <= j < rows and 0 <= i < columns and cells[j, i] and label[j, i] < 0 and abs(depth[j, i] - z) < gate:
                best, gap = label[r, c], abs(depth[j, i] - z)
                for q in range(4):  # of all labelled neighbours the one nearest in depth
                    jj, ii = j + (1, -1, 0, 0)[q], i + (0, 0, 1, -1)[q]
                    if (
                        0 <= jj < rows
                        and 0 <= ii < columns
                        and label[jj, ii] >= 0
                        and abs(depth[jj, ii] - depth[j, i]) < gap
                    ):
                        best, gap = label[jj, ii], abs(depth[jj, ii] - depth[j, i])
                label[j, i] = best
                front[tail] = j * columns + i
                tail += 1
    for r in range(rows):  # islands without a smooth patch, thin things: connected pieces
        for c in range(columns):
            if not cells[r, c] or label[r, c] >= 0:
                continue
            head, tail = 0, 1
            front[0] = r * columns + c
            label[r, c] = kept
            while head < tail:
                rr, cc = front[head] // columns, front[head] % columns
                head += 1
                gate = 0.008 + 4 * noise * depth[rr, cc] * depth[rr, cc]
                for k in range(4):
                    j, i = rr + (1, -1, 0, 0)[k], cc + (0, 0, 1, -1)[k]
                    free = 0 <= j < rows and 0 <= i < columns and cells[j, i] and label[j, i] < 0
                    if free and abs(depth[j, i] - depth[rr, cc]) < gate:
                        label[j, i] = kept
                        front[tail] = j * columns + i
                        tail += 1
            if tail >= SMALLEST_PATCH:
                kept += 1
            else:
                for k in range(tail):
                    label[front[k] // columns, front[k] % columns] = -2
    counts = np.zeros(kept, np.int64)
    for r in range(rows):
        for c in range(columns):
            if label[r, c] >= 0:
                counts[label[r, c]] += 1
            else:
                label[r, c] = -1
    return label, counts


@njit(cache=True, nogil=True, error_model="numpy")
def _summarise(
    depth: NDArray[np.float32],
    label: NDArray[np.int32],
    normal: NDArray[np.float32],
    patches: int,
    fx: float,
    fy: float,
    cx: float,
    cy: float,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Centroid and mean normal (K, 3) of each patch."""
    centroid, mean_normal, count = np.zeros((patches, 3)), np.zeros((patches, 3)), np.zeros(patches)
    for r in range(depth.shape[0]):
        for c in range(depth.shape[1]):
            k = label[r, c]
            if k >= 0:
                z = depth[r, c]
                centroid[k, 0] += (c - cx) / fx * z
                centroid[k, 1] += (r - cy) / fy * z
                centroid[k, 2] += z
                count[k] += 1
                for a in range(3):
                    mean_normal[k, a] += normal[r, c, a]
    for k in range(patches):
        length = np.sqrt(mean_normal[k, 0] ** 2 + mean_normal[k, 1] ** 2 + mean_normal[k, 2] ** 2)
        for a in range(3):
            centroid[k, a] /= max(count[k], 1.0)
            if length > 0:
                mean_normal[k, a] /= length
    return centroid, mean_normal


@njit(cache=True, nogil=True, error_model="numpy")
def _border_weights(  # noqa: C901  one compiled loop over pixels; splitting it would pass a dozen numbers around
    depth: NDArray[np.float32],
    label: NDArray[np.int32],
    normal: NDArray[np.float32],
    patches: int,
    fx: float,
    fy: float,
    cx: float,
    cy: float,
    noise: float,
    concave: float,
    smooth: float,
) -> NDArray[np.float64]:
    """Signed border lengths (K, K): above zero where two patches are of one object, below where they are not."""
    rows, columns = depth.shape
    touch = np.zeros((patches, patches))
    jump = np.zeros((patches, patches))
    border = np.zeros((patches, patches, 13))
    for r in range(rows):
        for c in range(columns):
            a = label[r, c]
            if a < 0:
                continue
            for way in range(2):
                dr, dc = (0, 1)[way], (1, 0)[way]
                if r + dr < rows and c + dc < columns:
                    b = label[r + dr, c + dc]
                    if b >= 0 and b != a:
                        z = depth[r, c]
                        lo, hi = min(a, b), max(a, b)
                        if abs(depth[r + dr, c + dc] - z) > 0.008 + 4 * noise * z * z:
                            jump[lo, hi] += 1
                        else:
                            touch[lo, hi] += 1
                for apart in (4, 6):
                    j, i = r + dr * apart, c + dc * apart
                    if j >= rows or i >= columns:
                        continue
                    b = label[j, i]
                    if b < 0 or b == a:
                        continue
                    between = True
                    for k in range(1, apart):
                        other = label[r + dr * k, c + dc * k]
                        if other != a and other != b:
                            between = False
                    if not between:
                        continue
                    if normal[r, c, 2] == 0 or normal[j, i, 2] == 0:
                        continue
                    lo, hi = min(a, b), max(a, b)
                    m = border[lo, hi]
                    m[12] += 1
                    za, zb = depth[r, c], depth[j, i]
                    first = 0 if a < b else 6
                    for k in range(3):
                        m[first + k] += normal[r, c, k]
                        m[6 - first + k] += normal[j, i, k]
                    m[first + 3] += (c - cx) / fx * za
                    m[first + 4] += (r - cy) / fy * za
                    m[first + 5] += za
                    m[6 - first + 3] += (i - cx) / fx * zb
                    m[6 - first + 4] += (j - cy) / fy * zb
                    m[6 - first + 5] += zb
    weights = np.zeros((patches, patches))
    for a in range(patches):
        for b in range(a + 1, patches):
            together, apart_ = touch[a, b], jump[a, b]
            if together + apart_ == 0:
                continue
            weight = -apart_
            m = border[a, b]
            if m[12] < 2:
                weight += 0.5 * together  # too short to tell how it bends
            else:
                la = np.sqrt(m[0] ** 2 + m[1] ** 2 + m[2] ** 2)
                lb = np.sqrt(m[6] ** 2 + m[7] ** 2 + m[8] ** 2)
                cosine = (m[0] * m[6] + m[1] * m[7] + m[2] * m[8]) / (la * lb)
                angle = np.arccos(min(1.0, max(-1.0, cosine)))
                bend = 0.0
                for k in range(3):
                    bend += (m[k] / la - m[6 + k] / lb) * (m[3 + k] - m[9 + k])
                if angle < smooth or bend > 0:
                    weight += together
                elif angle > concave:
                    weight -= together * min(2.0, angle / concave)
                else:
                    weight += together * (1.0 - 2.0 * (angle - smooth) / (concave - smooth))
            weights[a, b] = weights[b, a] = weight
    return weights


@njit(cache=True, nogil=True, error_model="numpy")
def _contract(weights: NDArray[np.float64]) -> NDArray[np.int32]:  # noqa: C901  one compiled loop
    """Greedy additive edge contraction: join the pair with the largest weight above zero until there is none."""
    count = len(weights)
    owner = np.arange(count).astype(np.int32)
    alive = np.ones(count, np.bool_)
    most, with_ = np.zeros(count), np.full(count, -1, np.int64)  # the best partner of each among those after it
    for i in range(count):
        _best_partner(weights, alive, i, most, with_)
    while True:
        best, a = 0.0, -1
        for i in range(count):
            if alive[i] and most[i] > best:
                best, a = most[i], i
        if a < 0:
            break
        b = with_[a]
        alive[b] = False
        for k in range(count):
            if owner[k] == b:
                owner[k] = a
            if k not in (a, b):
                weights[a, k] += weights[b, k]
                weights[k, a] += weights[k, b]
        for i in range(b):
            if alive[i] and (i <= a or with_[i] == b):
                _best_partner(weights, alive, i, most, with_)
    number = np.full(count, -1, np.int32)
    objects = 0
    for k in range(count):
        if alive[k]:
            number[k] = objects
            objects += 1
    for k in range(count):
        owner[k] = number[owner[k]]
    return owner


@njit(cache=True, nogil=True, error_model="numpy")
def _best_partner(
    weights: NDArray[np.float64],
    alive: NDArray[np.bool_],
    i: int,
    most: NDArray[np.float64],
    with_: NDArray[np.int64],
) -> None:
    """Note the largest weight above zero of one patch with those alive after it, and with which it has that."""
    most[i], with_[i] = 0.0, -1
    for j in range(i + 1, len(alive)):
        if alive[j] and weights[i, j] > most[i]:
            most[i], with_[i] = weights[i, j], j
