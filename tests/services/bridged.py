"""What a bridge is given in the tests: a cloud, frames and an answer, sent on a bus in memory."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from tests.services.running import running

from zsight.bridge import feed
from zsight.convert import cloud_from_points, pose_of, stamped
from zsight.settings import Settings
from zsight_core.points import from_xyz
from zsight_core.transform import from_rpy
from zsight_protocol.action import GoalState, Update
from zsight_protocol.find_object import DetectedObject, FindObjectResult, ResultCode, Status
from zsight_protocol.geometry import TransformList
from zsight_protocol.message import Header, Time
from zsight_protocol.point_cloud import PointCloud2

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from zsight.bridge import Sink
    from zsight.bus import Bus

__all__ = ["CLOUD", "FRAME", "STAMP", "T_CAMERA", "T_FOUND", "XYZ", "answer", "bridged"]

FRAME = "eye_optical_frame"
STAMP = Time(sec=1_700_000_000, nanosec=123_456_789)
XYZ = np.array([[0.1, 0.2, 1.0], [np.nan, np.nan, np.nan], [-0.3, 0.4, 2.0]], np.float32)
RGB = np.array([[250, 10, 20], [0, 0, 0], [30, 40, 200]], np.uint8)
CLOUD = cloud_from_points(from_xyz(XYZ, RGB), STAMP, FRAME)
T_CAMERA = from_rpy((1.0, 2.0, 3.0), (0.1, 0.2, 0.3))
T_FOUND = from_rpy((0.5, -0.25, 0.75), (0, 0, 0.5))


def answer(*types: str, asked: str = "toy_block") -> Update[FindObjectResult]:
    """An answer that found objects of these types."""
    objects = tuple(
        DetectedObject(
            type=name,
            score=0.97,
            pose=pose_of(T_FOUND),
            size=(0.035, 0.2, 0.035),
            covariance=(0.0,) * 36,
            visible_fraction=1.0,
        )
        for name in types
    )
    result = FindObjectResult(
        header=Header(stamp=STAMP, frame_id="world"),
        code=ResultCode.FOUND if types else ResultCode.NOT_FOUND,
        status=Status.FOUND if types else Status.NOT_FOUND,
        objects=objects,
        report={"object_type": asked},
    )
    return Update(
        goal_id="0b8d0f3e-98b5-4d4f-8a0c-0d6d5a6f6b11", state=GoalState.SUCCEEDED, final=True, server="f", result=result
    )


def bridged(join: Callable[[], Bus], sink: Sink) -> Iterator[Callable[..., None]]:
    """A bridge that runs, and has been sent frames; what is yielded sends clouds and answers."""
    bus, other = join(), join()
    kind: type[Update[FindObjectResult]] = Update[FindObjectResult]
    answers = bus.writer(bus.cell.feedback("f"), kind)
    clouds = bus.writer(bus.cell.points("kinect"), PointCloud2)
    frames = bus.writer(bus.cell.tf_static, TransformList)

    def send(*messages: PointCloud2 | Update[FindObjectResult]) -> None:
        for message in messages:
            answers.send(message) if isinstance(message, Update) else clouds.send(message)

    with running(lambda on, _: feed(on, sink), other, Settings()):
        frames.send(TransformList(transforms=(stamped(T_CAMERA, "world", FRAME, STAMP),)))
        yield send
