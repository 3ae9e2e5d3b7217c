"""CameraInfo, field by field as ROS has it (sensor_msgs/CameraInfo)."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, Strict

from zsight_protocol.message import Float64, Header, Message

__all__ = ["CameraInfo"]


class CameraInfo(Message):
    """How a camera projects: K, D, R and P row by row, pixels; k[0] of zero means not calibrated."""

    header: Header
    height: Annotated[int, Field(ge=0, lt=2**31)]
    width: Annotated[int, Field(ge=0, lt=2**31)]
    distortion_model: str = "plumb_bob"
    d: Annotated[tuple[Float64, ...], Strict(False), Field(max_length=14)] = ()
    k: Annotated[tuple[Float64, ...], Strict(False), Field(min_length=9, max_length=9)]
    r: Annotated[tuple[Float64, ...], Strict(False), Field(min_length=9, max_length=9)]
    p: Annotated[tuple[Float64, ...], Strict(False), Field(min_length=12, max_length=12)]
