"""How soon a service is ready for its first request, from the start of its process, with warm kernels.

And how soon a finder has answered it: a toy block in the clouds of a simulated camera.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from bus_processes import cell, member, router
from progress import tell

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from zsight.bus import Bus

_TARGET = 1.0  # seconds
_PATIENCE = 60.0  # seconds
_TICK = os.sysconf("SC_CLK_TCK")


def run(tries: int = 7) -> list[dict[str, Any]]:
    """Rows as ``zsight bench --json`` prints them: seconds on the clock, and of processor time, until it is ready."""
    from zsight.client import CellClient
    from zsight.runtime import join

    network = cell()
    endpoint = network.connect[0]
    with member(router, network), join(network) as bus:
        rows = []
        for service in ("voxel", "planes", "finder"):
            starts = np.array([start(bus, service, f"{service}{k}", endpoint) for k in range(tries)])
            rows.append(row(f"{service} ready after, on the clock", starts[:, 0]))
            rows.append(row(f"{service} ready after, of processor time", starts[:, 1]))
        with running(bus, "camera", "camera", endpoint, "--rate", "15"):
            find = partial(CellClient(bus).find, "toy_block")
            answers = np.array([answer(bus, "finder", f"first{k}", endpoint, find) for k in range(tries)])
        return [*rows, row("finder has answered after, on the clock", answers)]


def start(bus: Bus, service: str, process: str, endpoint: str) -> tuple[float, float]:
    """Seconds until the token of a process is seen."""
    with running(bus, service, process, endpoint) as ready:
        return ready


def answer(bus: Bus, service: str, process: str, endpoint: str, ask: Callable[[], object]) -> float:
    """Seconds on the clock from the start of a process until it has answered its first request."""
    begin = time.perf_counter()
    with running(bus, service, process, endpoint):
        ask()
        return time.perf_counter() - begin


@contextmanager
def running(bus: Bus, service: str, process: str, endpoint: str, *options: str) -> Iterator[tuple[float, float]]:
    """A process of its own from its token on; seconds on the clock and of its processor time until then."""
    ready = threading.Event()
    spent: list[float] = []

    def changed(_key: str, alive: bool) -> None:
        if alive and not ready.is_set():
            spent.extend((time.perf_counter() - begin, processor_time(child.pid)))
            ready.set()

    watch = bus.link.watch_alive(bus.cell.alive("*", process), changed)
    begin = time.perf_counter()
    command = [sys.executable, "-m", "zsight", "run", service, "--process", process, "--connect", endpoint]
    command += ["--namespace", bus.cell.namespace, *options]
    child = subprocess.Popen(command, stderr=subprocess.DEVNULL)
    try:
        if not ready.wait(_PATIENCE):
            raise TimeoutError(f"{service} is not ready within {_PATIENCE:g} s")
        yield spent[0], spent[1]
    finally:
        watch.close()
        child.send_signal(signal.SIGTERM)
        child.wait(_PATIENCE)


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
