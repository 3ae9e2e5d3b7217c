"""How long the finder takes for clouds of ten million points, and how much memory, organised and not.

The book's scene as a camera of 4000 x 2500 pixels would see it, as an image and as a row of points without order; each
in a process of its own, whose greatest memory is that of the cloud, the library and the search together.
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
from time import process_time
from typing import Any

import numpy as np
from bench_row import row

WIDTH, HEIGHT = 4000, 2500
SECONDS, MEGABYTES = 20.0, 2000.0
"""What is taken for bounded; a Kinect's cloud has 0.3 million points."""


def run() -> list[dict[str, Any]]:
    """Rows as ``zsight bench --json`` prints them."""
    return [row for kind in ("organised", "unorganised") for row in _rows(kind, _measured(kind))]


def _measured(kind: str) -> dict[str, float]:
    """What a process of its own measured."""
    ended = subprocess.run([sys.executable, __file__, kind], capture_output=True, text=True, check=True, timeout=600)
    figures: dict[str, float] = json.loads(ended.stdout)
    return figures


def _rows(kind: str, figures: dict[str, float]) -> list[dict[str, Any]]:
    name = f"large clouds {WIDTH * HEIGHT / 1e6:g} M points {kind}"
    return [
        row(f"{name} scene and find CPU", figures["seconds"], "s", SECONDS),
        row(f"{name} memory beside the cloud", figures["beside_mb"], "MB", MEGABYTES),
        row(f"{name} position error", figures["error_mm"], "mm", None),
    ]


def measure(kind: str) -> dict[str, float]:
    """Search the block in one cloud."""
    from zsight_core import find
    from zsight_core.model import Box, ObjectModel
    from zsight_core.pinhole import Pinhole
    from zsight_core.points import from_xyz, xyz
    from zsight_core.simulation.camera import capture
    from zsight_core.simulation.random_scenes import draw_scene
    from zsight_core.simulation.world import Camera

    block = ObjectModel("toy_block", Box((0.035, 0.2, 0.035)))
    book = draw_scene("book", 0, [block])
    scale = WIDTH / 640
    pinhole = Pinhole(WIDTH, HEIGHT, 554.38 * scale, 554.38 * scale, (WIDTH - 1) / 2, (HEIGHT - 1) / 2)
    points = capture(book.world, Camera(pinhole, book.T_world_camera))
    if kind == "unorganised":
        flat = xyz(points).reshape(-1, 3)
        order = np.random.default_rng(0).permutation(len(flat))
        points = from_xyz(flat[order].reshape(1, -1, 3))
        del flat, order
    find.warm_up()
    before = _resident()
    start = process_time()
    answer = find.find(points, [block], T_world_camera=book.T_world_camera)
    seconds = process_time() - start
    after = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    T = book.T_world_camera @ answer.detections[0].T_camera_model if answer.detections else np.full((4, 4), np.nan)
    error = float(np.linalg.norm(T[:3, 3] - book.objects[0].T_world_model[:3, 3]) * 1e3)
    return {"seconds": seconds, "beside_mb": max(after - before, 0.0), "error_mm": error}


def _resident() -> float:
    """Megabytes that this process holds now."""
    with open("/proc/self/statm", encoding="ascii") as file:  # noqa: PTH123  no file to speak of
        return int(file.read().split()[1]) * resource.getpagesize() / 2**20


if __name__ == "__main__":
    print(json.dumps(measure(sys.argv[1])))
