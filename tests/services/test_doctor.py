"""What the doctor says of a camera, whatever else travels in its cell."""

from __future__ import annotations

import threading
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING

import numpy as np
from tests.services.waiting import DEADLINE

from zsight.convert import cloud_from_points, stamped
from zsight.hosts import doctor
from zsight_core.points import from_xyz
from zsight_protocol.geometry import TransformList
from zsight_protocol.message import Time
from zsight_protocol.point_cloud import PointCloud2

if TYPE_CHECKING:
    from collections.abc import Callable

    from zsight.bus import Bus


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
