"""Three hosts hurt in every way: how soon it is noticed, and how soon all works again after the cause has ended.

Host 1 routes, host 2 has a camera and a voxel filter, host 3 finds and asks; each is up by one line. Needs root and
network namespaces. ``python healing.py --rounds 20`` as the page has it; ``--json`` for scripts.
"""

from __future__ import annotations

import argparse
import contextlib
import itertools
import json
import os
import re
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from bench_row import print_rows, row
from network_hosts import Hosts, why_not

from zsight.bus import Bus
from zsight.bus.zenoh_link import open_link
from zsight.client import CellClient
from zsight.errors import UsageError, ZsightError
from zsight.network import Network
from zsight_protocol.channels import Cell
from zsight_protocol.point_cloud import PointCloud2

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

_ROUTER, _EYE, _MIND = 1, 2, 3
_TABLES = {
    _ROUTER: "[process.router]\n",
    _EYE: "[process.camera]\n[process.voxel]\n",
    _MIND: "[process.finder]\n",
}
_PORT = 7447
_PATIENCE = 60.0  # seconds that anything is waited for
_JOIN, _NOTICE, _HEAL = 1.0, 1.5, 2.0  # seconds, the targets
_OUTAGES = (2.0, 8.0)  # seconds; after the longer one TCP by itself would call again after up to 7 s more


class Watch:
    """What host 3 sees of the others, as it happens."""

    def __init__(self, endpoint: str) -> None:
        self.bus = Bus(open_link(Network(connect=(endpoint,))), Cell())
        self.client = CellClient(self.bus)
        self._alive: dict[str, bool] = {}
        self._clouds = 0
        self._changed = threading.Condition()
        self._watch = self.bus.link.watch_alive(self.bus.cell.alive("*", "*"), self._told)
        reader = self.bus.reader(self.bus.cell.voxel_points("kinect"), PointCloud2)
        threading.Thread(target=self._count, args=(reader,), daemon=True).start()

    def _told(self, key: str, alive: bool) -> None:
        with self._changed:
            self._alive[key.rsplit("/", 1)[-1]] = alive
            self._changed.notify_all()

    def _count(self, reader: Any) -> None:
        for _ in reader:
            with self._changed:
                self._clouds += 1
                self._changed.notify_all()

    def until(self, happened: Callable[[], bool], what: str) -> float:
        """When it happened, on the monotonic clock."""
        with self._changed:
            if not self._changed.wait_for(happened, _PATIENCE):
                raise TimeoutError(f"not within {_PATIENCE:g} s: {what}; alive are {self._alive}")
            return time.monotonic()

    def gone(self, process: str) -> float:
        return self.until(lambda: not self._alive.get(process, False), f"{process} gone")

    def back(self, process: str) -> float:
        return self.until(lambda: self._alive.get(process, False), f"{process} back")

    def cloud(self) -> float:
        """When the next cloud came."""
        before = self._clouds
        return self.until(lambda: self._clouds > before, "a cloud")

    def found(self) -> float:
        """When a goal was answered with the block, asked again and again."""
        deadline = time.monotonic() + _PATIENCE
        while time.monotonic() < deadline:
            with contextlib.suppress(ZsightError):
                if self.client.find("toy_block", timeout=2.0).objects:
                    return time.monotonic()
            time.sleep(0.02)
        raise TimeoutError("the block was not found again")


class Site:
    """The three hosts with their share of the cell each."""

    def __init__(self, stack: ExitStack) -> None:
        self.hosts = stack.enter_context(Hosts(3))
        self._folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        self._ups: dict[int, subprocess.Popen[bytes]] = {}
        self.endpoint = f"tcp/{self.hosts.address(_ROUTER)}:{_PORT}"
        stack.callback(self._stop)
        for host in _TABLES:
            self.up(host)
        self.hosts.enter(_MIND)
        self.wait_listening()
        self.watch = Watch(self.endpoint)
        for process in ("camera", "voxel", "finder"):
            self.watch.back(process)
        self.watch.cloud()
        self.watch.found()
        self.outages = itertools.cycle(_OUTAGES)

    def up(self, host: int) -> None:
        """Start a host's share of the cell: one line."""
        table = self._folder / f"h{host}.toml"
        table.write_text(_TABLES[host])
        listen = ["--listen", f"tcp/0.0.0.0:{_PORT}", "--open"] if host == _ROUTER else ["--connect", self.endpoint]
        environment = {**os.environ, "ZSIGHT_HOST": f"h{host}", "XDG_RUNTIME_DIR": str(self._folder / f"run{host}")}
        (self._folder / f"run{host}").mkdir(exist_ok=True)
        command = [sys.executable, "-m", "zsight", "up", str(table), *listen]
        with (self._folder / f"h{host}.log").open("ab") as log:
            self._ups[host] = subprocess.Popen(
                self.hosts.command(host, *command), env=environment, stdin=subprocess.DEVNULL, stdout=log, stderr=log
            )

    def pids(self, host: int) -> dict[str, int]:
        """The processes of a host by name, as its log tells."""
        text = (self._folder / f"h{host}.log").read_text(errors="replace")
        found = {
            name: int(pid)
            for line in re.findall(r"^up: (.*)$", text, re.MULTILINE)
            for name, pid in re.findall(r"(\S+) \((\d+)\)", line)
        }
        return found | {
            name: int(pid) for name, pid in re.findall(r"^(\S+) started again as process (\d+)", text, re.MULTILINE)
        }

    def kill(self, host: int, process: str) -> None:
        os.kill(self.pids(host)[process], signal.SIGKILL)

    def kill_all(self, host: int) -> None:
        """As when its plug is pulled: the supervisor and all its processes at once."""
        for pid in (self._ups[host].pid, *self.pids(host).values()):
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        self._ups[host].wait()

    def wait_started(self, host: int, process: str, before: int) -> float:
        """When the supervisor had started it again."""
        deadline = time.monotonic() + _PATIENCE
        while self.pids(host).get(process) == before:
            if time.monotonic() > deadline:
                raise TimeoutError(f"{process} was not started again")
            time.sleep(0.005)
        return time.monotonic()

    def wait_listening(self) -> float:
        """When the router could be called."""
        deadline = time.monotonic() + _PATIENCE
        while time.monotonic() < deadline:
            with contextlib.suppress(OSError), socket.create_connection((self.hosts.address(_ROUTER), _PORT), 0.2):
                return time.monotonic()
            time.sleep(0.005)
        raise TimeoutError("no router listens")

    def _stop(self) -> None:
        if hasattr(self, "watch"):
            self.watch.bus.close()
        for process in self._ups.values():
            process.terminate()
        for process in self._ups.values():
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(10)
            process.kill()
            process.wait()


# Each of these hurts the site, waits until it works again, and gives seconds: from the harm until it was noticed, and
# from the end of its cause until all worked again.


def camera_cable(site: Site) -> tuple[float, float]:
    """The cable of the camera's host is pulled, and plugged in once that was noticed."""
    hurt = time.monotonic()
    site.hosts.cut(_EYE)
    noticed = site.watch.gone("camera") - hurt
    site.hosts.mend(_EYE)
    mended = time.monotonic()
    return noticed, site.watch.cloud() - mended


def router_cable(site: Site) -> tuple[float, float]:
    """The cable of the router's host is pulled for some seconds: no host reaches another."""
    hurt = time.monotonic()
    site.hosts.cut(_ROUTER)
    noticed = site.watch.gone("camera") - hurt
    time.sleep(max(hurt + next(site.outages) - time.monotonic(), 0))
    site.hosts.mend(_ROUTER)
    mended = time.monotonic()
    return noticed, site.watch.cloud() - mended


def router_killed(site: Site) -> tuple[float, float]:
    """The router is killed; its supervisor starts it again. Healed counts from when it listens."""
    before = site.pids(_ROUTER)["router"]
    hurt = time.monotonic()
    site.kill(_ROUTER, "router")
    noticed = site.watch.gone("camera") - hurt
    site.wait_started(_ROUTER, "router", before)
    listening = site.wait_listening()
    return noticed, max(site.watch.cloud(), site.watch.found()) - listening


def camera_host_killed(site: Site) -> tuple[float, float]:
    """All processes of the camera's host are killed, then it is up again. Healed counts from when its camera is."""
    hurt = time.monotonic()
    site.kill_all(_EYE)
    noticed = site.watch.gone("camera") - hurt
    site.up(_EYE)
    ready = max(site.watch.back("camera"), site.watch.back("voxel"))
    return noticed, site.watch.cloud() - ready


def finder_killed(site: Site) -> tuple[float, float]:
    """The finder is killed while it works on a goal. Healed counts from when its supervisor's new one is ready."""
    hurt = 0.0
    try:
        for update in site.watch.client.start_find("any", timeout=20.0):  # one type may be found too soon
            if not hurt and not update.final:
                hurt = time.monotonic()
                site.kill(_MIND, "finder")
    except ZsightError:
        noticed = time.monotonic() - hurt
        site.watch.gone("finder")
        ready = site.watch.back("finder")
        return noticed, site.watch.found() - ready
    raise RuntimeError("the finder had answered before it was killed")


def joined(site: Site) -> float:
    """Seconds from when a client begins to join, on the camera's host, until it has its first answer.

    Its process has started before, which is its own time and not the network's.
    """
    program = (
        "import time, sys, zsight; begun = time.monotonic()\n"
        "with zsight.connect(sys.argv[1]) as cell: assert cell.find('toy_block').objects\n"
        "print(time.monotonic() - begun)"
    )
    command = site.hosts.command(_EYE, sys.executable, "-c", program, site.endpoint)
    return float(subprocess.run(command, check=True, capture_output=True, text=True).stdout)


HURTS = (camera_cable, router_cable, router_killed, camera_host_killed, finder_killed)


def run(rounds: int = 20) -> list[dict[str, Any]]:
    """Rows as ``zsight bench --json`` prints them.

    Args:
        rounds: times that each harm is done.

    Raises:
        UsageError: this machine has no network namespaces for this user.
    """
    obstacle = why_not()
    if obstacle:
        raise UsageError(f"three hosts are needed: {obstacle}")
    with ExitStack() as stack:
        site = Site(stack)
        joins = [joined(site) for _ in range(rounds)]
        return [_row("a new client has its first answer", joins, _JOIN)] + [
            row for hurt in HURTS for row in _rows(hurt.__name__.replace("_", " "), list(_rounds(site, hurt, rounds)))
        ]


def _rounds(
    site: Site, hurt: Callable[[Site], tuple[float, float]], rounds: int
) -> Iterator[tuple[float, float, float]]:
    for number in range(rounds):
        began = time.monotonic()
        noticed, healed = hurt(site)
        whole = time.monotonic() - began
        seconds = f"noticed in {noticed:.2f} s, healed in {healed:.2f} s, {whole:.2f} s in all"
        words = f"{hurt.__name__} {number + 1} of {rounds}: {seconds}"
        print(words, file=sys.stderr, flush=True)
        yield noticed, healed, whole
        site.watch.found()


def _rows(name: str, figures: list[tuple[float, float, float]]) -> Iterator[dict[str, Any]]:
    kinds = (("noticed", _NOTICE), ("healed", _HEAL), ("from the harm until all works", None))
    for (what, target), values in zip(kinds, zip(*figures, strict=True), strict=True):
        yield _row(f"{name}: {what}", values, target)


def _row(name: str, values: Sequence[float], target: float | None) -> dict[str, Any]:
    median = round(float(np.median(values)), 3)
    return row(f"{name}, worst of {len(values)}", max(values), "s", target, median=median)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=20)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    measured = run(options.rounds)
    if options.json:
        print(json.dumps({"rows": measured}))
    else:
        print_rows(measured)
