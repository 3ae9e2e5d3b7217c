"""How soon a real finder stops its work when a goal is cancelled, on a crowded scene."""

from __future__ import annotations

import subprocess
import sys
import threading
import time
from typing import TYPE_CHECKING

import numpy as np

from zsight.catalogue.type_files import load, shipped_folder
from zsight.client import CellClient
from zsight.network import Network
from zsight.runtime import host_name, join
from zsight_core.files import pcd
from zsight_core.model import Surface
from zsight_core.simulation.camera import expose
from zsight_core.simulation.kinect import Kinect
from zsight_core.simulation.random_scenes import draw_scene
from zsight_core.transform import quaternion
from zsight_protocol.action import GoalState

if TYPE_CHECKING:
    from pathlib import Path

    from zsight.bus import Bus

__all__ = ["cancel_waits"]

CANCELS, SEED = 100, 7
READY = 120.0  # seconds that a finder may take to start


def cancel_waits(endpoint: str, folder: Path) -> list[float]:
    """Milliseconds from a cancel, at a random moment of the work, to the goal's end as cancelled.

    A finder ends a cancelled goal when its work has stopped, so that is what is measured, with the way there and back.
    """
    scene = _crowded_scene(folder)
    names = ("camera", "finder")
    options = {"camera": ["--source", str(scene), "--pose", "viewpoint"], "finder": []}
    network = Network(namespace="cancels").on(endpoint)
    processes = [_run(name, network, *options[name]) for name in names]
    try:
        with CellClient(join(network)) as cell:
            _await(cell.bus, names)
            return _cancels(cell)
    finally:
        for process in processes:
            process.terminate()
            process.wait(60)


def _crowded_scene(folder: Path) -> Path:
    """A cloud of eight objects on a table, seen by a Kinect."""
    models = [model for model in load(shipped_folder()).models() if not isinstance(model.shape, Surface)]
    drawn = draw_scene("+7", SEED, models)
    points = expose(drawn.view, drawn.camera.pinhole, Kinect(), SEED)
    x, y, z, w = quaternion(drawn.T_world_camera)
    viewpoint = (*(float(v) for v in drawn.T_world_camera[:3, 3]), w, x, y, z)
    path = folder / "crowded.pcd"
    pcd.write(path, points, viewpoint=viewpoint)
    return path


def _run(name: str, network: Network, *options: str) -> subprocess.Popen[bytes]:
    where = ["--connect", network.connect[0], "--namespace", network.namespace]
    return subprocess.Popen([sys.executable, "-m", "zsight", "run", name, *where, *options], stderr=subprocess.DEVNULL)


def _await(bus: Bus, names: tuple[str, ...]) -> None:
    deadline = time.monotonic() + READY
    wanted = {bus.cell.alive(host_name(), name) for name in names}
    while not wanted <= bus.link.alive(bus.cell.alive("*", "*"), 1.0):
        if time.monotonic() > deadline:
            raise RuntimeError(f"{', '.join(names)} are not ready within {READY:g} s")


def _cancels(cell: CellClient) -> list[float]:
    names = [kind.name for kind in cell.catalog.list() if kind.shape.surface is None]
    lasts = {name: min(_whole(cell, name) for _ in range(2)) for name in names}
    draw = np.random.default_rng(SEED)
    waits: list[float] = []
    number = 0
    while len(waits) < CANCELS:
        name = names[number % len(names)]
        number += 1
        wait = _cancelled(cell, name, float(draw.uniform()) * lasts[name])
        if wait is not None:
            waits.append(wait * 1e3)
    return waits


def _whole(cell: CellClient, name: str) -> float:
    """Seconds of a find that nobody cancels."""
    begin = time.perf_counter()
    cell.find(name, maximum=0, timeout=60.0)
    return time.perf_counter() - begin


def _cancelled(cell: CellClient, name: str, after: float) -> float | None:
    """Seconds from the cancel to the end; none where the find was done before."""
    call = cell.start_find(name, maximum=0, timeout=60.0, finder="finder")
    ended: list[float] = []
    reader = threading.Thread(target=lambda: (call.wait(), ended.append(time.perf_counter())))
    reader.start()
    time.sleep(after)
    begin = time.perf_counter()
    call.cancel()
    reader.join()
    return ended[0] - begin if call.wait().state is GoalState.CANCELLED else None
