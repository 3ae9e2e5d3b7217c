"""Every message as a ROS message: no loss, and the same bytes as independent implementations."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap_ros2._dynamic import generate_dynamic
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from tests.protocol.legal_messages import all_kinds, messages

from zsight_protocol.camera_info import CameraInfo
from zsight_protocol.errors import DecodeError, EncodeError
from zsight_protocol.find_object import FindObjectResult
from zsight_protocol.geometry import Pose, TransformList
from zsight_protocol.message import Header, Message, Time
from zsight_protocol.point_cloud import PointCloud2
from zsight_protocol.ros_cdr import read_cdr, write_cdr
from zsight_protocol.ros_definition import parse_definition
from zsight_protocol.ros_message import RosType, from_cdr, ros_type, to_cdr

kinds = pytest.mark.parametrize("kind", [pytest.param(kind, id=kind.__name__) for kind in all_kinds()])


def bytes_of(message: Message) -> bytes:
    return b"".join(to_cdr(message))


@kinds
@settings(max_examples=12)
@given(data=st.data())
def test_a_message_comes_back_whole(kind: type[Message], data: st.DataObject) -> None:
    message = data.draw(messages(kind))
    assert from_cdr(kind, bytes_of(message)) == message


def as_rosbags_reads(kind: RosType, payload: bytes) -> tuple[Any, bytes]:
    """The message, and the bytes that rosbags makes of it."""
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(kind.text, kind.name))
    message = store.deserialize_cdr(payload, kind.name)
    return message, bytes(store.serialize_cdr(message, kind.name))


def as_mcap_ros2_reads(kind: RosType, payload: bytes) -> Any:
    return generate_dynamic(kind.name, kind.text)[kind.name](payload)


def fits(ours: Any, theirs: Any) -> bool:
    """Whether a value of another reader is the one that ours reads."""
    if isinstance(ours, dict):
        return all(fits(value, getattr(theirs, name)) for name, value in ours.items())
    if isinstance(ours, memoryview):
        return bytes(ours) == bytes(theirs)
    if isinstance(ours, list | tuple):
        return len(ours) == len(theirs) and all(map(fits, ours, theirs))
    return bool(ours == theirs)


@kinds
@settings(max_examples=12)
@given(data=st.data())
def test_independent_readers_agree(kind: type[Message], data: st.DataObject) -> None:
    payload = bytes_of(data.draw(messages(kind)))
    ros = ros_type(kind)
    ours = read_cdr(ros.short, payload, ros.definitions)
    assert fits(ours, as_mcap_ros2_reads(ros, payload))
    message, again = as_rosbags_reads(ros, payload)
    assert fits(ours, message)
    assert again == payload


def test_messages_of_ros_are_those_of_ros() -> None:
    store = get_typestore(Stores.ROS2_JAZZY)
    for kind in (PointCloud2, CameraInfo, TransformList, Pose, Header, Time):
        ros = ros_type(kind)
        own = get_typestore(Stores.EMPTY)
        own.register(get_types_from_msg(ros.text, ros.name))
        assert own.hash_rihs01(ros.name) == store.hash_rihs01(ros.name)


def test_what_is_in_a_definition_is_said_in_ros_words() -> None:
    text = ros_type(FindObjectResult).text
    assert "int64 CODE_NOT_FOUND=1\n" in text
    assert "zsight_msgs/DetectedObject[] objects\n" in text
    assert "float64[36] covariance\n" in text
    assert "zsight_msgs/Support[<=1] support\n" in text


def test_a_definition_of_another_version_is_matched_by_name() -> None:
    text = "string finder\nint32 code\nfloat32 gone\nstring status\nstd_msgs/Header header\n"
    written = RosType("zsight_msgs/msg/FindObjectResult", text, {
        **ros_type(Header).definitions, **parse_definition("zsight_msgs/FindObjectResult", text),
    })  # fmt: skip
    values = {"finder": "f", "code": 1, "gone": 2.5, "status": "not_found", "header": {"frame_id": "eye"}}
    payload = b"".join(write_cdr(written.short, values, written.definitions))
    result = from_cdr(FindObjectResult, payload, written)
    assert (result.finder, result.status.value, result.header.frame_id, result.objects) == ("f", "not_found", "eye", ())


def test_both_byte_orders_are_read() -> None:
    definitions = parse_definition("p/M", "uint8 a\nuint32 b\nfloat64[] c")
    big = bytes.fromhex("00000000 01000000 00000002 00000001 00000000 3ff0000000000000")
    assert read_cdr("p/M", big, definitions) == {"a": 1, "b": 2, "c": (1.0,)}


@pytest.mark.parametrize("cut", [0, 3, 4, 9, 30, 60])
def test_bytes_that_end_too_early_are_refused(cut: int) -> None:
    payload = bytes_of(TransformList.model_validate({"transforms": [_TRANSFORM]}))
    with pytest.raises(DecodeError):
        from_cdr(TransformList, payload[:cut])


def test_a_length_that_lies_allocates_nothing() -> None:
    payload = b"\x00\x01\x00\x00" + b"\xff\xff\xff\x7f"
    with pytest.raises(DecodeError, match="declares 2147483647 entries"):
        from_cdr(TransformList, payload)


def test_a_definition_that_is_none_is_refused() -> None:
    with pytest.raises(DecodeError, match="expected a type and a name"):
        parse_definition("p/M", "uint8")
    with pytest.raises(EncodeError):
        write_cdr("p/M", {"a": "text"}, parse_definition("p/M", "uint8 a"))


_TRANSFORM = {
    "header": {"stamp": {"sec": 1, "nanosec": 2}, "frame_id": "world"},
    "child_frame_id": "eye",
    "transform": {"translation": {"x": 1.0, "y": 2.0, "z": 3.0}, "rotation": {}},
}
