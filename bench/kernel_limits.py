"""How the kernels' cost grows with the number of points, and how much memory they take beyond what they are given."""

from __future__ import annotations

import ctypes
import os
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from progress import tell

from zsight_core import scratch
from zsight_core.clusters import clusters_above
from zsight_core.filters import box, remove_nan
from zsight_core.image_normals import image_normals
from zsight_core.multi_plane import planes_of_image
from zsight_core.normals import normals
from zsight_core.outliers import remove_radius_outliers, remove_statistical_outliers
from zsight_core.pack_fields import concatenate
from zsight_core.plane import plane_through, ransac_plane, select
from zsight_core.points import from_xyz
from zsight_core.rigid import transform_points
from zsight_core.statistics import bounding_box
from zsight_core.table_height import table_height
from zsight_core.voxel_grid import voxel_grid

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from zsight_core.points import Points

SIZES = (10_000, 100_000, 1_000_000, 10_000_000)
MEMORY_SIZE = 4_000_000
PLANE = plane_through([0, -0.8, -0.6], [0, 0.5, 0.6667])
AREA_OF_A_POINT = 1e-5
"""Square metres: as dense as a 640 x 480 camera sees a table from 1.5 m, however many points there are."""


def surface(count: int) -> Points:
    """A noisy floor with boxes on it, organised, of this many points, all at one density."""
    height = int(np.sqrt(count * 3 / 4))
    width = count // height
    rng = np.random.default_rng(0)
    v, u = np.mgrid[0:height, 0:width].astype(np.float32) * np.float32(np.sqrt(AREA_OF_A_POINT))
    rise = np.where((u % 0.5 < 0.2) & (v % 0.5 < 0.2), 0.1, 0.0) + rng.normal(0, 5e-4, u.shape)
    across, down = np.array([1.0, 0, 0]), np.array([0, -0.6, 0.8])
    p = u[..., None] * across + v[..., None] * down + rise[..., None] * PLANE.normal + [0, 0.5, 2 / 3]
    p[rng.random(u.shape) < 0.05] = np.nan
    return from_xyz(p, rng.integers(0, 256, p.shape, dtype=np.uint8))


def kernels(points: Points, room: Points) -> dict[str, Callable[[], object]]:
    """What is measured; those that stream over the cloud first."""
    directions = np.full((*points.shape, 3), np.nan, np.float32)  # touched, so that its pages are there
    width = float(np.nanmax(points["x"]))
    return {
        "voxel grid 0.02": lambda: voxel_grid(points, 0.02, room),
        "plane inliers": lambda: select(points, PLANE, 0.01, room),
        "box": lambda: box(points, [0, -9e9, 0], [width / 2, 9e9, 9e9], room),
        "remove NaN": lambda: remove_nan(points, room),
        "transform": lambda: transform_points(points, np.eye(4), room),
        "bounding box": lambda: bounding_box(points),
        "table height": lambda: table_height(points, np.eye(4), 0.6, 1.2),
        "concatenate": lambda: concatenate([points], room),
        "RANSAC plane": lambda: ransac_plane(points, 0.01),
        "clusters above the plane": lambda: clusters_above(points, PLANE, 0.02, 0.4, 0.02, 100),
        "planes of an image": lambda: planes_of_image(points),
        "normals of an image": lambda: image_normals(points, out=directions),
        "normals by radius": lambda: normals(points, 0.01, directions),
        "radius outliers": lambda: remove_radius_outliers(points, 0.01, 10, room),
        "statistical outliers": lambda: remove_statistical_outliers(points, 20, 1.0, room),
    }


def limit_rows(budget: float = 1.0) -> list[dict[str, Any]]:
    """For each kernel the exponent of its cost, from the times at all sizes, and its extra memory at 4 M points."""
    times: dict[str, list[float]] = {}
    for count in SIZES:
        points = surface(count)
        for name, kernel in kernels(points, np.empty_like(points)).items():
            times.setdefault(name, []).append(fastest(kernel, budget) / points.size * 1e6)
            tell(f"{name}, {points.size} points: {times[name][-1]:.3g} ns a point")
            scratch.release()
    return [exponent_row(name, per_point) for name, per_point in times.items()] + memory_rows()


def fastest(kernel: Callable[[], object], budget: float) -> float:
    """Milliseconds of the quickest call within the budget, two at least: the first pays for fresh memory."""
    end, best, calls = time.perf_counter() + budget, np.inf, 0
    while calls < 2 or (time.perf_counter() < end and calls < 30):
        begin = time.thread_time_ns()
        kernel()
        best, calls = min(best, (time.thread_time_ns() - begin) * 1e-6), calls + 1
    return float(best)


def exponent_row(name: str, per_point: list[float]) -> dict[str, Any]:
    """Cost ~ count^exponent, by least squares over 100 k to 10 M; at 10 k a call's fixed cost still shows."""
    costs: NDArray[np.float64] = np.array(per_point[1:]) * np.array(SIZES[1:])
    exponent = float(np.polyfit(np.log(SIZES[1:]), np.log(costs), 1)[0])
    return {
        "name": f"{name}, exponent of cost by points",
        "value": round(exponent, 3),
        "unit": "",
        "target": 1.15,
        "holds": exponent <= 1.15,
        "ns_per_point": dict(zip(map(str, SIZES), (round(cost, 2) for cost in per_point), strict=True)),
    }


def memory_rows() -> list[dict[str, Any]]:
    """Peak of resident memory beyond that before the call, by the cloud's size; a given output is not counted.

    The cloud is large, as memory comes in pages of 2 MB, and the kernel has done a small one before, which brings in
    its code.
    """
    points, few = surface(MEMORY_SIZE), surface(SIZES[0])
    for kernel in kernels(points, np.zeros_like(points)).values():
        kernel()
    scratch.release()
    small, large = kernels(few, np.zeros_like(few)), kernels(points, np.zeros_like(points))
    return [memory_row(name, small[name], large[name], points.nbytes) for name in large]


def memory_row(name: str, small: Callable[[], object], large: Callable[[], object], cloud_bytes: int) -> dict[str, Any]:
    ctypes.CDLL(None).malloc_trim(0)  # or memory that was freed and kept would be taken again unseen
    extra = in_a_fork(lambda: extra_memory(small, large)) / cloud_bytes
    return {
        "name": f"{name}, extra memory by input",
        "value": round(extra, 2),
        "unit": "x",
        "target": 1.5,
        "holds": extra <= 1.5,
    }


def extra_memory(small: Callable[[], object], large: Callable[[], object]) -> int:
    small()
    before = resident("VmRSS")
    result = large()
    extra = resident("VmHWM") - before
    del result
    return max(extra, 0)


def in_a_fork(measure: Callable[[], int]) -> int:
    """What is measured in a copy of this process, whose peak so far is what it holds."""
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:
        os.write(writer, str(measure()).encode())
        os._exit(0)
    os.close(writer)
    os.waitpid(child, 0)
    with os.fdopen(reader) as answer:
        return int(answer.read())


def resident(field: str) -> int:
    """Bytes of a field of this process's status."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return int(next(line.split()[1] for line in lines if line.startswith(field))) * 1024


if __name__ == "__main__":
    for found in limit_rows():
        print(found)
