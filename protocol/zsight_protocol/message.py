"""The base of all messages: immutable, strictly typed, without unknown fields."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Annotated, Any, Self

from pydantic import BaseModel, ConfigDict, Field, JsonValue, Strict
from pydantic_core import core_schema

if TYPE_CHECKING:
    from pydantic import GetCoreSchemaHandler

__all__ = ["Bare", "Count", "Extras", "Float64", "Header", "Message", "Time", "Tuple2", "Tuple3", "Tuple4"]


_set = object.__setattr__  # the way into what is read-only


class Message(BaseModel):
    """A message: fields are read-only, of exactly the stated type, and no others are accepted."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, defer_build=True)

    def but(self, **fields: Any) -> Self:
        """This message with other values in some fields, which must be legal: nothing is checked."""
        # model_copy does this and more, and takes twice as long.
        other = object.__new__(type(self))
        _set(other, "__dict__", {**self.__dict__, **fields})
        _set(other, "__pydantic_fields_set__", self.__pydantic_fields_set__)
        _set(other, "__pydantic_extra__", None)
        _set(other, "__pydantic_private__", None)
        return other


class Bare:
    """Marks an enumeration that travels as its bare number or word, and comes back from exactly that type."""

    def __get_pydantic_core_schema__(self, source: type[Any], handler: GetCoreSchemaHandler) -> core_schema.CoreSchema:
        """Refuse what pydantic would convert (true and "1" to 1), then look the value up."""
        plain = int if issubclass(source, int) else str
        lookup = handler.generate_schema(Annotated[source, Strict(False)])

        def require_plain(value: object) -> object:
            if type(value) not in (plain, source):
                raise ValueError(f"got {type(value).__name__}; expected {plain.__name__}")
            return value

        return core_schema.no_info_before_validator_function(require_plain, lookup)


Count = Annotated[int, Field(ge=0, lt=2**63)]
Extras = dict[str, JsonValue]  # what users carry along: text, numbers, truth values, lists and maps of them
Float64 = Annotated[float, Field(allow_inf_nan=False)]
# msgpack knows one kind of sequence, so a list on the wire may become a tuple here; the numbers inside stay strict.
Tuple2 = Annotated[tuple[Float64, Float64], Strict(False)]
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

    @staticmethod
    def now() -> Time:
        """This host's clock."""
        sec, nanosec = divmod(time.time_ns(), 10**9)
        return _EPOCH.but(sec=sec, nanosec=nanosec)

    @property
    def ns(self) -> int:
        """Nanoseconds since the epoch."""
        return self.sec * 10**9 + self.nanosec


_EPOCH = Time(sec=0, nanosec=0)


class Header(Message):
    """When and in which frame something was measured (std_msgs/Header)."""

    stamp: Time = Time()
    frame_id: Annotated[str, Field(max_length=256)] = ""
