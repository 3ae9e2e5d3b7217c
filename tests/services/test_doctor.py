"""What the doctor says of a camera, whatever else travels in its cell."""

from __future__ import annotations

import threading
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING

import numpy as np
from tests.services.waiting import DEADLINE

from zsight.convert import cloud_from_points, stamped
from zsight.hosts import doctor
from zsight.network import Network
from zsight_core.points import from_xyz
from zsight_protocol.codec import encode
from zsight_protocol.geometry import TransformList
from zsight_protocol.health import Health, Level, ReaderHealth
from zsight_protocol.host_report import HostReport, ProcessReport
from zsight_protocol.message import Header, Time
from zsight_protocol.point_cloud import PointCloud2

if TYPE_CHECKING:
    from collections.abc import Callable

    from zsight.bus import Bus, RawRequest
    from zsight_protocol.message import Message


def test_a_camera_is_looked_at_however_often_transforms_come(join_memory: Callable[[], Bus]) -> None:
    cell, bus, looked_at = join_memory(), join_memory(), threading.Event()
    clouds = cell.writer(cell.cell.points("kinect"), PointCloud2)
    moving = cell.writer(cell.cell.tf, TransformList)
    points = from_xyz(np.ones((2, 2, 3)))

    def publish() -> None:
        while not looked_at.wait(0.005):
            clouds.send(cloud_from_points(points, Time.now(), "eye"))
            moving.send(TransformList(transforms=(stamped(np.eye(4), "world", "robot", Time.now()),)))

    with ThreadPoolExecutor() as threads:
        threads.submit(publish)
        finding = threads.submit(doctor._camera, bus, "kinect")
        try:
            assert finding.result(DEADLINE).found == "frame eye stands nowhere: no transform leads to it"
        finally:
            looked_at.set()


def answers(message: Message) -> Callable[[RawRequest], None]:
    def answer(request: RawRequest) -> None:
        request.reply(encode(message))
        request.close()

    return answer


def health(process: str, reads: str) -> Health:
    reader = ReaderHealth(key=reads, received=0, superseded=0, lost=0, late=0, refused=0, rate_hz=0.0)
    return Health(
        header=Header(stamp=Time.now()), host="here", process=process, service=process, pid=1, version="0",
        started=Time.now(), level=Level.OK, readers=(reader,),
    )  # fmt: skip


def test_a_camera_that_hangs_is_missed(join_memory: Callable[[], Bus]) -> None:
    cell, bus = join_memory(), join_memory()
    points = cell.cell.points("kinect")
    for name in ("voxel", "finder"):
        cell.serve(cell.cell.health("here", name), answers(health(name, points)))
    cell.serve(cell.cell.health("here", "recorder"), answers(health("recorder", cell.cell.points("*"))))
    states = {"voxel": "running", "camera": "silent", "player": "ended"}
    reports = tuple(ProcessReport(process=n, service=n, state=state, pid=7, starts=1) for n, state in states.items())
    told = HostReport(header=Header(stamp=Time.now()), host="here", version="0", processes=reports)
    cell.serve(cell.cell.host("here"), answers(told))

    checks = dict(doctor._together(bus, Network()))
    assert [name for name in checks if name.startswith(("camera", "process"))] == [
        "process here/camera",
        "camera kinect",
    ]
    camera = checks["camera kinect"]()
    assert camera.status == doctor.WARNING
    assert camera.found == f"nobody publishes {points}, which is read by finder, voxel"
    process = checks["process here/camera"]()
    assert (process.status, process.found) == (doctor.FAILED, "pid 7 runs and does not answer")
