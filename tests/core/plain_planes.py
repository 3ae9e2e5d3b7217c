"""The planes of an image once more, step by step in numpy: what `zsight_core.multi_plane` must come to."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.ndimage import binary_dilation
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from zsight_core.points import xyz

if TYPE_CHECKING:
    from collections.abc import Sequence

    from zsight_core.points import Points

Rows = np.ndarray[Any, np.dtype[Any]]

WINDOW = 5


def planes_of_image(
    points: Points,
    least: int = 1000,
    angle: float = math.radians(3.0),
    distance: float = 0.02,
    depth_change: float = 0.02,
) -> tuple[Rows, Rows]:
    """Number of each pixel's plane (H, W), -1 in none, and the planes (K, 4) nx, ny, nz, d; as docs/decisions/0050."""
    p = xyz(points).astype(np.float32)
    cells = squares(p)
    free = ~near_an_edge(cells[..., :3], depth_change)
    region = regions(cells, free, 1.5 * angle, 2 * distance, max(4, least // 8))
    members = [cells[region == k].astype(np.float64) for k in range(region.max() + 1)]
    planes = np.array([fitted(part)[0] for part in members]).reshape(-1, 4)
    labels = painted(region, [k for k, part in enumerate(members) if is_flat(part)], p.shape[:2])
    labels = grown(labels, np.abs(p @ planes[:, :3].T - planes[:, 3]) < distance)
    whole = joined(labels, members, planes, 3 * angle, distance / 2)
    names, sizes = np.unique(whole[labels[labels >= 0]], return_counts=True)
    kept = [k for k in names[np.argsort(-sizes, kind="stable")] if sizes[names == k] >= least]
    number = np.full(len(members) + 1, -1)  # the last entry is that of label -1
    for place, k in enumerate(kept):
        number[:-1][whole == k] = place
    fits = [fitted(np.concatenate([members[m] for m in np.flatnonzero(whole == k)]))[0] for k in kept]
    return number[labels], np.array(fits).reshape(-1, 4)


def squares(p: Rows) -> Rows:
    """Means (H / 2, W / 2, 3) of 2 x 2 pixels."""
    height, width = p.shape[0] // 2, p.shape[1] // 2
    return np.asarray(p[: 2 * height, : 2 * width].reshape(height, 2, width, 2, 3).mean(axis=(1, 3)))


def near_an_edge(cells: Rows, depth_change: float) -> Rows:
    """True from where a hole or a jump in depth is less than a window away (diagonal steps count 1.4), or the border
    less than half of one."""
    z = cells[..., 2]
    edge: Rows = ~np.asarray(np.isfinite(cells).all(axis=2))
    for a, b in ((np.s_[:, :-1], np.s_[:, 1:]), (np.s_[:-1], np.s_[1:])):
        with np.errstate(invalid="ignore"):
            jump = ~(np.abs(z[a] - z[b]) <= 2 * depth_change * (1 + np.abs(z[a])))
        edge[a] |= jump
        edge[b] |= jump
    down, across = np.abs(np.mgrid[-WINDOW : WINDOW + 1, -WINDOW : WINDOW + 1])
    around = np.maximum(down, across) + 0.4 * np.minimum(down, across) < WINDOW - 1e-6
    near: Rows = binary_dilation(edge, around)
    half = WINDOW // 2
    inside = np.zeros(near.shape, np.bool_)
    inside[half:-half, half:-half] = True
    return np.asarray(near | ~inside)


def regions(cells: Rows, free: Rows, angle: float, distance: float, least: int) -> Rows:
    """Components (H / 2, W / 2) of cells linked to their neighbours, the largest first; -1 in none of so many cells."""
    normals = normals_of(cells)
    offset = (normals * cells).sum(axis=2)
    index = np.arange(free.size).reshape(free.shape)
    pairs = []
    for a, b in ((np.s_[:, :-1], np.s_[:, 1:]), (np.s_[1:], np.s_[:-1])):  # the depth is that of the left, the lower
        with np.errstate(invalid="ignore"):
            turned = (normals[a] * normals[b]).sum(axis=2) > math.cos(min(angle, math.pi))
            apart = np.abs(offset[a] - offset[b]) < distance * cells[a][..., 2] ** 2
        linked = turned & apart & free[a] & free[b]
        pairs.append(np.stack([index[a][linked], index[b][linked]]))
    first, second = np.concatenate(pairs, axis=1)
    graph = coo_array((np.ones(len(first)), (first, second)), shape=(free.size, free.size))
    component = connected_components(graph, directed=False)[1].reshape(free.shape)
    names, begins, sizes = np.unique(component[free], return_index=True, return_counts=True)
    found = np.full(free.shape, -1)
    large = [k for k in np.lexsort((begins, -sizes)) if sizes[k] >= least]
    for number, k in enumerate(large[:255]):
        found[free & (component == names[k])] = number
    return found


def normals_of(cells: Rows) -> Rows:
    """Unit normals (H / 2, W / 2, 3) towards the origin: cross product of the slopes in windows; 0 at the border."""
    p = cells.astype(np.float64)
    half = WINDOW // 2
    windows = np.lib.stride_tricks.sliding_window_view(p, (WINDOW, WINDOW), axis=(0, 1))
    step = np.arange(WINDOW) - half
    normals = np.zeros(p.shape)
    with np.errstate(invalid="ignore", divide="ignore"):
        across, down = (np.einsum(f"{axis},rwaij->rwa", step, windows) for axis in "ji")
        normal = np.cross(across, down)
        normal /= np.linalg.norm(normal, axis=2, keepdims=True)
        away = (normal * p[half:-half, half:-half]).sum(axis=2) > 0
    normals[half:-half, half:-half] = np.where(away[..., None], -normal, normal)
    return normals


def fitted(rows: Rows) -> tuple[Rows, Rows]:
    """Plane (4,) of least squares, its normal towards the origin, and the three variances, the least first."""
    middle = rows.mean(axis=0)
    variances, axes = np.linalg.eigh(np.cov(rows.T, bias=True))
    normal = axes[:, 0] if axes[:, 0] @ middle <= 0 else -axes[:, 0]
    return np.append(normal, normal @ middle), variances


def is_flat(rows: Rows) -> bool:
    """By PCL's bound on the curvature; what has no width is no plane either."""
    least, middle, most = fitted(rows)[1]
    return bool(least <= 1e-3 * (least + middle + most) and middle > 1e-12 * most)


def painted(region: Rows, flat: Sequence[int], shape: Sequence[int]) -> Rows:
    """Labels (H, W): of the pixels of all cells of flat regions."""
    labels = np.full(shape, -1)
    pixels = np.where(np.isin(region, flat), region, -1).repeat(2, axis=0).repeat(2, axis=1)
    labels[: pixels.shape[0], : pixels.shape[1]] = pixels
    return labels


def grown(labels: Rows, within: Rows) -> Rows:
    """Labels handed on to pixels within reach (H, W, K) of the plane: once right and down, once left and up."""
    reach, label = within.tolist(), labels.tolist()
    height, width = labels.shape
    ways = ((range(height - 1), range(width), 1), (range(height - 1, 0, -1), range(width - 1, -1, -1), -1))
    for rows, columns, side in ways:
        for r in rows:
            for c in columns:
                k = label[r][c]
                if k < 0:
                    continue
                if 0 <= c + side < width and label[r][c + side] < 0 and reach[r][c + side][k]:
                    label[r][c + side] = k
                if label[r + side][c] < 0 and reach[r + side][c][k]:
                    label[r + side][c] = k
    return np.array(label)


def joined(labels: Rows, members: list[Rows], planes: Rows, angle: float, distance: float) -> Rows:
    """For each region the lowest of those that are one surface with it: adjoining, and the smaller near the larger's
    plane."""
    touching = set()
    for one, other in ((labels[::4, :-1], labels[::4, 1:]), (labels[:-1, ::4], labels[1:, ::4])):
        touching |= {(min(a, b), max(a, b)) for a, b in zip(one.ravel(), other.ravel(), strict=True) if a != b}
    whole = np.arange(len(members))
    for a, b in sorted(touching):
        if a < 0 or planes[a, :3] @ planes[b, :3] < math.cos(min(angle, math.pi)):
            continue
        large, small = (a, b) if len(members[a]) >= len(members[b]) else (b, a)
        off = members[small] @ planes[large, :3] - planes[large, 3]
        if math.sqrt((off**2).mean()) <= distance:
            whole[whole == max(whole[a], whole[b])] = min(whole[a], whole[b])
    return whole
