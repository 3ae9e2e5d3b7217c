"""What is remembered of a message's head changes neither the bytes that are written nor what is read from any bytes."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.protocol.legal_messages import clouds, messages

from zsight_protocol import codec
from zsight_protocol.codec import decode, encode
from zsight_protocol.errors import DecodeError
from zsight_protocol.known_head import KnownHead
from zsight_protocol.message import Header, Time
from zsight_protocol.point_cloud import Datatype, PointCloud2, PointField
from zsight_protocol.recent import MOST

if TYPE_CHECKING:
    from zsight_protocol.message import Message

USUAL = Time(sec=1_700_000_000, nanosec=123_456_789)


def with_stamp(cloud: PointCloud2, stamp: Time) -> PointCloud2:
    return cloud.model_copy(update={"header": Header(stamp=stamp, frame_id=cloud.header.frame_id)})


def written_anew(cloud: PointCloud2) -> bytes:
    codec._written.clear()
    return encode(cloud)


def outcome(payload: bytes) -> Message | str:
    try:
        return decode(PointCloud2, payload)
    except DecodeError as error:
        return str(error)


def read_anew(payload: bytes) -> Message | str:
    codec._read.clear()
    return outcome(payload)


@given(cloud=clouds(), stamp=messages(Time))
def test_a_known_head_is_spelled_as_from_scratch(cloud: PointCloud2, stamp: Time) -> None:
    expected = written_anew(with_stamp(cloud, stamp))
    written_anew(with_stamp(cloud, USUAL))
    assert encode(with_stamp(cloud, stamp)) == expected


@given(cloud=clouds(), other=clouds())
def test_another_cloud_is_not_taken_for_the_known_one(cloud: PointCloud2, other: PointCloud2) -> None:
    expected = written_anew(with_stamp(other, USUAL))
    written_anew(with_stamp(cloud, USUAL))
    assert encode(with_stamp(other, USUAL)) == expected


@given(cloud=clouds(), stamp=messages(Time))
def test_a_known_head_says_what_it_says_from_scratch(cloud: PointCloud2, stamp: Time) -> None:
    payload = encode(with_stamp(cloud, stamp))
    expected = read_anew(payload)
    read_anew(encode(with_stamp(cloud, USUAL)))
    assert outcome(payload) == expected


@given(cloud=clouds(), place=st.integers(min_value=0), value=st.integers(0, 255))
def test_any_byte_changed_is_read_as_from_scratch(cloud: PointCloud2, place: int, value: int) -> None:
    payload = encode(with_stamp(cloud, USUAL))
    head = len(payload) - len(cloud.data)
    changed = bytearray(payload)
    changed[place % head] = value
    expected = read_anew(bytes(changed))
    read_anew(payload)
    assert outcome(bytes(changed)) == expected


@pytest.mark.parametrize(
    "stamp", [Time(), Time(sec=-1), Time(sec=65535, nanosec=65536), Time(sec=65536, nanosec=65535), USUAL]
)
def test_only_a_stamp_in_numbers_of_four_bytes_is_spelled(stamp: Time) -> None:
    cloud = _cloud_of(1)
    head = written_anew(cloud)[:-4]
    known = KnownHead.of(head, cloud)
    assert known is not None
    assert (known.spelled(with_stamp(cloud, stamp)) is not None) == (stamp == USUAL)
    shortest = written_anew(with_stamp(cloud, stamp))[:-4]
    assert (KnownHead.of(shortest, with_stamp(cloud, stamp)) is not None) == (stamp == USUAL)


def test_what_is_remembered_is_bounded_and_holds_no_points() -> None:
    cloud = decode(PointCloud2, encode(_cloud_of(1)))
    for points in range(2, 200):
        decode(PointCloud2, encode(_cloud_of(points)))
    for heads in (codec._written, codec._read):
        assert 0 < len(heads) <= MOST
        assert all(len(head._message.data) == 0 for head in heads.values())  # type: ignore[attr-defined]
    assert len(cloud.data) == 4


def _cloud_of(points: int) -> PointCloud2:
    return PointCloud2(
        header=Header(stamp=USUAL),
        height=1,
        width=points,
        fields=(PointField(name="x", offset=0, datatype=Datatype.FLOAT32),),
        is_bigendian=False,
        point_step=4,
        row_step=4 * points,
        is_dense=True,
        data=bytes(4 * points),
    )
