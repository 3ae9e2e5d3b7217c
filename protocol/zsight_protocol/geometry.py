"""Poses, transforms and boxes, field by field as ROS has them; metres, radians, quaternions x y z w."""

from __future__ import annotations

import math
from typing import Annotated, Self

from pydantic import Field, Strict, model_validator

from zsight_protocol.message import Count, Float64, Header, Message, Tuple3

__all__ = [
    "Plane",
    "Point",
    "Pose",
    "PoseStamped",
    "Quaternion",
    "Region",
    "Transform",
    "TransformList",
    "TransformStamped",
    "Vector3",
]


class Vector3(Message):
    """A direction or a translation, metres."""

    x: Float64 = 0.0
    y: Float64 = 0.0
    z: Float64 = 0.0


class Point(Vector3):
    """A place, metres."""


class Quaternion(Message):
    """A rotation as a unit quaternion."""

    x: Float64 = 0.0
    y: Float64 = 0.0
    z: Float64 = 0.0
    w: Float64 = 1.0

    @model_validator(mode="after")
    def _require_unit_length(self) -> Self:
        length = math.hypot(self.x, self.y, self.z, self.w)  # huge numbers become inf here and no OverflowError
        if abs(length - 1) > 1e-3:
            raise ValueError(f"quaternion has length {length:.4g}; expected 1")
        return self


class Pose(Message):
    """Where something is and how it is turned."""

    position: Point = Point()
    orientation: Quaternion = Quaternion()


class PoseStamped(Message):
    """A pose with its time and frame."""

    header: Header
    pose: Pose


class Transform(Message):
    """How the child frame sits in its parent."""

    translation: Vector3 = Vector3()
    rotation: Quaternion = Quaternion()


class TransformStamped(Message):
    """A transform with its time, its parent frame (in the header) and its child frame."""

    header: Header
    child_frame_id: Annotated[str, Field(min_length=1, max_length=256)]
    transform: Transform


class TransformList(Message):
    """Transforms that hold together (tf2_msgs/TFMessage)."""

    transforms: Annotated[tuple[TransformStamped, ...], Strict(False)] = ()


class Region(Message):
    """An upright box in the frame of the request, metres: only what lies inside is of interest."""

    low: Tuple3
    high: Tuple3

    @model_validator(mode="after")
    def _require_volume(self) -> Self:
        if not all(low < high for low, high in zip(self.low, self.high, strict=True)):
            raise ValueError(f"region from {self.low} to {self.high} is empty; expected low < high on every axis")
        return self


class Plane(Message):
    """A plane n . p = distance in the header's frame, with the unit normal toward the camera (distance <= 0).

    ``pose`` is a frame on the plane: origin at the patch, z along the normal. ``inliers`` counts the points of the
    cloud within ``tolerance`` metres of it.
    """

    header: Header
    normal: Vector3
    distance: Float64
    pose: Pose
    inliers: Count
    tolerance: Annotated[Float64, Field(gt=0)]
    rms: Annotated[Float64, Field(ge=0)]
