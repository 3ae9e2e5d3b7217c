"""The base of all messages: immutable, strictly typed, without unknown fields."""

from __future__ import annotations

import time
from typing import Annotated, Self

from pydantic import BaseModel, ConfigDict, Field, Strict

__all__ = ["Float64", "Header", "Message", "Time", "Tuple3", "Tuple4"]


class Message(BaseModel):
    """A message: fields are read-only, of exactly the stated type, and no others are accepted."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)


Float64 = Annotated[float, Field(allow_inf_nan=False)]
# msgpack knows one kind of sequence, so a list on the wire may become a tuple here; the numbers inside stay strict.
Tuple3 = Annotated[tuple[Float64, Float64, Float64], Strict(False)]
Tuple4 = Annotated[tuple[Float64, Float64, Float64, Float64], Strict(False)]


class Time(Message):
    """Seconds and nanoseconds since the epoch, as ROS splits them."""

    sec: Annotated[int, Field(ge=-(2**31), lt=2**31)] = 0
    nanosec: Annotated[int, Field(ge=0, lt=10**9)] = 0

    @classmethod
    def from_ns(cls, nanoseconds: int) -> Self:
        """From nanoseconds since the epoch."""
        return cls(sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9)

    @classmethod
    def now(cls) -> Self:
        """This host's clock."""
        return cls.from_ns(time.time_ns())

    @property
    def ns(self) -> int:
        """Nanoseconds since the epoch."""
        return self.sec * 10**9 + self.nanosec


class Header(Message):
    """When and in which frame something was measured (std_msgs/Header)."""

    stamp: Time = Time()
    frame_id: Annotated[str, Field(max_length=256)] = ""
