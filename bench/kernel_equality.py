"""Whether our kernels give what PCL gives: the same clouds, point by point."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from zsight_core.clusters import clusters_above
from zsight_core.filters import box, pass_through, remove_nan
from zsight_core.moments import plane_of_sums
from zsight_core.multi_plane import planes_of_image
from zsight_core.normals import normals
from zsight_core.outliers import remove_radius_outliers, remove_statistical_outliers
from zsight_core.plane import heights, plane_through, select
from zsight_core.points import xyz
from zsight_core.rigid import transform_points
from zsight_core.statistics import bounding_box
from zsight_core.table_height import slab_counts
from zsight_core.voxel_grid import voxel_grid

if TYPE_CHECKING:
    from bench_clouds import BenchCloud
    from numpy.typing import NDArray
    from pcl_process import PclProcess

    from zsight_core.points import Points

    Array = NDArray[Any]

ONE_SURFACE = math.cos(math.radians(9.0))


def equality_rows(cloud: BenchCloud, pcl: PclProcess, patch: tuple[int, int, int, int]) -> list[dict[str, Any]]:
    """Rows of differences, each with the most that is allowed."""
    points, dense = cloud.points, remove_nan(cloud.points)
    found = [
        *voxels(points, 0.02, pcl),
        *voxels(points, 0.005, pcl),
        ("points that remove NaN keeps, differing", unlike(remove_nan(points), of(pcl, "remove_nan")), 0),
        (
            "points that pass-through keeps, differing",
            unlike(pass_through(points, "z", 0.7, 1.0), of(pcl, "pass_through 0.7 1.0")),
            0,
        ),
        (
            "points that the box keeps, differing",
            unlike(box(points, [-0.3, -0.3, 0.5], [0.3, 0.3, 1.2]), of(pcl, "crop_box -0.3 -0.3 0.5 0.3 0.3 1.2")),
            0,
        ),
        ("transform, farthest apart, m", farthest(transform_points(points, cloud.T_world_camera), pcl), 2e-6),
        (
            "bounding box, apart, m",
            float(np.abs(np.concatenate(bounding_box(points)) - run(pcl, "bounding_box")).max()),
            0,
        ),
        ("plane inliers that differ, farthest from the threshold, m", plane_inliers(points, patch, pcl), 1e-5),
        ("slabs, points counted elsewhere, share", slabs(cloud, pcl), 1e-4),
        ("clusters, points in another", clusters(cloud, pcl), 0),
        (
            "radius outliers, points that differ",
            kept(dense, remove_radius_outliers(dense, 0.01, 20), pcl, "radius_outliers 0.01 20"),
            0,
        ),
        (
            "statistical outliers, points that differ, share",
            kept(dense, remove_statistical_outliers(dense, 50, 1.0), pcl, "statistical_outliers 50 1") / dense.size,
            1e-4,
        ),
        ("normals by radius, median angle, deg", normal_angle(dense, pcl), 0.2),
    ]
    planes, whole = plane_overlaps(points, pcl)
    rows = [row(f"{name}, {cloud.name}", value, most) for name, value, most in found]
    for name, values in (("PCL's planes, pieces of one surface joined", planes), ("PCL's planes as they are", whole)):
        if values:
            least = min(values)
            text = f"{name}: least IoU of {len(values)}, {cloud.name}"
            rows.append(row(text, least, 0.95) | {"holds": least >= 0.95 if values is planes else None})
    return rows


def row(name: str, value: float, most: float) -> dict[str, Any]:
    return {"name": name, "value": value, "unit": "", "peer": "PCL", "target": most, "holds": value <= most}


def run(pcl: PclProcess, task: str) -> Array:
    pcl.run(task)
    return pcl.result()


def of(pcl: PclProcess, task: str) -> Array:
    """A resulting cloud as rows of x y z and the colour's bits."""
    return run(pcl, task).reshape(-1, 4)


def rows_of(points: Points) -> Array:
    return np.ascontiguousarray(points).view(np.float32).reshape(-1, 4)


def unlike(ours: Points, theirs: Array) -> int:
    """Points that are not the same bit for bit, the colour's alpha left out."""
    mine = rows_of(ours)
    if len(mine) != len(theirs):
        return abs(len(mine) - len(theirs))
    one, other = mine.view(np.uint32).copy(), theirs.view(np.uint32).copy()
    one[:, 3] &= 0xFFFFFF
    other[:, 3] &= 0xFFFFFF
    return int((one != other).any(axis=1).sum())


def voxels(points: Points, leaf: float, pcl: PclProcess) -> list[tuple[str, float, float]]:
    mine, theirs = rows_of(voxel_grid(points, leaf)), of(pcl, f"voxel {leaf}")
    rows: list[tuple[str, float, float]] = [(f"voxels {leaf}, count, difference", abs(len(mine) - len(theirs)), 0)]
    if len(mine) == len(theirs):
        colours = (mine[:, 3].copy().view(np.uint32) ^ theirs[:, 3].copy().view(np.uint32)) & 0xFFFFFF
        rows.append((f"voxels {leaf}, colours that differ", int((colours != 0).sum()), 0))
        rows.append((f"voxels {leaf}, centroids apart, m", float(np.abs(mine[:, :3] - theirs[:, :3]).max()), 1e-5))
    return rows


def farthest(moved: Points, pcl: PclProcess) -> float:
    theirs = of(pcl, "transform")[:, :3]
    return float(np.nanmax(np.where(np.isfinite(theirs), np.abs(rows_of(moved)[:, :3] - theirs), np.nan)))


def plane_inliers(points: Points, patch: tuple[int, int, int, int], pcl: PclProcess) -> float:
    """By the plane of all points of the patch, as PCL's chain fits it: how far from the threshold a difference lies."""
    left, top, right, bottom = patch
    part = xyz(points[top:bottom, left:right]).reshape(-1, 3).astype(np.float64)
    part = part[np.isfinite(part).all(axis=1)]
    plane = plane_through(np.linalg.eigh(np.cov(part.T))[1][:, 0], part.mean(axis=0))
    theirs = np.zeros(points.size, np.bool_)
    theirs[run(pcl, f"find_plane {' '.join(map(str, patch))} 0.01").view(np.int32)] = True
    away = heights(points, plane).reshape(-1)
    differing = (np.abs(away) <= np.float32(0.01)) != theirs
    assert select(points, plane, 0.01).size == int((np.abs(away) <= np.float32(0.01)).sum())
    return float(np.abs(np.abs(away[differing]) - 0.01).max(initial=0.0))


def slabs(cloud: BenchCloud, pcl: PclProcess) -> float:
    edges = [0.6]
    while edges[-1] < 1.2:
        edges.append(edges[-1] + 0.005)
    mine, theirs = slab_counts(cloud.points, cloud.T_world_camera, np.array(edges)), run(pcl, "slabs 0.6 1.2 0.005")
    return float(np.abs(mine - theirs[: len(mine)]).sum() / max(theirs.sum(), 1))


def clusters(cloud: BenchCloud, pcl: PclProcess) -> int:
    coefficients = " ".join(map(repr, cloud.plane.coefficients().tolist()))
    theirs = run(pcl, f"clusters {coefficients} 0.02 0.4 0.02 100").view(np.int32)
    mine = clusters_above(cloud.points, cloud.plane, 0.02, 0.4, 0.02, 100).reshape(-1)
    pairs, counts = np.unique(np.stack([mine, theirs]), axis=1, return_counts=True)
    largest = np.zeros(mine.max() + 2, np.int64)
    np.maximum.at(largest, pairs[0] + 1, counts)
    return int(mine.size - largest.sum())


def kept(dense: Points, ours: Points, pcl: PclProcess, task: str) -> int:
    """Points that one keeps and the other does not."""
    theirs = np.zeros(dense.size, np.bool_)
    theirs[run(pcl, task).view(np.int32)] = True
    return len(set(map(bytes, rows_of(ours))) ^ set(map(bytes, rows_of(dense[0, theirs]))))


def normal_angle(dense: Points, pcl: PclProcess) -> float:
    theirs = run(pcl, "normals_radius 0.01").reshape(-1, 4)[:, :3]
    cosines = np.abs((normals(dense, 0.01)[0] * theirs).sum(axis=1))
    return float(np.degrees(np.arccos(np.clip(np.nanmedian(cosines), -1, 1))))


def plane_overlaps(points: Points, pcl: PclProcess) -> tuple[list[float], list[float]]:
    """Best intersection over union with one of ours for each of PCL's planes: joined as ours are, and as they are."""
    pcl.run("multi_plane 0.02 10 1000 0.05235988 0.02")
    theirs, mine = pcl.result().view(np.int32).reshape(points.shape), planes_of_image(points).labels
    return overlaps(joined(theirs, xyz(points).astype(np.float64)), mine), overlaps(theirs, mine)


def overlaps(theirs: Array, mine: Array) -> list[float]:
    return [
        max(
            float(((theirs == k) & (mine == j)).sum() / ((theirs == k) | (mine == j)).sum())
            for j in range(mine.max() + 1)
        )
        for k in np.unique(theirs[theirs >= 0])
    ]


def joined(labels: Array, p: Array) -> Array:
    """Give pieces that adjoin, and lie on each other's plane as ours must to be joined, one label."""
    result = labels.copy()
    touching = {
        (min(a, b), max(a, b))
        for one, other in ((labels[:, 1:], labels[:, :-1]), (labels[1:], labels[:-1]))
        for a, b in zip(*np.unique(np.stack([one[one != other], other[one != other]]), axis=1).tolist(), strict=True)
        if min(a, b) >= 0
    }
    for a, b in sorted(touching):
        large, small = (a, b) if (labels == a).sum() >= (labels == b).sum() else (b, a)
        (n, d), (m, _) = plane_of(p[labels == large]), plane_of(p[labels == small])
        if n @ m >= ONE_SURFACE and np.sqrt(np.mean((p[labels == small] @ n - d) ** 2)) <= 0.01:
            result[result == result[labels == b][0]] = result[labels == a][0]
    return result


def plane_of(p: Array) -> tuple[Array, float]:
    squares = [(p[:, a] * p[:, b]).sum() for a in range(3) for b in range(a, 3)]
    plane, _ = plane_of_sums(np.array([len(p), *p.sum(axis=0), *squares]))
    return plane[:3], float(plane[3])
