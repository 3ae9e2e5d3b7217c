"""Every legal message comes back from its bytes as it was, and any msgpack library reads them."""

from __future__ import annotations

from enum import Enum
from typing import Any

import msgpack
import msgpack.fallback
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.protocol.legal_messages import all_kinds, clouds, messages

from zsight_protocol.codec import ALIGNMENT, decode, encode, encode_parts
from zsight_protocol.errors import EncodeError
from zsight_protocol.find_object import FindObjectResult, ResultCode, Status
from zsight_protocol.message import Header, Message
from zsight_protocol.point_cloud import Datatype, PointCloud2, PointField

KINDS = [pytest.param(kind, id=kind.__name__) for kind in all_kinds()]


def plain(value: Any) -> Any:
    """What a library that has never heard of our models sees."""
    if isinstance(value, dict):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, bytearray | memoryview):
        return bytes(value)
    return value.value if isinstance(value, Enum) else value


@pytest.mark.parametrize("kind", KINDS)
@given(data=st.data())
def test_a_message_comes_back_as_it_was(kind: type[Message], data: st.DataObject) -> None:
    message = data.draw(messages(kind))
    assert decode(kind, encode(message)) == message
    packed_elsewhere = msgpack.packb(plain(message.model_dump()))
    assert decode(kind, packed_elsewhere) == message


@pytest.mark.parametrize("kind", KINDS)
@given(data=st.data())
def test_any_msgpack_library_reads_it(kind: type[Message], data: st.DataObject) -> None:
    message = data.draw(messages(kind))
    expected = plain(message.model_dump())
    payload = encode(message)
    fallback = msgpack.fallback.Unpacker()
    fallback.feed(payload)
    for entries in (msgpack.unpackb(payload), fallback.unpack()):
        entries.pop("_", None)
        assert entries == expected


@given(cloud=clouds())
def test_data_stands_last_and_aligned(cloud: PointCloud2) -> None:
    payload = encode(cloud)
    assert list(msgpack.unpackb(payload))[-1] == "data"
    assert payload.endswith(bytes(cloud.data))
    assert (len(payload) - len(cloud.data)) % ALIGNMENT == 0


@given(cloud=clouds())
def test_the_parts_are_the_whole_and_the_blob_is_not_copied(cloud: PointCloud2) -> None:
    head, blob = encode_parts(cloud)
    assert head + bytes(blob) == encode(cloud)
    assert blob is cloud.data


@given(cloud=clouds())
def test_decoded_data_is_a_view_of_the_payload(cloud: PointCloud2) -> None:
    payload = np.frombuffer(encode(cloud), np.uint8)
    data = np.frombuffer(decode(PointCloud2, payload.data).data, np.uint8)
    assert np.shares_memory(data, payload)


def test_bits_of_nan_are_kept() -> None:
    bits = np.array([0x7FC00000, 0x7FC00001, 0x7F800001, 0xFFC12345, 0xFFFFFFFF], np.uint32)
    assert np.isnan(bits.view(np.float32)).all()
    cloud = PointCloud2(
        header=Header(),
        height=1,
        width=len(bits),
        fields=(PointField(name="x", offset=0, datatype=Datatype.FLOAT32),),
        is_bigendian=False,
        point_step=4,
        row_step=4 * len(bits),
        is_dense=False,
        data=bits.tobytes(),
    )
    back = np.frombuffer(decode(PointCloud2, encode(cloud)).data, np.uint32)
    np.testing.assert_array_equal(back, bits)


def test_an_image_shaped_buffer_is_taken_flat() -> None:
    rows = np.arange(64, dtype=np.uint8).reshape(4, 16)
    cloud = PointCloud2(
        header=Header(),
        height=4,
        width=1,
        fields=(PointField(name="x", offset=0, datatype=Datatype.FLOAT32),),
        is_bigendian=False,
        point_step=16,
        row_step=16,
        is_dense=True,
        data=rows.data,
    )
    assert bytes(decode(PointCloud2, encode(cloud)).data) == rows.tobytes()


def test_a_number_of_more_than_64_bits_is_refused_by_the_sender() -> None:
    result = FindObjectResult(header=Header(), code=ResultCode.FOUND, status=Status.FOUND, report={"points": 2**64})
    with pytest.raises(EncodeError, match="FindObjectResult holds a whole number of more than 64 bits"):
        encode(result)
