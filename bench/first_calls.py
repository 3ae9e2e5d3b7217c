"""What the first call of a kernel costs beyond its second, with warm kernels, in a process that has called another."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np
from kernel_limits import PLANE, kernels, surface
from progress import tell

from zsight_core.above_plane import points_above
from zsight_core.clusters import euclidean_clusters, image_clusters
from zsight_core.connected import connected_to
from zsight_core.depth_image import from_points, to_points
from zsight_core.files import pcd
from zsight_core.filters import finite_mask, matching_colour, pass_through
from zsight_core.pinhole import Pinhole
from zsight_core.plane import fit_robust
from zsight_core.statistics import average_colour, bounding_box, centroid
from zsight_core.table_height import fit_slab

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from zsight_core.points import Points

_TARGET = 50.0  # milliseconds
_SIZE = 10_000  # points


def first_call_rows(tries: int = 3) -> list[dict[str, Any]]:
    """A row for each kernel: milliseconds of processor time, median of some processes."""
    with TemporaryDirectory() as folder:
        names = list(calls(surface(_SIZE), Path(folder)))
    return [row(name, [beyond_second(name) for _ in range(tries)]) for name in names]


def calls(points: Points, folder: Path) -> dict[str, Callable[[], object]]:
    """Every kernel that a caller may begin with."""
    everywhere = np.ones(points.shape, np.bool_)
    pinhole = Pinhole(points.shape[1], points.shape[0], 100.0, 100.0, points.shape[1] / 2, points.shape[0] / 2)
    depth = np.ones(points.shape, np.float32)
    files = {encoding: folder / f"{encoding}.pcd" for encoding in ("ascii", "binary", "binary_compressed")}

    def write_and_read(encoding: Any) -> object:
        pcd.write(files[encoding], points, encoding=encoding, overwrite=True)
        return pcd.read(files[encoding])

    return {
        **kernels(points, np.empty_like(points)),
        "robust plane": lambda: fit_robust(points),
        "slab plane fit": lambda: fit_slab(points, np.eye(4), 0.6, 1.2),
        "points above a plane": lambda: points_above(points, PLANE, 0.02, 0.5, everywhere),
        "connected points": lambda: connected_to(points, everywhere, everywhere, 0.01),
        "clusters": lambda: euclidean_clusters(points, 0.01, 100),
        "clusters of an image": lambda: image_clusters(points, everywhere, 0.01),
        "pass-through": lambda: pass_through(points, "z", 0.7, 1.0),
        "finite points": lambda: finite_mask(points),
        "points of a colour": lambda: matching_colour(points, (128, 128, 128), 90),
        "centroid": lambda: centroid(points),
        "average colour": lambda: average_colour(points),
        "depth image": lambda: from_points(points, pinhole),
        "points of a depth image": lambda: to_points(depth, pinhole),
        **{f"PCD {encoding}": lambda encoding=encoding: write_and_read(encoding) for encoding in files},
    }


def beyond_second(name: str) -> float:
    """Milliseconds by which the first call in a process of its own takes longer than the second."""
    command = [sys.executable, __file__, name]
    return float(json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout))


def two_calls(name: str) -> Iterator[float]:
    """Milliseconds of processor time of the first call and of the second."""
    points = surface(_SIZE)
    bounding_box(points[:9])
    with TemporaryDirectory() as folder:
        call = calls(points, Path(folder))[name]
        for _ in range(2):
            begin = time.process_time_ns()
            call()
            yield (time.process_time_ns() - begin) * 1e-6


def row(name: str, times: list[float]) -> dict[str, Any]:
    value = float(np.median(times))
    tell(f"first call of {name}: {value:.1f} ms beyond the second")
    return {
        "name": f"first call of {name}, beyond its second",
        "value": round(value, 1),
        "unit": "ms",
        "spread": [round(min(times), 1), round(max(times), 1)],
        "target": _TARGET,
        "holds": value < _TARGET,
    }


if __name__ == "__main__":
    first, second = two_calls(sys.argv[1])
    print(json.dumps(first - second))
