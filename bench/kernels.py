"""Our kernels beside PCL's: the same clouds, taking turns, one thread each, in processor time.

Processor time of the calling thread (system calls included) is what both sides count, so that other programs on the
machine disturb the caches at most; on a quiet machine it equals the time on the clock. Then Open3D and small_gicp where
they do the same, whether results equal PCL's, how cost grows with size, and memory.
"""

from __future__ import annotations

import os
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np
from bench_clouds import TABLE, BenchCloud, clouds
from kernel_equality import equality_rows
from kernel_limits import limit_rows
from pcl_process import PclProcess
from progress import tell

from zsight_core.clusters import clusters_above
from zsight_core.files import pcd
from zsight_core.filters import box, pass_through, remove_nan
from zsight_core.image_normals import image_normals
from zsight_core.multi_plane import planes_of_image
from zsight_core.normals import normals
from zsight_core.outliers import remove_radius_outliers, remove_statistical_outliers
from zsight_core.pack_fields import concatenate
from zsight_core.plane import fit_robust, ransac_plane, select
from zsight_core.rigid import transform_points
from zsight_core.statistics import bounding_box, centroid
from zsight_core.table_height import fit_slab, table_height
from zsight_core.voxel_grid import voxel_grid

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from zsight_core.points import Points


os.environ.setdefault("OMP_NUM_THREADS", "1")  # before Open3D is loaded: one thread each

WARMING = 0.01
"""Seconds of work before a call that counts."""

ICP = "three ICP steps by small_gicp"

STREAMING = (
    "voxel grid 0.02",
    "voxel grid 0.005",
    "find plane: fit, select, copy",
    "table height",
    "slab plane fit",
    "transform",
    "remove NaN",
    "pass-through",
    "box",
    "bounding box",
    "centroid",
    "concatenate",
)
"""Kernels that go over the cloud once or twice: the aim is five copies of its memory."""


@dataclass(frozen=True)
class Task:
    """One kernel on one cloud: ours as a call, PCL's as a line for its process, and the ratio that must be reached."""

    name: str
    ours: Callable[[], object]
    peer: str
    target: float


def run(budget: float = 1.0, only: str = "") -> list[dict[str, Any]]:
    """Measure all kernels on all clouds.

    Args:
        budget: seconds to spend on a row.
        only: measure only rows whose name holds this.

    Returns:
        Rows as `zsight bench --json` prints them; ``value`` and ``peer_value`` are median milliseconds, ``ratio`` the
        median over pairs of PCL's time by ours, ``spread`` its 10th and 90th percentile, ``copies`` our time in
        copies of the cloud.
    """
    rows = []
    for row in measurements(budget, only):
        tell(f"{row['name']}: {row['value']} {row['unit']}")
        rows.append(row)
    return rows


def measurements(budget: float, only: str) -> Iterator[dict[str, Any]]:
    """The rows of `run`, as they are measured."""
    with TemporaryDirectory() as folder, PclProcess(Path(folder)) as pcl:
        for cloud in clouds(Path(folder)):
            pcl.load(cloud.file, cloud.T_world_camera)
            copy = copy_time(cloud.points)
            chosen = [task for task in tasks(cloud, Path(folder)) if only in f"{task.name}, {cloud.name}"]
            yield from (measured(task, cloud, copy, pcl, budget) for task in chosen)
            yield from peer_rows(chosen, cloud, budget)
            if only in f"{ICP}, {cloud.name}":
                yield registration_row(cloud, budget)
            yield from [] if only else equality_rows(cloud, pcl, patch_of(cloud.points, cloud.plane))
    yield from [] if only else limit_rows()


def peer_rows(chosen: list[Task], cloud: BenchCloud, budget: float) -> Iterator[dict[str, Any]]:
    """Open3D and small_gicp beside ours; they aim at other things, so there is no target but not to be slower."""
    from kernel_peers import peers

    others = peers(cloud.points)
    for task in chosen:
        for name, call in others.get(task.name, []):
            mine, theirs = pairs(task.ours, lambda call=call: timed(call), budget / 2)
            yield compared(f"{task.name}, {cloud.name}", mine, name, theirs, 1.0)


def registration_row(cloud: BenchCloud, budget: float) -> dict[str, Any]:
    """small_gicp, which zsight leaves registration to, beside Open3D."""
    from kernel_peers import registrations

    one, other = registrations(cloud.points)
    mine, theirs = pairs(one, lambda: timed(other), budget)
    return compared(f"{ICP}, {cloud.name}", mine, "Open3D", theirs, None)


def tasks(cloud: BenchCloud, scratch: Path) -> list[Task]:
    """What is measured on each cloud."""
    points, T, plane = cloud.points, cloud.T_world_camera, cloud.plane
    room = np.empty_like(points)
    dense = remove_nan(points)
    both = np.empty((1, points.size + dense.size), points.dtype)
    left, top, right, bottom = patch = patch_of(points, plane)
    low, high = 0.6, 1.2

    def find_plane() -> Points:
        return select(points, fit_robust(points[top:bottom, left:right]).plane, 0.01, room)

    def finder_chain() -> object:
        height = table_height(points, T, low, high)
        return fit_slab(points, T, height + 0.025, height + 0.045)

    coefficients = " ".join(map(repr, plane.coefficients().tolist()))
    clusters = f"clusters {coefficients} 0.02 0.4 0.02 100"
    files = {kind: scratch / f"{kind}.pcd" for kind in ("binary", "binary_compressed", "ascii")}
    for kind, file in files.items():
        pcd.write(file, points, encoding=kind, overwrite=True)  # type: ignore[arg-type]  # the keys are encodings
    ours, theirs = scratch / "ours.pcd", scratch / "theirs.pcd"

    def save(kind: Any) -> Callable[[], None]:
        return lambda: pcd.write(ours, points, encoding=kind, overwrite=True)

    return [
        Task("voxel grid 0.02", lambda: voxel_grid(points, 0.02, room), "voxel 0.02", 6),
        Task("voxel grid 0.005", lambda: voxel_grid(points, 0.005, room), "voxel 0.005", 5),
        Task("find plane: fit, select, copy", find_plane, f"find_plane {' '.join(map(str, patch))} 0.01", 5),
        Task("RANSAC plane", lambda: ransac_plane(dense, 0.01), "ransac 0.01 1000", 4),
        Task("table height", lambda: table_height(points, T, low, high), f"slabs {low} {high} 0.005", 50),
        Task(
            "slab plane fit",
            lambda: fit_slab(points, T, TABLE - 0.01, TABLE + 0.01),
            f"slab_fit {TABLE - 0.01} {TABLE + 0.01}",
            1,
        ),
        Task("object-finder chain", finder_chain, f"finder_chain {low} {high} 0.005", 30),
        Task("clusters above the plane", lambda: clusters_above(points, plane, 0.02, 0.4, 0.02, 100), clusters, 30),
        Task("normals and planes", lambda: planes_of_image(points), "multi_plane 0.02 10 1000 0.05235988 0.02", 10),
        Task("normals of an image", lambda: image_normals(points), "normals_image 0.02 10", 1),
        Task("normals by radius", lambda: normals(dense, 0.01), "normals_radius 0.01", 1),
        Task("radius outliers", lambda: remove_radius_outliers(dense, 0.01, 20), "radius_outliers 0.01 20", 1),
        Task(
            "statistical outliers", lambda: remove_statistical_outliers(dense, 50, 1.0), "statistical_outliers 50 1", 1
        ),
        Task("transform", lambda: transform_points(points, T, room), "transform", 2),
        Task("remove NaN", lambda: remove_nan(points, room), "remove_nan", 1.5),
        Task("pass-through", lambda: pass_through(points, "z", 0.7, 1.0, room), "pass_through 0.7 1.0", 1),
        Task(
            "box",
            lambda: box(points, [-0.3, -0.3, 0.5], [0.3, 0.3, 1.2], room),
            "crop_box -0.3 -0.3 0.5 0.3 0.3 1.2",
            1,
        ),
        Task("bounding box", lambda: bounding_box(points), "bounding_box", 1),
        Task("centroid", lambda: centroid(points), "centroid", 1),
        Task("concatenate", lambda: concatenate([points, dense], both), "concatenate", 1),
        Task("PCD load binary", lambda: pcd.read(files["binary"]), f"load_file {files['binary']}", 10),
        Task(
            "PCD load compressed",
            lambda: pcd.read(files["binary_compressed"]),
            f"load_file {files['binary_compressed']}",
            2,
        ),
        Task("PCD load ASCII", lambda: pcd.read(files["ascii"]), f"load_file {files['ascii']}", 6),
        Task("PCD save binary", save("binary"), f"save_file binary {theirs}", 1),
        Task("PCD save compressed", save("binary_compressed"), f"save_file compressed {theirs}", 1),
        Task("PCD save ASCII", save("ascii"), f"save_file ascii {theirs}", 1),
    ]


def patch_of(points: Points, plane: Any) -> tuple[int, int, int, int]:
    """A 60 x 60 pixel patch (u0, v0, u1, v1) that lies on the dominant plane as far as possible."""
    from zsight_core.plane import inliers

    near = inliers(points, plane, 0.01).astype(np.int32)
    sums = near.cumsum(axis=0).cumsum(axis=1)
    full = sums[60:, 60:] - sums[:-60, 60:] - sums[60:, :-60] + sums[:-60, :-60]
    v, u = np.unravel_index(int(full.argmax()), full.shape)
    return int(u) + 1, int(v) + 1, int(u) + 61, int(v) + 61


def measured(task: Task, cloud: BenchCloud, copy: float, pcl: PclProcess, budget: float) -> dict[str, Any]:
    """A row beside PCL, also as a multiple of the time of one copy of the cloud."""
    mine, theirs = pairs(task.ours, lambda: pcl.run(task.peer), budget)
    copies = round(float(np.median(mine)) / copy, 1)
    row = compared(f"{task.name}, {cloud.name}", mine, "PCL", theirs, task.target) | {"copies": copies}
    return row | {"in_5_copies": copies <= 5} if task.name in STREAMING else row


def pairs(ours: Callable[[], object], peer: Callable[[], float], budget: float) -> tuple[list[float], list[float]]:
    """Take turns until the budget is spent, at least 3 pairs.

    Each side works for some milliseconds before the call that counts, so that neither is charged for what the processor
    forgot while the other was at work. A pair of half a second or more does without, as that is nothing to it.
    """
    mine: list[float] = []
    theirs: list[float] = []
    end, slow = time.perf_counter() + budget, False
    while len(mine) < 200 and (time.perf_counter() < end or len(mine) < 3):
        for call, times in ((lambda: timed(ours), mine), (peer, theirs)):
            warm_until = 0.0 if slow else time.perf_counter() + WARMING
            while time.perf_counter() < warm_until:
                call()
            times.append(call())
        slow = mine[-1] + theirs[-1] >= 500
    return mine, theirs


def compared(name: str, mine: list[float], peer: str, theirs: list[float], target: float | None) -> dict[str, Any]:
    ratios = np.array(theirs) / np.array(mine)
    ratio = float(np.median(ratios))
    return {
        "name": name,
        "value": round(float(np.median(mine)), 4),
        "unit": "ms",
        "peer": peer,
        "peer_value": round(float(np.median(theirs)), 4),
        "ratio": round(ratio, 2),
        "spread": [round(float(edge), 2) for edge in np.percentile(ratios, [10, 90])],
        "pairs": len(mine),
        "target": target,
        "holds": None if target is None else ratio >= target,
    }


def timed(call: Callable[[], object]) -> float:
    """Milliseconds of one call; what it returns is let go after the clock stops."""
    begin = time.thread_time_ns()
    result = call()
    elapsed = (time.thread_time_ns() - begin) * 1e-6
    del result
    return elapsed


def copy_time(points: Points) -> float:
    """Milliseconds of one copy of the cloud's memory into memory that is there already."""
    source = (
        points.view(np.uint8).reshape(-1) if points.flags.c_contiguous else np.ascontiguousarray(points).view(np.uint8)
    )
    target = np.empty_like(source)
    return float(np.median([timed(lambda: np.copyto(target, source)) for _ in range(50)]))


if __name__ == "__main__":
    for found in measurements(1.0, " ".join(sys.argv[1:])):
        print(found, flush=True)
