"""PointCloud2, field by field as ROS has it (sensor_msgs/PointCloud2)."""

from __future__ import annotations

from enum import IntEnum
from typing import Annotated, Self

from pydantic import Field, PlainValidator, Strict, model_validator

from zsight_protocol.message import Bare, Header, Message

__all__ = ["MAXIMUM_BYTES", "MAXIMUM_POINTS", "Buffer", "Datatype", "PointCloud2", "PointField"]

Buffer = bytes | bytearray | memoryview

MAXIMUM_POINTS = 2**27  # 134 million points, 2 GiB at 16 bytes: more is a mistake, not a camera
MAXIMUM_BYTES = 2**32 - 1  # what the length of a msgpack binary can say


class Datatype(IntEnum):
    """Number types of a field, with ROS's codes."""

    INT8 = 1
    UINT8 = 2
    INT16 = 3
    UINT16 = 4
    INT32 = 5
    UINT32 = 6
    FLOAT32 = 7
    FLOAT64 = 8

    @property
    def size(self) -> int:
        """Bytes of one number."""
        return (0, 1, 1, 2, 2, 4, 4, 4, 8)[self]


class PointField(Message):
    """One named number, or row of numbers, inside a point (sensor_msgs/PointField)."""

    name: Annotated[str, Field(min_length=1, max_length=64)]
    offset: Annotated[int, Field(ge=0, lt=2**16)]
    datatype: Annotated[Datatype, Bare()]
    count: Annotated[int, Field(ge=1, lt=2**16)] = 1

    @property
    def end(self) -> int:
        """First byte behind the field."""
        return self.offset + self.datatype.size * self.count


def _require_buffer(data: object) -> Buffer:
    if not isinstance(data, bytes | bytearray | memoryview):
        raise ValueError(f"got {type(data).__name__}; expected bytes")
    if not isinstance(data, memoryview):
        return data
    if not data.c_contiguous or data.itemsize != 1:
        raise ValueError("got a memoryview with strides or of wider numbers; expected contiguous bytes")
    return data.cast("B") if data.ndim != 1 else data


class PointCloud2(Message):
    """A cloud: height x width points of point_step bytes each, row after row, little-endian.

    An organised cloud has the rows and columns of its image, an unorganised one height 1. Positions ``x y z`` are
    metres in the header's frame; ``rgb`` is packed as 0x00RRGGBB into a float32; holes are NaN (then ``is_dense`` is
    false). ``data`` is any contiguous buffer and is never copied here.

    A cloud of no points is not legal: a source that has none sends none.
    """

    header: Header
    height: Annotated[int, Field(ge=0, lt=2**31)]
    width: Annotated[int, Field(ge=0, lt=2**31)]
    fields: Annotated[tuple[PointField, ...], Strict(False), Field(min_length=1, max_length=64)]
    is_bigendian: bool
    point_step: Annotated[int, Field(ge=1, lt=2**16)]
    row_step: Annotated[int, Field(ge=0, lt=2**40)]
    is_dense: bool
    data: Annotated[Buffer, PlainValidator(_require_buffer)]

    @model_validator(mode="after")
    def _require_consistency(self) -> Self:
        points = self.height * self.width
        if points == 0:
            raise ValueError(f"{self.height} x {self.width} is no point at all; expected at least one")
        if points > MAXIMUM_POINTS:
            raise ValueError(f"{self.height} x {self.width} = {points} points; expected at most {MAXIMUM_POINTS}")
        if self.is_bigendian:
            raise ValueError("is_bigendian is true; expected little-endian data: swap the bytes before sending")
        if self.row_step != self.width * self.point_step:
            expected = f"{self.width} x {self.point_step} = {self.width * self.point_step}"
            raise ValueError(f"row_step is {self.row_step}; expected width x point_step = {expected}")
        if self.row_step * self.height > MAXIMUM_BYTES:
            raise ValueError(f"{points} points of {self.point_step} bytes; expected at most {MAXIMUM_BYTES} bytes")
        if len(self.data) != self.row_step * self.height:
            expected = f"{self.height} x {self.row_step} = {self.height * self.row_step}"
            raise ValueError(f"data has {len(self.data)} bytes; expected height x row_step = {expected}")
        self._require_fields_inside()
        return self

    def _require_fields_inside(self) -> None:
        names = [field.name for field in self.fields]
        if len(set(names)) != len(names):
            raise ValueError(f"field names repeat: {', '.join(names)}")
        for field in self.fields:
            if field.end > self.point_step:
                raise ValueError(f"field {field.name} ends at byte {field.end} of a point of {self.point_step} bytes")
