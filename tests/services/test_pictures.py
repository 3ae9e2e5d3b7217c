"""The picture of a live answer is drawn over the cloud of its own camera, from where that stands now."""

from __future__ import annotations

import contextlib
import threading
from typing import TYPE_CHECKING

import pytest
from tests.core.book_scene import T_WORLD_BLOCK, T_WORLD_CAMERA, TOY_BLOCK
from tests.core.book_scene import cloud as book_cloud

from zsight.catalogue import type_files
from zsight.convert import cloud_from_points, pose_of, stamped
from zsight.errors import DeadlinePassed
from zsight.pictures import draw_answer, draw_live
from zsight.transforms import TransformUnknown
from zsight_core.transform import from_rpy, inverse
from zsight_protocol.find_object import DetectedObject, FindObjectResult, ResultCode, Status
from zsight_protocol.geometry import TransformList
from zsight_protocol.message import Header, Time
from zsight_protocol.point_cloud import PointCloud2

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from zsight.bus import Bus

pytestmark = pytest.mark.usefixtures("warm_kernels")

POINTS = book_cloud((TOY_BLOCK, T_WORLD_BLOCK))
T_WORLD_ARM = from_rpy((0.3, 0, 0), (0, 0, 0.2))
T_ARM_CAMERA = inverse(T_WORLD_ARM) @ T_WORLD_CAMERA
FRAME = "left_optical_frame"
FOUND = DetectedObject(
    type="toy_block",
    score=0.97,
    pose=pose_of(T_WORLD_BLOCK),
    size=(0.035, 0.2, 0.035),
    covariance=(0.0,) * 36,
    visible_fraction=1.0,
)
RESULT = FindObjectResult(
    header=Header(stamp=Time.now(), frame_id="world"),
    code=ResultCode.FOUND,
    status=Status.FOUND,
    objects=(FOUND,),
    report={"camera": "left"},
)


@contextlib.contextmanager
def live(bus: Bus, *, moving: bool) -> Iterator[None]:
    """A camera on an arm, beside another one, that publish until the end of the block."""
    stamp, done = Time.now(), threading.Event()
    clouds = {name: bus.writer(bus.cell.points(name), PointCloud2) for name in ("left", "kinect")}
    frames, static = bus.writer(bus.cell.tf, TransformList), bus.writer(bus.cell.tf_static, TransformList)
    static.send(TransformList(transforms=(stamped(T_ARM_CAMERA, "arm", FRAME, stamp),)))
    times = (Time(sec=stamp.sec - 1), Time(sec=stamp.sec + 1))
    arm = TransformList(transforms=tuple(stamped(T_WORLD_ARM, "world", "arm", time) for time in times))

    def publish() -> None:
        while not done.wait(0.02):
            clouds["left"].send(cloud_from_points(POINTS, stamp, FRAME))
            clouds["kinect"].send(cloud_from_points(POINTS[:240], stamp, "other"))
            if moving:
                frames.send(arm)

    thread = threading.Thread(target=publish)
    thread.start()
    try:
        yield
    finally:
        done.set()
        thread.join()


def test_an_answer_is_drawn_over_the_cloud_of_its_own_camera_where_that_is_now(
    join_memory: Callable[[], Bus], tmp_path: Path
) -> None:
    types = type_files.load(type_files.shipped_folder())
    draw_answer(tmp_path / "expected.png", POINTS, RESULT, types, T_WORLD_ARM @ T_ARM_CAMERA)
    with live(join_memory(), moving=True):
        draw_live(join_memory(), RESULT, tmp_path / "live.png")
    assert (tmp_path / "live.png").read_bytes() == (tmp_path / "expected.png").read_bytes()


def test_what_is_missing_for_a_picture_is_said(join_memory: Callable[[], Bus], tmp_path: Path) -> None:
    with pytest.raises(DeadlinePassed, match="left/points"):
        draw_live(join_memory(), RESULT, tmp_path / "no.png")
    with live(join_memory(), moving=False), pytest.raises(TransformUnknown):
        draw_live(join_memory(), RESULT, tmp_path / "no.png")
    assert not (tmp_path / "no.png").exists()
