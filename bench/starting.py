"""How soon a service is ready and has answered, from the start of its process, with warm kernels.

The answer of a voxel service is its first cloud, that of a planes service the plane of a patch, that of a finder where
a toy block is; a simulated camera sends clouds all the while. And what the first call of each kernel costs.
"""

from __future__ import annotations

import compileall
import os
import signal
import subprocess
import sys
import threading
import time
from contextlib import closing, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from bus_processes import CAMERA, cell, member, router
from first_calls import first_call_rows
from progress import tell

import zsight
import zsight_core
import zsight_protocol
from zsight_protocol.geometry import Plane
from zsight_protocol.point_cloud import PointCloud2

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from zsight.bus import Bus

_TARGET = 1.0  # seconds
_PATIENCE = 60.0  # seconds
_TICK = os.sysconf("SC_CLK_TCK")
_WHEN = ("ready after, on the clock", "ready after, of processor time")
_ANSWERED = ("has answered after, on the clock", "has answered after, of processor time")


def run(tries: int = 7) -> list[dict[str, Any]]:
    """Rows as ``zsight bench --json`` prints them: seconds until it is ready, and until it has answered."""
    from zsight.runtime import join

    for package in (zsight, zsight_core, zsight_protocol):  # as an installer leaves them
        compileall.compile_dir(package.__path__[0], quiet=2)
    network = cell()
    endpoint = network.connect[0]
    rows = []
    with (
        member(router, network),
        join(network) as bus,
        running(bus, "camera", CAMERA, endpoint, "--rate", "15"),
    ):
        for service, asking in (("voxel", smaller_cloud), ("planes", plane_of_patch), ("finder", toy_block)):
            times = np.array([answered(bus, service, f"{service}{k}", endpoint, asking) for k in range(tries)])
            rows += [row(f"{service} {when}", times[:, k]) for k, when in enumerate(_WHEN + _ANSWERED)]
    return rows + first_call_rows()


def answered(
    bus: Bus, service: str, process: str, endpoint: str, asking: Callable[[Bus], Any]
) -> tuple[float, float, float, float]:
    """Seconds, on the clock and of processor time, until the token of a process is seen, and until it has answered.

    Args:
        bus: of who asks.
        service: that is started.
        process: its name.
        endpoint: of the router.
        asking: opens what is needed to ask; what it yields asks.
    """
    with asking(bus) as ask, running(bus, service, process, endpoint) as child:
        ask()
        return (*child.ready, *child.spent())


@contextmanager
def smaller_cloud(bus: Bus) -> Iterator[Callable[[], object]]:
    """Wait for a cloud of the voxel service."""
    with closing(bus.reader(bus.cell.voxel_points(CAMERA), PointCloud2)) as clouds:
        yield lambda: taken(clouds)


@contextmanager
def plane_of_patch(bus: Bus) -> Iterator[Callable[[], object]]:
    """Select a patch of the newest cloud and wait for its plane."""
    from zsight.convert import cloud_from_points, points_of

    with (
        closing(bus.reader(bus.cell.points(CAMERA), PointCloud2)) as clouds,
        closing(bus.reader(bus.cell.plane(CAMERA), Plane)) as planes,
        closing(bus.writer(bus.cell.selected_points(CAMERA), PointCloud2)) as patches,
    ):
        cloud = taken(clouds)
        points = np.ascontiguousarray(points_of(cloud)[300:340, 300:340])
        patch = cloud_from_points(points, cloud.header.stamp, cloud.header.frame_id)

        def ask() -> object:
            patches.send(patch)
            return taken(planes)

        yield ask


@contextmanager
def toy_block(bus: Bus) -> Iterator[Callable[[], object]]:
    """Ask a finder for a toy block."""
    from zsight.client import CellClient

    yield lambda: CellClient(bus).find("toy_block")


def taken(reader: Any) -> Any:
    """The next message.

    Raises:
        TimeoutError: none comes.
    """
    received = reader.take(_PATIENCE)
    if received is None:
        raise TimeoutError(f"nothing comes on {reader.counter.key} within {_PATIENCE:g} s")
    return received.message


class Child:
    """A process that was started, and when it was ready."""

    def __init__(self, command: list[str]) -> None:
        self.ready = (0.0, 0.0)
        self.begin = time.perf_counter()
        self.process = subprocess.Popen(command, stderr=subprocess.DEVNULL)

    def spent(self) -> tuple[float, float]:
        """Seconds on the clock since it was started, and of its processor time."""
        return time.perf_counter() - self.begin, processor_time(self.process.pid)


@contextmanager
def running(bus: Bus, service: str, process: str, endpoint: str, *options: str) -> Iterator[Child]:
    """A process of its own from its token on."""
    ready = threading.Event()
    watch = bus.link.watch_alive(bus.cell.alive("*", process), lambda _, alive: ready.set() if alive else None)
    command = [sys.executable, "-m", "zsight", "run", service, "--process", process, "--connect", endpoint]
    child = Child([*command, "--namespace", bus.cell.namespace, *options])
    try:
        if not ready.wait(_PATIENCE):
            raise TimeoutError(f"{service} is not ready within {_PATIENCE:g} s")
        child.ready = child.spent()
        yield child
    finally:
        watch.close()
        child.process.send_signal(signal.SIGTERM)
        child.process.wait(_PATIENCE)


def processor_time(pid: int) -> float:
    """Seconds that a process has worked for so far."""
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / _TICK


def row(name: str, times: Any) -> dict[str, Any]:
    value = float(np.median(times))
    tell(f"{name}: {value:.2f} s, {np.min(times):.2f} to {np.max(times):.2f}")
    return {
        "name": name,
        "value": round(value, 2),
        "unit": "s",
        "peer": None,
        "peer_value": None,
        "ratio": None,
        "spread": [round(float(np.min(times)), 2), round(float(np.max(times)), 2)],
        "target": _TARGET,
        "holds": value <= _TARGET,
    }
