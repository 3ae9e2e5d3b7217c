"""How soon a service is ready for its first request, from the start of its process, with warm kernels."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from bus_processes import cell, member, router
from progress import tell

if TYPE_CHECKING:
    from zsight.bus import Bus

_TARGET = 1.0  # seconds
_PATIENCE = 60.0  # seconds
_TICK = os.sysconf("SC_CLK_TCK")


def run(tries: int = 7) -> list[dict[str, Any]]:
    """Rows as ``zsight bench --json`` prints them: seconds on the clock, and of processor time, until it is ready."""
    from zsight.runtime import join

    network = cell()
    rows = []
    with member(router, network), join(network) as bus:
        for service in ("voxel", "planes", "finder"):
            starts = [start(bus, service, f"{service}{k}", network.connect[0]) for k in range(tries)]
            for word, times in zip(("on the clock", "of processor time"), np.array(starts).T, strict=True):
                rows.append(row(f"{service} ready after, {word}", times))
                tell(f"{rows[-1]['name']}: {rows[-1]['value']} s, {rows[-1]['spread']}")
    return rows


def start(bus: Bus, service: str, process: str, endpoint: str) -> tuple[float, float]:
    """Seconds from the start of the process until its token is seen: on the clock, and of its processor time."""
    ready = threading.Event()
    spent: list[float] = []

    def changed(_key: str, alive: bool) -> None:
        if alive and not ready.is_set():
            spent.extend((time.perf_counter() - begin, processor_time(child.pid)))
            ready.set()

    watch = bus.link.watch_alive(bus.cell.alive("*", process), changed)
    begin = time.perf_counter()
    command = [sys.executable, "-m", "zsight", "run", service, "--process", process, "--connect", endpoint]
    child = subprocess.Popen([*command, "--namespace", bus.cell.namespace], stderr=subprocess.DEVNULL)
    try:
        if not ready.wait(_PATIENCE):
            raise TimeoutError(f"{service} is not ready within {_PATIENCE:g} s")
    finally:
        watch.close()
        child.send_signal(signal.SIGTERM)
        child.wait(_PATIENCE)
    return spent[0], spent[1]


def processor_time(pid: int) -> float:
    """Seconds that a process has worked for so far."""
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / _TICK


def row(name: str, times: Any) -> dict[str, Any]:
    value = float(np.median(times))
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
