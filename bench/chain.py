"""Camera -> voxel grid -> sink at a camera's rate, as three processes, with one system after the other taking turns.

Every system carries the same cloud and averages it into the same voxels: ours as ``zsight run`` starts it, with its
router, beats and validation; bare Zenoh with nothing of that; roscpp (Debian's ROS 1) in C++; dora-rs with Python nodes
around our own voxel kernel. A latency runs from the camera's stamp to the last process being able to use the array.
What a system needs and is not installed is told instead of a figure.
"""

from __future__ import annotations

import os
import queue
import shutil
import signal
import subprocess
import sys
import threading
import time
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

import numpy as np
from one_hop import free_endpoint
from progress import tell

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from zsight_core.points import Points

HERE = Path(__file__).resolve().parent
DORA = Path(os.environ.get("ZSIGHT_BENCH_DORA", HERE.parent.parent / "dora-venv"))
"""Virtual environment of its own with dora-rs, dora-rs-cli, numpy, numba and scipy."""

_START = 30.0  # seconds for a chain to deliver its first clouds; kernels were compiled before
_SKIP = 15  # clouds of a turn that do not count
_TICKS = os.sysconf("SC_CLK_TCK")


@dataclass
class Figures:
    """Of one system: latencies in milliseconds, seconds measured, CPU seconds of all its processes, clouds lost."""

    latencies: list[float] = field(default_factory=list)
    medians: list[float] = field(default_factory=list)
    seconds: float = 0.0
    cpu: float = 0.0
    lost: int = 0
    reason: str = ""


@dataclass(frozen=True)
class Setting:
    """One turn: where the cloud lies in three forms, its size, the rate in hertz, and room for a system's files."""

    folder: Path
    height: int
    width: int
    rate: float

    @property
    def array(self) -> Path:
        """The cloud as .npy."""
        return self.folder / "cloud.npy"

    @property
    def pcd(self) -> Path:
        """The cloud as .pcd."""
        return self.folder / "cloud.pcd"

    @property
    def raw(self) -> Path:
        """The bytes of its points."""
        return self.folder / "cloud.raw"


def measure(points: Points, *, rate: float = 30.0, seconds: float = 4.0, turns: int = 3) -> dict[str, Figures]:
    """Let all systems take turns; figures by system."""
    from zsight_core.files import pcd

    figures = {name: Figures() for name in CHAINS}
    with TemporaryDirectory() as folder:
        setting = Setting(Path(folder), points.shape[0], points.shape[1], rate)
        np.save(setting.array, points)
        pcd.write(setting.pcd, points)
        setting.raw.write_bytes(points.tobytes())
        for turn in range(turns):
            for name, chain in CHAINS.items():
                if not figures[name].reason:
                    tell(f"chain {setting.width}x{setting.height}, turn {turn + 1} of {turns}: {name}")
                    _take_turn(chain, setting, seconds, figures[name])
    return figures


def _take_turn(chain: Callable[[ExitStack, Setting], Started], setting: Setting, seconds: float, into: Figures) -> None:
    with ExitStack() as stack:
        try:
            started = chain(stack, setting)
            rows = started.lines.take(_SKIP, _START)
            cpu, begin = started.cpu(), time.monotonic()
            rows = started.lines.take(round(seconds * setting.rate), seconds * 3, fewer=True)
        except (MissingError, TimeoutError) as error:
            into.reason = str(error)
            return
        into.seconds += time.monotonic() - begin
        into.cpu += started.cpu() - cpu
    stamps, latencies = rows[:, 0], rows[:, 1] / 1e6
    gaps = np.rint(np.diff(stamps) * setting.rate / 1e9)
    into.lost += int(np.maximum(gaps - 1, 0).sum())
    into.latencies.extend(latencies.tolist())
    into.medians.append(float(np.median(latencies)))


class MissingError(Exception):
    """Something that a system needs is not installed."""


class Lines:
    """What the last process of a chain prints, read as it comes."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self._lines: queue.SimpleQueue[str] = queue.SimpleQueue()
        threading.Thread(target=self._read, args=(process,), daemon=True).start()

    def _read(self, process: subprocess.Popen[str]) -> None:
        assert process.stdout is not None
        for line in process.stdout:
            self._lines.put(line)

    def take(
        self, count: int, timeout: float, *, fewer: bool = False
    ) -> np.ndarray[tuple[int, int], np.dtype[np.int64]]:
        """Stamps and latencies, int64 (count, 2) ns; with fewer, what came within timeout seconds."""
        deadline, rows = time.monotonic() + timeout, []
        while len(rows) < count:
            try:
                words = self._lines.get(timeout=max(deadline - time.monotonic(), 0.001)).split()
            except queue.Empty:
                if fewer and len(rows) > 1:
                    break
                raise TimeoutError(f"{len(rows)} of {count} clouds came within {timeout:g} s") from None
            if len(words) == 2 and all(word.lstrip("-").isdigit() for word in words):
                rows.append([int(words[0]), int(words[1])])
        return np.array(rows, dtype=np.int64)


@dataclass(frozen=True)
class Started:
    """A running chain: its processes' numbers, and what its sink prints."""

    pids: list[int]
    lines: Lines

    def cpu(self) -> float:
        """CPU seconds that all processes and their children have used."""
        return sum(_cpu(pid) for pid in self._family())

    def _family(self) -> list[int]:
        family = list(self.pids)
        for pid in family:  # grows while it is read
            for children in Path(f"/proc/{pid}/task").glob("*/children"):
                family += [int(child) for child in children.read_text().split() if int(child) not in family]
        return family


def _cpu(pid: int) -> float:
    try:
        numbers = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0.0
    return (int(numbers[11]) + int(numbers[12])) / _TICKS


@contextmanager
def _running(
    command: list[str], environment: dict[str, str], *, talks: bool = False
) -> Iterator[subprocess.Popen[str]]:
    process = subprocess.Popen(
        command,
        env={**os.environ, **environment},
        stdout=subprocess.PIPE if talks else subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        text=True,
        start_new_session=True,
    )
    try:
        yield process
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGTERM)
            try:
                process.wait(timeout=3)
            except subprocess.TimeoutExpired:
                os.killpg(process.pid, signal.SIGKILL)
                process.wait()


def _start(stack: ExitStack, commands: list[list[str]], environment: dict[str, str], sink: list[str]) -> Started:
    """Start a chain from its end, so that nothing is sent before somebody reads it."""
    last = stack.enter_context(_running(sink, environment, talks=True))
    processes = [last, *(stack.enter_context(_running(command, environment)) for command in commands)]
    return Started([process.pid for process in processes], Lines(last))


def _ours(stack: ExitStack, setting: Setting) -> Started:
    endpoint = free_endpoint()
    environment = {"ZSIGHT_CONNECT": endpoint, "ZSIGHT_LISTEN": endpoint, "ZSIGHT_NAMESPACE": "bench"}
    zsight = [sys.executable, "-m", "zsight", "run"]
    router = stack.enter_context(_running([*zsight, "router"], environment))
    _wait_for_port(endpoint)
    camera = ["camera", "--source", str(setting.pcd), "--rate", str(setting.rate)]
    sink = [sys.executable, str(HERE / "our_sink.py"), endpoint, "bench", "kinect"]
    started = _start(stack, [[*zsight, "voxel"], [*zsight, *camera]], environment, sink)
    return Started([router.pid, *started.pids], started.lines)


def _bare(stack: ExitStack, setting: Setting) -> Started:
    program = [sys.executable, str(HERE / "bare_zenoh.py")]
    endpoint = free_endpoint()
    voxel = stack.enter_context(_running([*program, "voxel", endpoint, str(setting.array)], {}))
    _wait_for_port(endpoint)
    camera = [*program, "camera", endpoint, str(setting.array), str(setting.rate)]
    started = _start(stack, [camera], {}, [*program, "sink", endpoint, str(setting.array)])
    return Started([voxel.pid, *started.pids], started.lines)


def _roscpp(stack: ExitStack, setting: Setting) -> Started:
    program, master = HERE / "roscpp" / "build" / "chain", shutil.which("rosmaster")
    if not program.exists() or master is None:
        raise MissingError("roscpp is not there: install Debian's packages and run bench/roscpp/build.sh")
    endpoint = free_endpoint()
    port = endpoint.rpartition(":")[2]
    environment = {
        "ROS_MASTER_URI": f"http://127.0.0.1:{port}",
        "ROS_IP": "127.0.0.1",
        "ROS_LOG_DIR": str(setting.folder),
    }
    core = stack.enter_context(_running([master, "--core", "-p", port], environment))
    _wait_for_port(endpoint)
    size = [str(setting.raw), str(setting.height), str(setting.width), str(setting.rate)]
    commands = [[str(program), "voxel"], [str(program), "camera", *size]]
    started = _start(stack, commands, environment, [str(program), "sink"])
    return Started([core.pid, *started.pids], started.lines)


def _dora(stack: ExitStack, setting: Setting) -> Started:
    program = DORA / "bin" / "dora"
    if not program.exists():
        raise MissingError("dora-rs is not there: name its virtual environment in ZSIGHT_BENCH_DORA")
    flow = setting.folder / "flow.yml"
    flow.write_text(_dora_flow(setting))
    path = os.pathsep.join([str(HERE), str(HERE.parent / "core")])
    environment = {"CHAIN_CLOUD": str(setting.array), "PYTHONPATH": path}
    environment["PATH"] = os.pathsep.join([str(DORA / "bin"), os.environ["PATH"]])
    process = stack.enter_context(_running([str(program), "run", str(flow)], environment))
    output = setting.folder / "latencies"
    output.unlink(missing_ok=True)
    reader = stack.enter_context(_running(["tail", "-F", "-n", "+1", str(output)], {}, talks=True))
    return Started([process.pid], Lines(reader))


def _dora_flow(setting: Setting) -> str:
    def node(role: str, source: str, output: str) -> str:
        inputs = f"    inputs:\n      cloud: {{source: {source}, queue_size: 1}}\n"
        outputs = f"    outputs: [{output}]\n" if output else ""
        command = f"    path: {HERE / 'dora' / 'run.sh'}\n    args: {role} {setting.folder / 'latencies'}\n"
        return f"  - id: {role}\n{command}{inputs}{outputs}"

    timer = f"dora/timer/millis/{round(1000 / setting.rate)}"
    return (
        "nodes:\n"
        + node("camera", timer, "points")
        + node("voxel", "camera/points", "voxel")
        + node("sink", "voxel/voxel", "")
    )


def _wait_for_port(endpoint: str, timeout: float = 20.0) -> None:
    import socket

    host, _, port = endpoint.removeprefix("tcp/").rpartition(":")
    deadline = time.monotonic() + timeout
    while time.monotonic() < deadline:
        with socket.socket() as probe:
            if probe.connect_ex((host, int(port))) == 0:
                return
        time.sleep(0.05)
    raise TimeoutError(f"nobody listens on {endpoint} after {timeout:g} s")


CHAINS = {"zsight": _ours, "bare zenoh": _bare, "roscpp": _roscpp, "dora-rs": _dora}
