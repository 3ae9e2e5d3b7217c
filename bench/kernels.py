"""Our kernels beside PCL's: the same clouds, taking turns, one thread each, in processor time.

Processor time of the calling thread (system calls included) is what both sides count, so that other programs on the
machine disturb the caches at most; on a quiet machine it equals the time on the clock.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np
from bench_clouds import TABLE, BenchCloud, clouds
from pcl_process import PclProcess

from zsight_core import pcd
from zsight_core.filters import box, pass_through, remove_nan
from zsight_core.pack_fields import concatenate
from zsight_core.plane import fit_robust, ransac_plane, select
from zsight_core.rigid import transform_points
from zsight_core.statistics import bounding_box, centroid
from zsight_core.table_height import fit_slab, table_height
from zsight_core.voxel_grid import voxel_grid

if TYPE_CHECKING:
    from collections.abc import Callable

    from zsight_core.points import Points


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
    with TemporaryDirectory() as folder, PclProcess(Path(folder)) as pcl:
        for cloud in clouds(Path(folder)):
            pcl.load(cloud.file, cloud.T_world_camera)
            copy = copy_time(cloud.points)
            chosen = [task for task in tasks(cloud, Path(folder)) if only in f"{task.name}, {cloud.name}"]
            rows += [measured(task, cloud, copy, pcl, budget) for task in chosen]
    return rows


def tasks(cloud: BenchCloud, scratch: Path) -> list[Task]:
    """What is measured on each cloud."""
    points, T, plane = cloud.points, cloud.T_world_camera, cloud.plane
    room = np.empty_like(points)
    dense = remove_nan(points)
    left, top, right, bottom = patch = patch_of(points, plane)
    low, high = 0.6, 1.2

    def find_plane() -> Points:
        return select(points, fit_robust(points[top:bottom, left:right]).plane, 0.01, room)

    def finder_chain() -> object:
        height = table_height(points, T, low, high)
        return fit_slab(points, T, height + 0.025, height + 0.045)

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
        Task("concatenate", lambda: concatenate([points, dense]), "concatenate", 1),
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
    """Take turns until the budget is spent, at least 5 pairs.

    Each turn does the task twice and counts the second time: what the other side left in the caches is not charged.
    """
    mine, theirs = [], []
    end = time.perf_counter() + budget
    while len(mine) < 5 or (time.perf_counter() < end and len(mine) < 200):
        task.ours()
        mine.append(timed(task.ours))
        pcl.run(task.peer)
        theirs.append(pcl.run(task.peer))
    ratios = np.array(theirs) / np.array(mine)
    ratio = float(np.median(ratios))
    return {
        "name": f"{task.name}, {cloud.name}",
        "value": round(float(np.median(mine)), 4),
        "unit": "ms",
        "peer": "PCL",
        "peer_value": round(float(np.median(theirs)), 4),
        "ratio": round(ratio, 2),
        "spread": [round(float(edge), 2) for edge in np.percentile(ratios, [10, 90])],
        "pairs": len(mine),
        "copies": round(float(np.median(mine)) / copy, 1),
        "target": task.target,
        "holds": ratio >= task.target,
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


def table(rows: list[dict[str, Any]]) -> str:
    """The rows as text, one a line."""
    line = "{name:44s} {value:9.3f} {peer_value:9.3f} ms  x{ratio:<7} {spread!s:18} {copies:6} copies  "
    line += "{target:>4} {verdict}"
    return "\n".join(line.format(**row, verdict="holds" if row["holds"] else "MISSED") for row in rows)


if __name__ == "__main__":
    import sys

    print(table(run(only=" ".join(sys.argv[1:]))))
