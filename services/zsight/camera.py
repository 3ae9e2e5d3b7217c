"""The camera service: one source of clouds on the bus, with its calibration and its place in the world."""

from __future__ import annotations

import logging
import math
import time
from typing import TYPE_CHECKING

from pydantic import Field, field_validator

from zsight.convert import cloud_from_points
from zsight.errors import UsageError
from zsight.settings import Live
from zsight.settings import Settings as ServiceSettings
from zsight.sources import open_source, placed, pose_matrix
from zsight_core.errors import FileError
from zsight_protocol.camera_info import CameraInfo
from zsight_protocol.geometry import TransformList
from zsight_protocol.message import Time
from zsight_protocol.point_cloud import PointCloud2

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from zsight.bus import Bus, Writer
    from zsight.sources import Source
    from zsight_core.points import Points

__all__ = ["Settings", "run"]

log = logging.getLogger(__name__)

_NOT_YET = Time()  # stamp of a cloud that waits for its time
_LOOK = 0.1  # seconds between two looks at the rate while the next cloud waits for its time


class Settings(ServiceSettings):
    """Settings of the camera service."""

    camera: str = Field("kinect", description="name of the camera in the keys")
    source: str = Field(
        "book",
        description="ellipse; a scene's name or .yaml file; a .pcd or .ply file; a folder of those, or of RGB-D pairs; "
        "a recording (.mcap, .bag or the folder of a ROS 2 bag)",
    )
    rate: Live[float | None] = Field(
        None, gt=0, le=1000, description="clouds a second (above 0, up to 1000); the source's own if not given"
    )
    loop: Live[bool] = Field(True, description="begin again after the last file; otherwise stop there")
    frame: str = Field("", description="frame of clouds from files; CAMERA_optical_frame if not given")
    pose: Live[str] = Field(
        "",
        description="x y z qx qy qz qw of the clouds' frame in the world, metres; viewpoint: the .pcd file's; "
        "as the scene says if not given",
    )
    world_frame: str = Field("world", description="name of the world's frame for such a pose")
    seed: int | None = Field(None, ge=0, description="seed of a scene's noise; the scene's own if not given")

    @field_validator("pose")
    @classmethod
    def _require_pose(cls, pose: str) -> str:
        if pose not in ("", "viewpoint"):
            try:
                pose_matrix(pose)
            except UsageError as error:
                raise ValueError(str(error)) from None
        return pose


def run(bus: Bus, settings: Settings) -> None:
    """Publish the source's clouds at their rate, each stamped with the time it was taken."""
    frame = settings.frame or f"{settings.camera}_optical_frame"
    source = open_source(
        settings.source, frame=frame, pose=settings.pose, world_frame=settings.world_frame, seed=settings.seed
    )
    writer = bus.writer(bus.cell.points(settings.camera), PointCloud2)
    if source.camera_info is not None:
        bus.writer(bus.cell.camera_info(settings.camera), CameraInfo).send(source.camera_info)
    transforms = bus.writer(bus.cell.tf_static, TransformList)
    if source.transforms is not None:
        transforms.send(source.transforms)
    pose = settings.pose
    clouds = (cloud_from_points(points, _NOT_YET, source.frame_id) for points in _stream(source, settings))
    bus.ready()
    for cloud in _paced(clouds, lambda: settings.rate or source.rate, bus):
        if settings.pose != pose:
            pose = settings.pose
            _move(source, pose, settings.world_frame, transforms)
        writer.send(cloud.but(header=cloud.header.but(stamp=Time.now())))


def _move(source: Source, pose: str, world_frame: str, writer: Writer[TransformList]) -> None:
    """Tell everybody where the camera stands now."""
    transforms = placed(source, pose, world_frame)
    if transforms is not None:
        writer.send(transforms)
    log.info("the camera stands at %s", pose or "where its source says")


def _stream(source: Source, settings: Settings) -> Iterator[Points]:
    """The source's clouds, over and over where asked; an unreadable file is logged and passed over."""
    told: set[str] = set()  # what was logged already: a folder in a loop comes back to its bad file for ever
    while True:
        sent = 0
        clouds = source.clouds()
        while True:
            try:
                points = next(clouds, None)
            except FileError as error:
                if str(error) not in told:
                    log.warning("passed over: %s", error)
                    told.add(str(error))
                continue
            if points is None:
                break
            if points.size == 0:
                log.warning("passed over a cloud without points")
                continue
            sent += 1
            yield points
        if not settings.loop or not sent:
            return


def _paced(clouds: Iterator[PointCloud2], rate: Callable[[], float], bus: Bus) -> Iterator[PointCloud2]:
    """Each cloud at its time; a cloud that took too long shifts those behind it instead of crowding them."""
    last = -math.inf
    for cloud in clouds:
        while (left := last + 1 / rate() - time.monotonic()) > 0 and not bus.stopping.wait(min(left, _LOOK)):
            pass  # the rate may have changed meanwhile
        if bus.stopping.is_set():
            return
        now, gap = time.monotonic(), 1 / rate()
        last = last + gap if now - last < 2 * gap else now
        yield cloud
