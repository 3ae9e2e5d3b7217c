"""A recording of finds, made with a real finder in memory."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tests.core.book_scene import T_WORLD_CAMERA, TOY_BLOCK, at
from tests.core.book_scene import cloud as book_cloud
from tests.services.running import running
from tests.services.waiting import soon

from zsight import finder
from zsight.client import CellClient
from zsight.convert import cloud_from_points, stamped
from zsight.recording import recorder
from zsight.recording_client import RecorderClient
from zsight_core.transform import from_rpy
from zsight_protocol.geometry import TransformList
from zsight_protocol.message import Time
from zsight_protocol.point_cloud import PointCloud2

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from zsight.bus import Bus
    from zsight_protocol.find_object import FindObjectResult

    Join = Callable[[], Bus]

__all__ = ["Recorded", "find_in", "record"]

PLACES = (0.45, 0.55, 0.65)
FRAME = "kinect_pc_frame"


class Recorded:
    """A recording, and the answers that were given while it was made."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.results: list[FindObjectResult] = []


def find_in(client: CellClient, stamp: Time) -> FindObjectResult:
    """The answer from the cloud of this time, which the finder may not have taken yet."""
    found: list[FindObjectResult] = []

    def found_there() -> bool:
        found[:] = [client.find("toy_block")]
        return found[0].header.stamp == stamp

    assert soon(found_there)
    return found[0]


def record(join: Join, path: Path) -> Recorded:
    """The block at three places, seen by a camera that moves meanwhile; a find at each."""
    made, test = Recorded(path), join()
    clouds = test.writer(test.cell.points("kinect"), PointCloud2)
    moving = test.writer(test.cell.tf, TransformList)
    client, control = CellClient(join()), RecorderClient(test)
    with (
        running(recorder.run, join(), recorder.Settings(folder=str(path.parent), reserve=0.25)),
        running(finder.run, join(), finder.Settings()),
    ):
        began = control.start(str(path))
        for number, x in enumerate(PLACES):
            T = from_rpy((0.01 * number, 0, 0), (0, 0, 0)) @ T_WORLD_CAMERA
            stamp = Time.now()
            moving.send(TransformList(transforms=(stamped(T, "base_link", FRAME, stamp),)))
            points = book_cloud((TOY_BLOCK, at(x, -0.35, 0.7922, 0.3 * number)))
            clouds.send(cloud_from_points(points, stamp, FRAME))
            made.results.append(find_in(client, stamp))
        assert soon(lambda: control.status().messages >= 8)
        assert began.ok
        control.stop()
    return made
