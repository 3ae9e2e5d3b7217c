"""Every message as a ROS message: its name and definition there, and its bytes (CDR).

Messages that mirror one of ROS are that one. All others are ``zsight_msgs/msg/...`` with a definition that follows from
the model itself: an enumeration is its number or word; what may be missing is a sequence of at most one; an array of
fixed size that may be missing is a sequence of none or all; maps, and sequences of sequences, are text in JSON.
"""

from __future__ import annotations

import json
import re
import types
from dataclasses import dataclass
from enum import Enum
from functools import cache, lru_cache
from typing import TYPE_CHECKING, Annotated, Any, TypeVar, Union, get_args, get_origin

from pydantic import ValidationError
from pydantic.fields import FieldInfo

from zsight_protocol.camera_info import CameraInfo
from zsight_protocol.errors import DecodeError
from zsight_protocol.geometry import (
    Point,
    Pose,
    PoseStamped,
    Quaternion,
    Transform,
    TransformList,
    TransformStamped,
    Vector3,
)
from zsight_protocol.message import Header, Message, Time
from zsight_protocol.point_cloud import PointCloud2, PointField
from zsight_protocol.recording import Clock
from zsight_protocol.ros_cdr import read_cdr, write_cdr
from zsight_protocol.ros_definition import SEPARATOR, RosField, parse_definition, short_name

if TYPE_CHECKING:
    from collections.abc import Mapping

    from zsight_protocol.point_cloud import Buffer
    from zsight_protocol.ros_definition import Definitions

__all__ = ["RosType", "from_cdr", "from_values", "ros_type", "to_cdr"]

PACKAGE = "zsight_msgs"

M = TypeVar("M", bound=Message)

_STANDARD: dict[type[Message], tuple[str, str]] = {
    Time: ("builtin_interfaces/Time", "int32 sec\nuint32 nanosec\n"),
    Header: ("std_msgs/Header", "builtin_interfaces/Time stamp\nstring frame_id\n"),
    Vector3: ("geometry_msgs/Vector3", "float64 x\nfloat64 y\nfloat64 z\n"),
    Point: ("geometry_msgs/Point", "float64 x\nfloat64 y\nfloat64 z\n"),
    Quaternion: ("geometry_msgs/Quaternion", "float64 x\nfloat64 y\nfloat64 z\nfloat64 w\n"),
    Pose: ("geometry_msgs/Pose", "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation\n"),
    PoseStamped: ("geometry_msgs/PoseStamped", "std_msgs/Header header\ngeometry_msgs/Pose pose\n"),
    Transform: (
        "geometry_msgs/Transform",
        "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation\n",
    ),
    TransformStamped: (
        "geometry_msgs/TransformStamped",
        "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/Transform transform\n",
    ),
    TransformList: ("tf2_msgs/TFMessage", "geometry_msgs/TransformStamped[] transforms\n"),
    PointField: (
        "sensor_msgs/PointField",
        (
            "uint8 INT8=1\nuint8 UINT8=2\nuint8 INT16=3\nuint8 UINT16=4\nuint8 INT32=5\nuint8 UINT32=6\n"
            "uint8 FLOAT32=7\nuint8 FLOAT64=8\nstring name\nuint32 offset\nuint8 datatype\nuint32 count\n"
        ),
    ),
    PointCloud2: (
        "sensor_msgs/PointCloud2",
        (
            "std_msgs/Header header\nuint32 height\nuint32 width\nsensor_msgs/PointField[] fields\nbool is_bigendian\n"
            "uint32 point_step\nuint32 row_step\nuint8[] data\nbool is_dense\n"
        ),
    ),
    Clock: ("rosgraph_msgs/Clock", "builtin_interfaces/Time clock\n"),
    CameraInfo: (
        "sensor_msgs/CameraInfo",
        (
            "std_msgs/Header header\nuint32 height\nuint32 width\nstring distortion_model\nfloat64[] d\nfloat64[9] k\n"
            "float64[9] r\nfloat64[12] p\nuint32 binning_x\nuint32 binning_y\nsensor_msgs/RegionOfInterest roi\n"
        ),
    ),
}
_PARTS = {  # messages of ROS that only occur inside others, in fields that ours do not have
    "sensor_msgs/RegionOfInterest": "uint32 x_offset\nuint32 y_offset\nuint32 height\nuint32 width\nbool do_rectify\n"
}


@dataclass(frozen=True)
class RosType:
    """A message as ROS knows it: ``name`` (package/msg/Name), the ``text`` of its definition with all its parts."""

    name: str
    text: str
    definitions: Definitions

    @property
    def short(self) -> str:
        """Its name as definitions write it."""
        return short_name(self.name)


@cache
def ros_type(kind: type[Message]) -> RosType:
    """How a kind of message is called and defined in ROS."""
    texts = _texts(kind)
    name, *others = texts
    text = texts[name] + "".join(f"{SEPARATOR}\nMSG: {other}\n{texts[other]}" for other in others)
    return RosType(name.replace("/", "/msg/"), text, parse_definition(name, text))


def to_cdr(message: Message) -> list[Buffer]:
    """The bytes of a message, in parts that follow each other; a big blob is one of them and is not copied."""
    kind = ros_type(type(message))
    return write_cdr(kind.short, _values(message), kind.definitions)


def from_cdr(kind: type[M], payload: Buffer, definition: RosType | None = None) -> M:
    """The message in some bytes; its blob is a view of them.

    Args:
        kind: of message.
        payload: CDR.
        definition: after which the bytes were written, where that may differ from today's: fields are matched by name.

    Raises:
        DecodeError: the bytes are not such a message.
    """
    written = definition or ros_type(kind)
    return from_values(kind, read_cdr(written.short, payload, written.definitions))


def from_values(kind: type[M], values: Mapping[str, Any]) -> M:
    """The message that some values of a ROS message stand for.

    Raises:
        DecodeError: it is not legal here.
    """
    try:
        return kind.model_validate(_entries(kind, values))
    except (ValidationError, ValueError, TypeError, KeyError) as error:
        if isinstance(error, ValidationError):
            raise DecodeError.from_validation(kind.__name__, error) from None
        raise DecodeError(f"not a {kind.__name__}: {error}") from None


# The form of a field, derived from its model.


@dataclass(frozen=True)
class _Form:
    """``type`` is a primitive's, ``string``, ``json``, or a kind of message; then how many of it."""

    type: str | type[Message]
    length: int | None = None
    is_sequence: bool = False
    is_optional: bool = False
    is_copied: bool = False  # bytes that are not a view of those that came

    def field(self, name: str) -> RosField:
        """As a definition has it."""
        bound = (self.length or 1) if self.is_optional else None
        written = ros_name(self.type) if isinstance(self.type, type) else "string" if self.type == "json" else self.type
        many = self.is_sequence or self.is_optional
        return RosField(name, written, None if many else self.length, many, bound)

    def plain(self, value: Any) -> Any:
        """A field's value as CDR has it."""
        if self.is_optional and (self.length is None):
            return [] if value is None else [self._one(value)]
        if self.is_sequence or self.length is not None:
            return () if value is None else value if self.type == "uint8" else [self._one(entry) for entry in value]
        return self._one(value)

    def _one(self, value: Any) -> Any:
        if self.type == "json":
            return json.dumps(value, ensure_ascii=False, separators=(",", ":"), default=_jsonable)
        return _values(value) if isinstance(value, Message) else value.value if isinstance(value, Enum) else value

    def entry(self, value: Any) -> Any:
        """The other way round."""
        if self.is_optional and not len(value):
            return None
        if self.is_optional and self.length is None:
            return self._entry(value[0])
        if self.type == "uint8" and self.is_sequence:
            return bytes(value) if self.is_copied else value
        if self.is_sequence or self.length is not None:
            return tuple(self._entry(entry) for entry in value)
        return self._entry(value)

    def _entry(self, value: Any) -> Any:
        if self.type == "json":
            return json.loads(value)
        return _entries(self.type, value) if isinstance(self.type, type) else value


def _jsonable(value: Any) -> Any:
    if isinstance(value, Message):
        return value.model_dump(mode="json")
    raise TypeError(f"{type(value).__name__} is nothing that JSON has a word for")


@lru_cache(maxsize=256)
def _forms(kind: type[Message]) -> dict[str, _Form]:
    return {name: _form(field.annotation, list(field.metadata)) for name, field in kind.model_fields.items()}


def _form(annotation: Any, marks: list[Any]) -> _Form:
    origin, arguments = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        inner = [m for mark in arguments[1:] for m in (mark.metadata if isinstance(mark, FieldInfo) else [mark])]
        return _form(arguments[0], [*inner, *marks])
    if origin in (Union, types.UnionType):
        return _form_of_union(arguments, marks)
    if origin is tuple:
        return _form_of_tuple(arguments, marks)
    if annotation is bytes:
        return _Form("uint8", is_sequence=True, is_copied=True)
    if isinstance(annotation, type) and origin is None:
        return _Form(_scalar(annotation))
    return _Form("json")


def _form_of_union(arguments: tuple[Any, ...], marks: list[Any]) -> _Form:
    if bytes in arguments:
        return _Form("uint8", is_sequence=True)
    if types.NoneType not in arguments or len(arguments) != 2:
        return _Form("json")
    inner = _form(next(argument for argument in arguments if argument is not types.NoneType), marks)
    if inner.is_sequence or inner.is_optional or inner.type == "json":
        return _Form("json")
    return _Form(inner.type, inner.length, is_optional=True)


def _form_of_tuple(arguments: tuple[Any, ...], marks: list[Any]) -> _Form:
    inner = {_form(argument, []) for argument in arguments if argument is not Ellipsis}
    form = inner.pop()
    if inner or form.is_sequence or form.length is not None or form.is_optional:
        return _Form("json")
    if Ellipsis not in arguments:
        return _Form(form.type, len(arguments))
    low = next((mark.min_length for mark in marks if hasattr(mark, "min_length")), None)
    high = next((mark.max_length for mark in marks if hasattr(mark, "max_length")), None)
    return _Form(form.type, low) if low is not None and low == high else _Form(form.type, is_sequence=True)


def _scalar(kind: type) -> str | type[Message]:
    if issubclass(kind, Message):
        return kind
    if issubclass(kind, Enum):
        return "string" if issubclass(kind, str) else "int64"
    return {bool: "bool", int: "int64", float: "float64", str: "string"}.get(kind, "json")


# Names and texts.


def ros_name(kind: type[Message]) -> str:
    """``package/Name``; a template of a message is called after both."""
    if kind in _STANDARD:
        return _STANDARD[kind][0]
    template = re.fullmatch(r"(\w+)\[(\w+)\]", kind.__name__)
    return f"{PACKAGE}/{template[2]}{template[1]}" if template else f"{PACKAGE}/{kind.__name__}"


def _texts(kind: type[Message]) -> dict[str, str]:
    """The definition of a message and of all its parts, each once, by name."""
    forms = _forms(kind)
    if kind in _STANDARD:
        name, text = _STANDARD[kind]
        inside = {part: _PARTS[part] for part in _PARTS if part in text}
    else:
        name, inside = ros_name(kind), {}
        text = "".join(_constants(kind, field) + form.field(field).text + "\n" for field, form in forms.items())
    found = {name: text}
    for form in forms.values():
        if isinstance(form.type, type):
            found |= _texts(form.type)
    return found | inside


def _constants(kind: type[Message], name: str) -> str:
    """The codes of an enumeration, for people who read the definition."""
    annotation = kind.model_fields[name].annotation
    if not (isinstance(annotation, type) and issubclass(annotation, Enum) and issubclass(annotation, int)):
        return ""
    return "".join(f"int64 {name.upper()}_{member.name}={member.value}\n" for member in annotation)


# Values.


def _values(message: Message) -> dict[str, Any]:
    return {name: form.plain(getattr(message, name)) for name, form in _forms(type(message)).items()}


def _entries(kind: type[Message], values: Mapping[str, Any]) -> dict[str, Any]:
    return {name: form.entry(values[name]) for name, form in _forms(kind).items() if name in values}
