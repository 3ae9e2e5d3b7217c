"""Topics of other robots as keys of a cell, so that our services find what they read."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from zsight.recording.played import Line
from zsight.recording.recording_file import row_of
from zsight.recording.ros_image import CompressedImage, Image
from zsight_protocol.camera_info import CameraInfo
from zsight_protocol.channels import Delivery
from zsight_protocol.geometry import TransformList
from zsight_protocol.point_cloud import PointCloud2
from zsight_protocol.ros_definition import short_name

if TYPE_CHECKING:
    from zsight_protocol.message import Message

__all__ = ["camera_of", "foreign_line"]

_KINDS: dict[str, type[Message]] = {
    "sensor_msgs/PointCloud2": PointCloud2,
    "sensor_msgs/CameraInfo": CameraInfo,
    "tf2_msgs/TFMessage": TransformList,
    "tf/tfMessage": TransformList,
    "sensor_msgs/Image": Image,
    "sensor_msgs/CompressedImage": CompressedImage,
}
"""Messages of ROS that we have, by their name without ``msg``."""

_ENDINGS = ("points", "camera_info", "image_raw", "image_rect", "image_rect_raw", "image_rect_color", "image_color",
            "image", "compressed", "image_depth", "hw_registered")  # fmt: skip


def foreign_line(number: int, topic: str, type_name: str, count: int) -> Line | None:
    """What a topic of another robot is here; none where we have no message for it.

    Images keep their topic, with a slash before it, as their key: they are made into clouds, and not sent themselves.
    """
    kind = _KINDS.get(short_name(type_name))
    if kind is None:
        return None
    key = _key_for(topic, kind)
    row = None if key is None else row_of(f"zsight/{key}", "zsight")
    delivery = Delivery.LATEST if row is None else row.delivery
    return Line(number, key or f"/{topic.strip('/')}", topic, kind, delivery, count, type_name)


def _key_for(topic: str, kind: type[Message]) -> str | None:
    """The key, without namespace, on which messages of a topic belong; none where there is no row for them."""
    if kind is TransformList:
        return "tf_static" if topic.rstrip("/").endswith("tf_static") else "tf"
    if kind is PointCloud2:
        return f"{camera_of(topic)}/points"
    if kind is CameraInfo:
        return f"{camera_of(topic)}/camera_info"
    return None


def camera_of(topic: str) -> str:
    """A camera's name from a topic: ``camera_depth`` of ``/camera/depth/image_raw``."""
    parts = [part for part in topic.strip("/").lower().split("/") if part]
    while len(parts) > 1 and parts[-1] in _ENDINGS:
        parts.pop()
    name = re.sub(r"[^a-z0-9_.-]", "_", "_".join(parts)).lstrip(".-") or "camera"
    return f"{name}_camera" if name in ("tf", "tf_static", "find_object", "catalog", "clock") else name
