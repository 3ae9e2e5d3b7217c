"""What the browser page costs: clouds of 640 x 480 at 30 Hz into a viewer with two pages open, one of them frozen.

The pages are two processes that speak the viewer's protocol: one reads everything, the other reads nothing after it has
joined, as a browser does whose machine stands still.
"""

from __future__ import annotations

import os
import signal
import statistics
import subprocess
import sys
import threading
import time
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np

from zsight.convert import cloud_from_points
from zsight.network import Network
from zsight.runtime import join
from zsight_core.points import from_xyz
from zsight_protocol.message import Time
from zsight_protocol.point_cloud import PointCloud2

RATE, PLAIN, WATCHED = 30.0, 15.0, 45.0  # clouds a second; seconds with a plain reader, before and after; with a viewer
SETTLED = 10.0  # seconds after both pages have joined from which on memory and processor time are counted
PORT, TOKEN = 8765, "bench"


def run() -> list[dict[str, Any]]:
    """Rows of ``zsight bench viewer``; router, viewer and both pages are processes of this host."""
    endpoint = "tcp/127.0.0.1:17447"
    with ExitStack() as started:
        _start(started, "-m", "zsight", "run", "router", "--listen", endpoint)
        bus = started.enter_context(join(Network().on(endpoint), wait=30.0))
        camera = _Camera(bus)
        before = _beside_a_plain_reader(camera, endpoint)
        with ExitStack() as watching:
            viewer = _start(
                watching, "-m", "zsight", "run", "viewer", "--port", str(PORT), "--token", TOKEN, "--connect", endpoint
            )
            live, frozen = (_start(watching, __file__, kind, pipe=True) for kind in ("reads", "frozen"))
            for page in (live, frozen):
                while page.stdout is not None and page.stdout.readline() != b"joined\n":
                    pass
            camera.measure(SETTLED)
            busy, memory = _cpu_seconds(viewer.pid), _resident(viewer.pid)
            began = time.monotonic()
            with_viewer = camera.measure(WATCHED)
            share = (_cpu_seconds(viewer.pid) - busy) / (time.monotonic() - began)
            grown = _resident(viewer.pid) - memory
            live.terminate()
            drawn = int((live.stdout.read() if live.stdout else b"0") or 0) / (SETTLED + WATCHED)
        after = _beside_a_plain_reader(camera, endpoint)
    plain = before.add(after)
    return [
        _row("viewer's share of one core", 100 * share, "%", target=60.0, holds=share <= 0.6),
        _row("viewer's memory, grown in 45 s", grown / 2**20, "MB", target=20.0, holds=grown < 20 * 2**20),
        _row("viewer's memory", memory / 2**20, "MB"),
        _row("pictures a second in the page that reads", drawn, "Hz"),
        _row("camera: clouds a second", with_viewer.rate, "Hz", "a plain reader", plain.rate),
        _row("camera: send, median", with_viewer.p50, "ms", "a plain reader", plain.p50),
        _row("camera: send, p99", with_viewer.p99, "ms", "a plain reader", plain.p99),
    ]


def _beside_a_plain_reader(camera: _Camera, endpoint: str) -> _Sent:
    """The same with a reader that only counts, in place of the viewer."""
    with ExitStack() as reading:
        command = ("-m", "zsight", "topic", "hz", "zsight/kinect/points", "--connect", endpoint, "--duration", "1000")
        _start(reading, *command)
        camera.wait_read()
        camera.measure(SETTLED)
        return camera.measure(PLAIN)


class _Sent:
    """How long each send took, and over how many seconds."""

    def __init__(self, took: list[float], seconds: float) -> None:
        self.took, self.seconds = took, seconds

    def add(self, other: _Sent) -> _Sent:
        return _Sent(self.took + other.took, self.seconds + other.seconds)

    @property
    def rate(self) -> float:
        return len(self.took) / self.seconds

    @property
    def p50(self) -> float:
        return statistics.median(self.took)

    @property
    def p99(self) -> float:
        return sorted(self.took)[int(0.99 * (len(self.took) - 1))]


class _Camera:
    """Publishes a cloud of 640 x 480 points at the rate."""

    def __init__(self, bus: Any) -> None:
        v, u = np.mgrid[0:480, 0:640]
        depth = 1.0 + 0.2 * np.sin(u / 50) * np.cos(v / 50)
        xyz = np.stack([(u - 319.5) / 525 * depth, (v - 239.5) / 525 * depth, depth], axis=-1)
        self._points = from_xyz(xyz, np.stack([u % 256, v % 256, (u + v) % 256], axis=-1))
        self._writer = bus.writer(bus.cell.points("kinect"), PointCloud2)

    def wait_read(self) -> None:
        """Until somebody reads the clouds: what nobody reads is not copied."""
        while not self._writer.has_readers():
            threading.Event().wait(0.05)

    def measure(self, seconds: float) -> _Sent:
        """Publish for so long."""
        took: list[float] = []
        pause, began = threading.Event(), time.monotonic()
        while (now := time.monotonic()) < began + seconds:
            pause.wait(max(began + len(took) / RATE - now, 0.0))
            cloud = cloud_from_points(self._points, Time.now(), "kinect_optical_frame")
            start = time.perf_counter()
            self._writer.send(cloud)
            took.append((time.perf_counter() - start) * 1e3)
        return _Sent(took, time.monotonic() - began)


def _start(stack: ExitStack, *arguments: str, pipe: bool = False) -> subprocess.Popen[bytes]:
    process = subprocess.Popen([sys.executable, *arguments], stdout=subprocess.PIPE if pipe else None)

    def end() -> None:
        process.terminate()
        process.send_signal(signal.SIGCONT)  # the frozen one, so that it ends
        process.wait(20)

    stack.callback(end)
    return process


def _cpu_seconds(pid: int) -> float:
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _resident(pid: int) -> int:
    return int(Path(f"/proc/{pid}/statm").read_text(encoding="ascii").split()[1]) * os.sysconf("SC_PAGE_SIZE")


def _row(
    name: str,
    value: float,
    unit: str,
    peer: str | None = None,
    peer_value: float | None = None,
    *,
    target: float | None = None,
    holds: bool | None = None,
) -> dict[str, Any]:
    ratio = None if peer_value is None else value / peer_value
    return {
        "name": name,
        "value": value,
        "unit": unit,
        "peer": peer,
        "peer_value": peer_value,
        "ratio": ratio,
        "target": target,
        "holds": holds,
    }


def _page(kind: str) -> None:
    """A page that reads, and counts pictures of the cloud until it is told to stop; or one that is frozen."""
    import msgspec
    import viser
    from websockets.sync.client import connect

    count = 0

    def stop(*_: object) -> None:
        print(count, flush=True)
        os._exit(0)

    signal.signal(signal.SIGTERM, stop)
    camera = {
        "type": "ViewerCameraMessage",
        "wxyz": (1.0, 0.0, 0.0, 0.0),
        "position": (0.0, 0.0, -1.0),
        "fov": 1.0,
        "near": 0.01,
        "far": 100.0,
        "image_height": 720,
        "image_width": 960,
        "look_at": (0.0, 0.0, 1.0),
        "up_direction": (0.0, -1.0, 0.0),
    }
    headers = {"Cookie": f"zsight_{PORT}={TOKEN}"}
    while True:
        try:
            page = connect(
                f"ws://127.0.0.1:{PORT}",
                subprotocols=[f"viser-v{viser.__version__}"],  # type: ignore[list-item]  # a NewType of str
                additional_headers=headers,
                max_size=None,
                ping_interval=None,
            )
            break
        except OSError:
            threading.Event().wait(0.1)
    page.send(msgspec.msgpack.encode(camera))
    page.recv()
    print("joined", flush=True)
    if kind == "frozen":
        os.kill(os.getpid(), signal.SIGSTOP)
    while True:
        count += len(page.recv()) > 200_000  # nothing but a cloud is as large


if __name__ == "__main__":
    _page(sys.argv[1])
