"""What is wrong with a host and its cell: one function a check, each with what was found and what to do."""

from __future__ import annotations

import contextlib
import importlib.util
import os
import platform
import shutil
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from importlib import metadata
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING

import numpy as np

from zsight import shared_memory
from zsight.convert import cloud_from_points, points_of
from zsight.errors import NotAllowed, ZsightError
from zsight.hosts.beats import ask_health, topics_of
from zsight.hosts.clocks import ask_clocks
from zsight.hosts.reports import ask_hosts
from zsight.keys.identity import CERTIFICATE, read_identity
from zsight.reaching import trouble_at
from zsight.runtime import host_name, join, version
from zsight.transforms import TransformBuffer, TransformUnknown
from zsight_core.errors import CoreError
from zsight_core.points import from_xyz
from zsight_protocol.geometry import TransformList
from zsight_protocol.message import Time
from zsight_protocol.point_cloud import PointCloud2

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from zsight.bus import Bus, RawRequest
    from zsight.hosts.beats import Topic
    from zsight.network import Network
    from zsight_protocol.health import Health
    from zsight_protocol.host_report import ProcessReport

__all__ = ["FAILED", "OK", "SKIPPED", "WARNING", "Finding", "examine"]

OK, WARNING, FAILED, SKIPPED = "ok", "warning", "failed", "skipped"

_ROUNDS = 20  # questions that a round trip is measured with
_SLOW_MS, _SLOW_CLOUD_MS = 50.0, 500.0
_LEAST_SHARED = 256 * 2**20  # bytes; a ring of clouds for each of a few writers
_LEAST_DISK = 2**30
_SOON = timedelta(days=30)
_PATIENCE = 2.0  # seconds for a cloud
_LISTEN, _PAUSE = 0.3, 0.1  # seconds that transforms are listened to, however many come; that end it where none comes


@dataclass(frozen=True)
class Finding:
    """What one check found: its status (ok, warning, failed or skipped), words, and what to do about it."""

    check: str
    status: str
    found: str
    advice: str = ""


Check = Callable[[], Finding]


def examine(network: Network, *, process: str = "") -> Iterator[Finding]:
    """Every check as it is done; with a process only those that tell whether it is well, for a container's health.

    Args:
        network: this host's.
        process: name of a process of this host.
    """
    alone = [("shared memory", _shared_memory)] if process else _alone(network)
    yield from (_done(name, check) for name, check in alone)
    reached = True
    for endpoint in network.connect:
        finding = _done(f"endpoint {endpoint}", lambda endpoint=endpoint: _endpoint(endpoint, network))  # type: ignore[misc]
        reached &= finding.status == OK
        yield finding
    try:
        bus = join(network)
    except ZsightError as error:
        yield Finding("router", FAILED, str(error), "start a router with zsight up, or name it with --connect")
        return
    with bus:
        checks = [(f"process {process}", lambda: _process(bus, process))] if process else _together(bus, network)
        yield from (_done(name, check) for name, check in checks)


def _alone(network: Network) -> list[tuple[str, Check]]:
    """Checks of this host alone."""
    return [
        ("versions", _versions),
        ("kernels", _kernels),
        ("shared memory", _shared_memory),
        ("disk", _disk),
        ("certificate", lambda: _certificate(network)),
    ]


def _together(bus: Bus, network: Network) -> list[tuple[str, Check]]:
    """Checks of this host and its cell."""
    beats, reports = ask_health(bus), ask_hosts(bus)
    clouds = [topic for topic in topics_of(beats) if _is_points(topic.key)]
    heard = {(beat.host, beat.process) for beat in beats}
    unheard = [(r.host, one) for r in reports for one in r.processes if (r.host, one.process) not in heard]
    return [
        ("cell", lambda: _cell(beats, network)),
        ("round trip", lambda: _round_trip(bus, network)),
        ("cloud round trip", lambda: _cloud_round_trip(bus, network)),
        ("clocks", lambda: _clocks(bus)),
        *(_of_unheard(host, process) for host, process in unheard if process.state != "ended"),
        *(_of_camera(bus, topic) for topic in clouds),
    ]


def _is_points(key: str) -> bool:
    return key.endswith("/points") and key.count("/") == 2 and "*" not in key


def _of_unheard(host: str, process: ProcessReport) -> tuple[str, Check]:
    return f"process {host}/{process.process}", lambda: _unheard(host, process)


def _of_camera(bus: Bus, clouds: Topic) -> tuple[str, Check]:
    camera = clouds.key.split("/")[1]
    return f"camera {camera}", lambda: _camera(bus, camera) if clouds.writers else _unpublished(camera, clouds)


def _done(name: str, check: Check) -> Finding:
    """A check, or what kept it from being made."""
    try:
        return check()
    except NotAllowed as error:
        return Finding(name, SKIPPED, str(error))
    except (ZsightError, CoreError, OSError, TimeoutError) as error:
        return Finding(name, FAILED, str(error) or type(error).__name__, "see zsight logs and zsight node list")


# This host alone.


def _versions() -> Finding:
    zenoh = metadata.version("eclipse-zenoh")
    found = f"zsight {version()}, Python {platform.python_version()}, Zenoh {zenoh}, numpy {np.__version__}"
    return Finding("versions", OK, found)


def _kernels() -> Finding:
    if importlib.util.find_spec("numba") is None:
        return Finding("kernels", SKIPPED, "numba is not installed: this host asks and routes only")
    from zsight_core.warm import is_warm

    if is_warm():
        return Finding("kernels", OK, "compiled")
    return Finding("kernels", WARNING, "not compiled: the first start takes a minute", "zsight warm")


def _shared_memory() -> Finding:
    free, whole = shared_memory.free_bytes(), shared_memory.total_bytes()
    found = f"{free / 2**20:.0f} of {whole / 2**20:.0f} MiB free"
    if whole < _LEAST_SHARED:
        advice = "give the container more with shm_size or --shm-size; clouds go through sockets meanwhile"
        return Finding("shared memory", WARNING, found, advice)
    if free < _LEAST_SHARED / 4:
        return Finding("shared memory", WARNING, found, "look in /dev/shm for what fills it")
    return Finding("shared memory", OK, found)


def _disk() -> Finding:
    free = shutil.disk_usage(Path.cwd()).free
    found = f"{free / 2**30:.1f} GiB free here"
    return Finding("disk", OK if free > _LEAST_DISK else WARNING, found, "" if free > _LEAST_DISK else "make room")


def _certificate(network: Network) -> Finding:
    if not network.keys:
        return Finding("certificate", SKIPPED, "no keys: whoever reaches the router may join (see zsight keys)")
    folder = Path(network.keys)
    identity = read_identity(folder)
    if importlib.util.find_spec("cryptography") is None:
        return Finding(
            "certificate", SKIPPED, "cryptography is not installed", "pip install 'zsight[keys]' to look at it"
        )
    from zsight.keys.authority import expiry, name_in

    name, end = name_in(folder / CERTIFICATE), expiry(folder / CERTIFICATE)
    found = f"{name}, {', '.join(identity.roles)}, good until {end:%Y-%m-%d}"
    if name != identity.host:
        return Finding(
            "certificate", FAILED, f"it is {name}'s, the folder {identity.host}'s", "copy the folder anew, whole"
        )
    if end < datetime.now(UTC):
        return Finding("certificate", FAILED, found, f"zsight keys revoke {name}, then add")
    return Finding("certificate", WARNING if end < datetime.now(UTC) + _SOON else OK, found)


def _endpoint(endpoint: str, network: Network) -> Finding:
    trouble = trouble_at(endpoint, network.keys)
    name = f"endpoint {endpoint}"
    return (
        Finding(name, FAILED, trouble, "start a router there, or name another endpoint")
        if trouble
        else Finding(name, OK, "somebody answers")
    )


# This host and its cell.


def _process(bus: Bus, process: str) -> Finding:
    found = [beat for beat in ask_health(bus) if (beat.host, beat.process) == (host_name(), process)]
    if not found:
        return Finding(f"process {process}", FAILED, "its beat does not come back from the router", "see its log")
    return Finding(f"process {process}", OK, f"pid {found[0].pid}, {found[0].errors} warnings and errors")


def _unheard(host: str, process: ProcessReport) -> Finding:
    """A process that its supervisor looks after and that tells nothing of its health."""
    name, number = f"process {host}/{process.process}", process.pid
    if process.state == "starting":
        return Finding(name, WARNING, f"pid {number} is starting", f"see zsight logs {process.process}")
    if process.state == "waiting":
        reason = process.crash.reason if process.crash else "not known why"
        return Finding(name, FAILED, f"it ended ({reason}) and will be started again", "see zsight node info")
    advice = f"where it stays so, kill -KILL {number} on {host}: it is started again"
    return Finding(name, FAILED, f"pid {number} runs and does not answer", advice)


def _unpublished(camera: str, clouds: Topic) -> Finding:
    """A camera that others count on and nobody is."""
    readers = ", ".join(sorted({beat.process for beat, _ in clouds.readers}))
    found = f"nobody publishes {clouds.key}, which is read by {readers}"
    return Finding(f"camera {camera}", WARNING, found, "start the camera, or see what became of it: zsight up --hosts")


def _cell(beats: list[Health], network: Network) -> Finding:
    if not beats:
        found = f"a router answers, but cell {network.namespace} is empty"
        return Finding("cell", FAILED, found, "start it with zsight up, or name another with --namespace")
    others = sorted({f"{beat.host}/{beat.process} {beat.version}" for beat in beats if beat.version != version()})
    found = f"{len(beats)} processes on {len({beat.host for beat in beats})} hosts"
    if others:
        return Finding("cell", WARNING, f"{found}; other versions: {', '.join(others)}", f"install {version()} there")
    return Finding("cell", OK, found)


def _round_trip(bus: Bus, network: Network) -> Finding:
    """A question that goes through the router to another session, and its answer."""
    key = bus.cell.health(host_name(), f"doctor-{os.getpid()}")
    times: list[float] = []
    with join(network) as other:
        other.serve(key, _answer)
        deadline = time.monotonic() + _PATIENCE
        while len(times) < _ROUNDS:
            started = time.monotonic()
            if bus.ask(key, b"", _PATIENCE).take(_PATIENCE) == b"here":
                times.append((time.monotonic() - started) * 1e3)
            elif times or started > deadline:  # the other session is not known at once
                return Finding("round trip", FAILED, "no answer", "see the router's log")
    found = f"{median(times):.1f} ms, the median of {_ROUNDS}"
    slow = median(times) > _SLOW_MS
    return Finding("round trip", WARNING if slow else OK, found, "a slow link, or a busy host" if slow else "")


def _answer(request: RawRequest) -> None:
    request.reply(b"here")
    request.close()


def _cloud_round_trip(bus: Bus, network: Network) -> Finding:
    """A cloud of 4.9 MB to another session and through the router; on a channel that nobody else reads."""
    name = f"doctor-{os.getpid()}"
    cloud = cloud_from_points(from_xyz(np.ones((480, 640, 3))), Time.now(), "doctor")
    key = bus.cell.selected_points(name)
    with join(network) as other, contextlib.closing(other.reader(key, PointCloud2)) as reader:
        writer = bus.writer(key, PointCloud2)
        deadline = time.monotonic() + _PATIENCE
        while not writer.has_readers() and time.monotonic() < deadline:
            bus.stopping.wait(0.005)
        times = []
        for _ in range(5):
            started = time.monotonic()
            writer.send(cloud)
            if reader.take(_PATIENCE) is None:
                return Finding("cloud round trip", FAILED, "a cloud of 4.9 MB did not arrive", "see the router's log")
            times.append((time.monotonic() - started) * 1e3)
    found = f"4.9 MB in {median(times):.0f} ms"
    slow = median(times) > _SLOW_CLOUD_MS
    return Finding("cloud round trip", WARNING if slow else OK, found, "a slow link, or a busy host" if slow else "")


def _clocks(bus: Bus) -> Finding:
    clocks = ask_clocks(bus)
    wrong = [clock.warning for clock in clocks if clock.warning]
    if wrong:
        return Finding("clocks", WARNING, "; ".join(wrong), "let chrony or ntpd run on both")
    worst = max((abs(clock.offset) for clock in clocks), default=0.0)
    return Finding("clocks", OK, f"{len(clocks)} hosts within {worst * 1e3:.0f} ms")


def _camera(bus: Bus, camera: str) -> Finding:
    """Whether its clouds come, where it stands in the world, and whether its frame is an optical one."""
    name = f"camera {camera}"
    buffer = TransformBuffer()
    static = bus.reader(bus.cell.tf_static, TransformList)
    moving = bus.reader(bus.cell.tf, TransformList)
    with (
        contextlib.closing(static),
        contextlib.closing(moving),
        contextlib.closing(bus.reader(bus.cell.points(camera), PointCloud2)) as clouds,
    ):
        received = clouds.take(_PATIENCE)
        if received is None:
            return Finding(name, FAILED, f"no cloud within {_PATIENCE:g} s", "see its log: zsight logs")
        deadline = time.monotonic() + _LISTEN
        for reader, lasting in ((static, True), (moving, False)):
            while (left := deadline - time.monotonic()) > 0 and (told := reader.take(min(left, _PAUSE))) is not None:
                buffer.put(told.message, static=lasting)
    cloud = received.message
    frame = cloud.header.frame_id
    root = buffer.root_of(frame)
    if root == frame:
        advice = "give the camera its pose, or measure it: zsight calibrate level --set"
        return Finding(name, WARNING, f"frame {frame} stands nowhere: no transform leads to it", advice)
    try:
        T_root_camera = buffer.lookup(root, frame, cloud.header.stamp.ns)
    except TransformUnknown as error:
        return Finding(name, WARNING, str(error), "see zsight topic echo for tf")
    mistake = _frame_mistake(cloud, T_root_camera)
    if mistake:
        return Finding(name, FAILED, mistake, "give the pose of the optical frame")
    return Finding(name, OK, f"{cloud.width} x {cloud.height} in {frame}, which stands in {root}")


def _frame_mistake(cloud: PointCloud2, T_root_camera: NDArray[np.float64]) -> str:
    """Whether the camera's pose contradicts the surface it sees; nothing where no kernels are installed."""
    if importlib.util.find_spec("numba") is None:
        return ""
    from zsight_core import level, scene

    seen = scene.understand(points_of(cloud))
    return level.frame_mistake(seen.supports[0].normal, T_root_camera) if seen.supports else ""
