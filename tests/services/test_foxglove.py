"""The bridge to Foxglove, read by a client of its protocol."""

from __future__ import annotations

import contextlib
import struct
from typing import TYPE_CHECKING

import numpy as np
import pytest
from tests.services.bridged import CLOUD, FRAME, RGB, STAMP, T_CAMERA, T_FOUND, XYZ, answer, bridged
from tests.services.foxglove_client import FoxgloveClient, number, parts, text

from zsight.errors import UsageError
from zsight_core.transform import quaternion

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from zsight.bridge.foxglove_sink import FoxgloveSink
    from zsight.bus import Bus

    Send = Callable[..., None]

pytest.importorskip("foxglove", reason="needs the extra foxglove: pip install 'zsight[foxglove]'")


@pytest.fixture
def sink() -> Iterator[FoxgloveSink]:
    from zsight.bridge.foxglove_sink import FoxgloveSink

    made = FoxgloveSink("127.0.0.1", 0)
    yield made
    made.close()


@pytest.fixture
def send(join_memory: Callable[[], Bus], sink: FoxgloveSink) -> Iterator[Send]:
    with contextlib.contextmanager(bridged)(join_memory, sink) as sending:
        yield sending


def doubles(value: bytes | int, count: int) -> list[float]:
    """The first fields of a vector or a quaternion; what is zero is not sent."""
    assert isinstance(value, bytes)
    found = parts(value)
    return [number(found[field][0]) if field in found else 0.0 for field in range(1, count + 1)]


def inner(value: bytes | int) -> dict[int, list[bytes | int]]:
    assert isinstance(value, bytes)
    return parts(value)


def whole(value: bytes | int) -> int:
    """A number of 4 bytes."""
    assert isinstance(value, bytes)
    (found,) = struct.unpack("<I", value)
    return int(found)


def test_a_cloud_comes_with_its_bytes_its_stamp_and_its_frame(sink: FoxgloveSink, send: Send) -> None:
    with FoxgloveClient(sink.address) as client:
        time_ns, cloud = client.take("/kinect/points", lambda: send(CLOUD))
    channel = client.channels["/kinect/points"]
    assert (channel["encoding"], channel["schemaName"]) == ("protobuf", "foxglove.PointCloud")
    assert client.server["name"] == "zsight"
    assert time_ns == STAMP.ns
    assert inner(cloud[1][0]) == {1: [STAMP.sec], 2: [STAMP.nanosec]}
    assert text(cloud[2][0]) == FRAME
    layout = {text(f[1][0]): whole(f[2][0]) if 2 in f else 0 for f in map(inner, cloud[5])}
    assert isinstance(cloud[6][0], bytes)
    raw = np.frombuffer(cloud[6][0], np.uint8).reshape(-1, whole(cloud[4][0]))
    for axis, name in enumerate("xyz"):
        column = np.ascontiguousarray(raw[:, layout[name] : layout[name] + 4]).view(np.float32)[:, 0]
        np.testing.assert_array_equal(column, XYZ[:, axis])
    for channel_number, name in enumerate(("red", "green", "blue")):
        np.testing.assert_array_equal(raw[:, layout[name]], RGB[:, channel_number])


def test_frames_are_told_to_whoever_comes_later(sink: FoxgloveSink, send: Send) -> None:
    del send
    for _ in range(2):
        with FoxgloveClient(sink.address) as client:
            _, told = client.take("/tf")
        frame = inner(told[1][0])
        assert (text(frame[2][0]), text(frame[3][0])) == ("world", FRAME)
        np.testing.assert_allclose(doubles(frame[4][0], 3), T_CAMERA[:3, 3])
        np.testing.assert_allclose(doubles(frame[5][0], 4), quaternion(T_CAMERA), atol=1e-12)


def test_found_objects_stand_where_they_were_found_until_the_next_answer(sink: FoxgloveSink, send: Send) -> None:
    with FoxgloveClient(sink.address) as client:
        send(answer("toy_block"), answer("ball", asked="ball"))
        _, told = client.take("/found")
        while len(told.get(2, [])) < 2:
            _, told = client.take("/found")
        block, ball = (inner(entity) for entity in told[2])
        assert (text(block[2][0]), text(block[3][0]), text(ball[3][0])) == ("world", "toy_block_0", "ball_0")
        (shape,) = map(inner, block[12])
        pose = inner(shape[1][0])
        np.testing.assert_allclose(doubles(pose[1][0], 3), T_FOUND[:3, 3])
        corners = np.array([doubles(corner, 3) for corner in shape[2]])
        np.testing.assert_allclose(np.ptp(corners, axis=0), (0.035, 0.2, 0.035), atol=1e-9)
        (label,) = map(inner, block[13])
        assert text(label[6][0]) == "toy_block 97%"
        assert inner(told[1][0])[2] == [1]  # whatever was there before goes
        send(answer(asked="toy_block"))
        while len(told.get(2, [])) > 1:
            _, told = client.take("/found")
        assert [text(inner(entity)[3][0]) for entity in told[2]] == ["ball_0"]


def test_a_port_that_is_taken_is_an_error(sink: FoxgloveSink) -> None:
    from zsight.bridge.foxglove_sink import FoxgloveSink

    port = int(sink.address.rpartition(":")[2])
    with pytest.raises(UsageError, match=f"127.0.0.1:{port}"):
        FoxgloveSink("127.0.0.1", port)
