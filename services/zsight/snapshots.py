"""One cloud off the wire, with the place it was seen from."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from zsight.convert import points_of
from zsight.sources import viewpoint_of
from zsight.transforms import TransformBuffer
from zsight_protocol.geometry import TransformList
from zsight_protocol.point_cloud import PointCloud2

if TYPE_CHECKING:
    from zsight.bus import Bus
    from zsight_core.points import Points
    from zsight_protocol.message import Time

__all__ = ["Snapshot", "take_snapshot"]

_TRANSFORMS_WAIT = 0.1  # seconds; static transforms come at once to who asks, or there are none


@dataclass(frozen=True)
class Snapshot:
    """A cloud (H, W) with its stamp and frame; viewpoint is x y z qw qx qy qz in the world, or the origin."""

    points: Points
    stamp: Time
    frame_id: str
    viewpoint: tuple[float, ...]


def take_snapshot(bus: Bus, key: str, timeout: float) -> Snapshot | None:
    """The next cloud on a key; none where none came within timeout seconds."""
    static = bus.reader(bus.cell.tf_static, TransformList)
    clouds = bus.reader(key, PointCloud2)
    received = clouds.take(timeout)
    if received is None:
        return None
    buffer = TransformBuffer()
    while (transforms := static.take(_TRANSFORMS_WAIT)) is not None:
        buffer.put(transforms.message, static=True)
    cloud = received.message
    frame = cloud.header.frame_id
    T_world_camera = buffer.lookup(buffer.root_of(frame), frame)
    return Snapshot(points_of(cloud), cloud.header.stamp, frame, viewpoint_of(T_world_camera))
