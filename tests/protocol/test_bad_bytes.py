"""Bytes that are not the message they should be: one kind of error, which says what was wrong."""

from __future__ import annotations

from typing import Any

import msgpack
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.protocol.legal_messages import all_kinds, messages

from zsight_protocol.action import CancelResponse
from zsight_protocol.codec import decode, encode
from zsight_protocol.errors import DecodeError
from zsight_protocol.find_object import FindObjectGoal
from zsight_protocol.geometry import Quaternion, Region
from zsight_protocol.message import Header, Message
from zsight_protocol.object_type import ObjectType
from zsight_protocol.point_cloud import PointCloud2

KINDS = [pytest.param(kind, id=kind.__name__) for kind in all_kinds()]
GOAL_ID = "01234567-89ab-cdef-0123-456789abcdef"


def cloud_bytes(**changes: Any) -> bytes:
    """The bytes of a cloud of 2 x 3 points, packed by hand, with some entries changed."""
    entries = {
        "header": {"stamp": {"sec": 1, "nanosec": 2}, "frame_id": "camera"},
        "height": 2,
        "width": 3,
        "fields": [{"name": "x", "offset": 0, "datatype": 7, "count": 1}],
        "is_bigendian": False,
        "point_step": 4,
        "row_step": 12,
        "is_dense": True,
    }
    data = changes.pop("data", bytes(24))
    packed: bytes = msgpack.packb({**entries, **changes, "data": data})
    return packed


def complaint(kind: type[Message], payload: bytes) -> str:
    """What is said about bytes that must be refused."""
    with pytest.raises(DecodeError) as caught:
        decode(kind, payload)
    return str(caught.value)


def test_the_cloud_packed_by_hand_is_legal() -> None:
    assert decode(PointCloud2, cloud_bytes()).width == 3


FIELD = {"name": "x", "offset": 0, "datatype": 7, "count": 1}


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"height": 0}, "0 x 3 is no point at all"),
        ({"width": 0, "row_step": 0, "data": b""}, "2 x 0 is no point at all"),
        ({"height": 2**16, "width": 2**15, "row_step": 2**17}, "65536 x 32768 = 2147483648 points; expected at most"),
        ({"height": 2**31}, "height: Input should be less than 2147483648"),
        ({"height": -1}, "height: Input should be greater than or equal to 0"),
        ({"height": 3}, "data has 24 bytes; expected height x row_step = 3 x 12 = 36"),
        ({"width": 4}, "row_step is 12; expected width x point_step = 4 x 4 = 16"),
        ({"row_step": 16}, "row_step is 16; expected width x point_step = 3 x 4 = 12"),
        ({"data": bytes(23)}, "data has 23 bytes; expected height x row_step = 2 x 12 = 24"),
        ({"data": bytes(25)}, "data has 25 bytes; expected height x row_step = 2 x 12 = 24"),
        ({"is_bigendian": True}, "is_bigendian is true; expected little-endian data"),
        ({"is_bigendian": 0}, "is_bigendian: Input should be a valid boolean"),
        ({"height": 2.0}, "height: Input should be a valid integer"),
        ({"height": True}, "height: Input should be a valid integer"),
        ({"height": "2"}, "height: Input should be a valid integer"),
        ({"height": None}, "height: Input should be a valid integer"),
        ({"header": []}, "header: Input should be"),
        ({"fields": []}, "fields: Tuple should have at least 1 item"),
        ({"fields": {}}, "fields: Input should be a valid tuple"),
        ({"fields": [FIELD] * 65}, "fields: Tuple should have at most 64 items"),
        ({"fields": [FIELD, FIELD]}, "field names repeat: x, x"),
        ({"fields": [{**FIELD, "name": ""}]}, "fields.0.name: String should have at least 1 character"),
        ({"fields": [{**FIELD, "offset": 1}]}, "field x ends at byte 5 of a point of 4 bytes"),
        ({"fields": [{**FIELD, "count": 2}]}, "field x ends at byte 8 of a point of 4 bytes"),
        ({"fields": [{**FIELD, "count": 0}]}, "fields.0.count: Input should be greater than or equal to 1"),
        ({"fields": [{**FIELD, "datatype": 9}]}, "fields.0.datatype: Input should be 1, 2, 3, 4, 5, 6, 7 or 8"),
        ({"fields": [{**FIELD, "datatype": True}]}, "fields.0.datatype: got bool; expected int"),
        ({"fields": [{**FIELD, "datatype": "7"}]}, "fields.0.datatype: got str; expected int"),
        ({"fields": [{**FIELD, "unit": "m"}]}, "fields.0.unit: Extra inputs are not permitted"),
        ({"color": "red"}, "color: Extra inputs are not permitted"),
        ({"data": "text"}, "data starts with byte 164; expected a msgpack binary"),
        ({"data": None}, "data starts with byte 192; expected a msgpack binary"),
    ],
)
def test_a_cloud_that_does_not_add_up_is_refused(changes: dict[str, Any], words: str) -> None:
    said = complaint(PointCloud2, cloud_bytes(**changes))
    assert said.startswith("not a PointCloud2: ")
    assert words in said


def test_a_cloud_larger_than_a_msgpack_binary_is_refused() -> None:
    said = complaint(PointCloud2, cloud_bytes(height=2**16, width=2, point_step=2**15, row_step=2**16))
    assert "expected at most 4294967295 bytes" in said


@pytest.mark.parametrize("name", sorted(PointCloud2.model_fields))
def test_a_cloud_that_lacks_an_entry_is_refused(name: str) -> None:
    entries = msgpack.unpackb(cloud_bytes())
    del entries[name]
    assert f"{name}: Field required" in complaint(PointCloud2, msgpack.packb(entries))


def test_data_that_is_not_the_last_entry_is_refused() -> None:
    entries = msgpack.unpackb(cloud_bytes())
    moved = {"data": entries.pop("data"), **entries}
    assert "data is entry 1 of 9; expected it to be the last" in complaint(PointCloud2, msgpack.packb(moved))


def test_an_entry_that_stands_there_twice_is_refused() -> None:
    payload = cloud_bytes()
    twice = b"\x8a" + msgpack.packb("height") + b"\x02" + payload[1:]
    assert "entry height stands there twice" in complaint(PointCloud2, twice)


def test_data_whose_length_lies_is_refused() -> None:
    payload = cloud_bytes()
    at = len(payload) - 24 - 1
    for length in (0, 23, 25, 255):
        wrong = payload[:at] + bytes([length]) + payload[at + 1 :]
        assert f"data declares {length} bytes and 24 follow" in complaint(PointCloud2, wrong)


@pytest.mark.parametrize(
    ("payload", "words"),
    [
        (b"", "0 bytes that are not one msgpack map"),
        (b"\xc1", "1 bytes that are not one msgpack map"),
        (b"\x90", "the bytes hold a list; expected a map"),
        (b"\x05", "the bytes hold a int; expected a map"),
        (b"\xc4\x02\x80\x80", "the bytes hold a bytes; expected a map"),
        (b"\x80\x80", "1 bytes follow the map; expected none"),
        (b"\x81\x01\x02", "int is not allowed for map key"),
        (b"\x81\x90\x02", "not one msgpack map"),
        (b"\x81\xa1\xff\x02", "can't decode byte 0xff"),
        (b"\x81\xa1x\xd4\x01\x00", "not one msgpack map"),
        (b"\x81\xa1x\x02", "x: Extra inputs are not permitted"),
        (b"\x81\xa8frame_id\x02", "frame_id: Input should be a valid string"),
        (b"\x81\xa8frame_id\xc4\x01x", "frame_id: Input should be a valid string"),
        (b"\x91" * 2000 + b"\x80", "not one msgpack map"),
    ],
)
def test_bytes_that_are_no_map_of_ours_are_refused(payload: bytes, words: str) -> None:
    said = complaint(Header, payload)
    assert said.startswith("not a Header: ")
    assert words in said


@pytest.mark.parametrize(
    ("kind", "entries", "words"),
    [
        (Quaternion, {"x": 1e200}, "quaternion has length 1e+200; expected 1"),
        (Quaternion, {"w": 0}, "quaternion has length 0; expected 1"),
        (Quaternion, {"w": float("nan")}, "w: Input should be a finite number"),
        (Quaternion, {"w": True}, "w: Input should be a valid number"),
        (Region, {"low": [0, 0, 0], "high": [1, 0, 1]}, "expected low < high on every axis"),
        (Region, {"low": [0, 0], "high": [1, 1, 1]}, "low"),
        (CancelResponse, {"code": True}, "code: got bool; expected int"),
        (CancelResponse, {"code": 4}, "code: Input should be 0, 1, 2 or 3"),
        (CancelResponse, {"code": 0, "goals": GOAL_ID}, "goals: Input should be a valid tuple"),
        (CancelResponse, {"code": 0, "goals": [GOAL_ID + "\n"]}, "goals.0: String should match pattern"),
        (FindObjectGoal, {"goal_id": GOAL_ID, "object_type": "x", "capture": "never"}, "capture: Input should be"),
        (FindObjectGoal, {"goal_id": GOAL_ID, "object_type": ""}, "object_type: String should have at least 1"),
        (FindObjectGoal, {"goal_id": "me", "object_type": "x"}, "goal_id: String should match pattern"),
        (FindObjectGoal, {"goal_id": GOAL_ID, "object_type": "x", "timeout": 0}, "timeout: Input should be greater"),
        (ObjectType, {"name": "x", "shape": {}}, "shape: got no shape; expected exactly one of box, cylinder"),
        (
            ObjectType,
            {"name": "x", "shape": {"sphere": {"diameter": 1}, "surface": {}}},
            "shape: got sphere, surface; expected exactly one of",
        ),
        (ObjectType, {"name": "../x", "shape": {"sphere": {"diameter": 1}}}, "name: String should match pattern"),
        (ObjectType, {"name": "x", "shape": {"mesh": {"file": "../a.stl"}}}, "shape.mesh.file: String should match"),
    ],
)
def test_values_out_of_range_are_refused(kind: type[Message], entries: dict[str, Any], words: str) -> None:
    assert words in complaint(kind, msgpack.packb(entries))


def test_a_complaint_does_not_grow_with_the_payload() -> None:
    long = "z" * 100_000
    for payload in (msgpack.packb({long: 1}), msgpack.packb({"frame_id": long}), msgpack.packb({"stamp": {long: 1}})):
        assert len(complaint(Header, payload)) < 1000
    assert len(complaint(PointCloud2, b"\x82" + (msgpack.packb("z" * 20_000) + b"\x01") * 2)) < 1000
    assert (
        len(complaint(PointCloud2, cloud_bytes(fields=[{**FIELD, "name": f"{i:064}"} for i in [*range(63), 0]]))) < 1000
    )


@pytest.mark.parametrize("kind", KINDS)
@settings(max_examples=10)
@given(data=st.data())
def test_bytes_cut_short_are_refused_wherever_they_are_cut(kind: type[Message], data: st.DataObject) -> None:
    payload = encode(data.draw(messages(kind)))
    for end in range(len(payload)):
        complaint(kind, payload[:end])


@pytest.mark.parametrize("kind", KINDS)
@settings(max_examples=10)
@given(data=st.data())
def test_bytes_behind_a_message_are_refused(kind: type[Message], data: st.DataObject) -> None:
    payload = encode(data.draw(messages(kind)))
    complaint(kind, payload + data.draw(st.binary(min_size=1, max_size=20)))
