"""What only the link over Zenoh has: shared memory, endpoints and their errors."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
import zenoh
from tests.services.waiting import DEADLINE, Arrivals, soon
from zenoh import shm

from zsight import shared_memory
from zsight.bus.zenoh_link import open_link, open_router
from zsight.convert import cloud_from_points, points_of
from zsight.errors import ConnectionLost, UsageError
from zsight.network import Network
from zsight_core.points import from_xyz
from zsight_protocol.channels import Delivery
from zsight_protocol.message import Time
from zsight_protocol.point_cloud import PointCloud2

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from zsight.bus import Bus, RawRequest, RawSample

    Join = Callable[[], Bus]

SIZE = 4 * 1024 * 1024


def is_shared(sample: RawSample) -> bool:
    return sample._sample.payload.as_shm() is not None  # type: ignore[attr-defined]  # Zenoh's own word


def payload(number: int, size: int = SIZE) -> bytes:
    return bytes([number]) * size


def test_a_cloud_comes_bit_for_bit(join_zenoh: Join) -> None:
    rng = np.random.default_rng(5)
    xyz = rng.normal(size=(480, 640, 3)).astype(np.float32)
    xyz[rng.random((480, 640)) < 0.1] = np.nan
    points = from_xyz(xyz, rng.integers(0, 256, (480, 640, 3)))
    sender, receiver = join_zenoh(), join_zenoh()
    reader = receiver.reader(receiver.cell.points("kinect"), PointCloud2)
    writer = sender.writer(sender.cell.points("kinect"), PointCloud2)
    assert soon(writer.has_readers)
    writer.send(cloud_from_points(points, Time(sec=3, nanosec=4), "kinect_optical_frame"))
    received = reader.take(DEADLINE)
    assert received is not None
    assert received.message.header.stamp == Time(sec=3, nanosec=4)
    assert not received.message.is_dense
    assert points_of(received.message).tobytes() == points.tobytes()


def test_big_payloads_of_which_the_newest_matters_travel_in_shared_memory(join_zenoh: Join) -> None:
    sender, receiver = join_zenoh(), join_zenoh()
    samples: Arrivals[RawSample] = Arrivals()
    _reader = receiver.link.reader("test/big", Delivery.LATEST, samples.add)
    writer = sender.link.writer("test/big", Delivery.LATEST)
    assert soon(writer.has_readers)
    writer.put(b"head", payload(7), b"")
    writer.put(b"head", memoryview(payload(8)), b"")
    writer.put(b"small", b"", b"")
    big, view, small = samples.wait(3)
    assert [is_shared(sample) for sample in (big, view, small)] == [True, True, False]
    assert big.take() == b"head" + payload(7)
    assert view.take() == b"head" + payload(8)
    assert small.take() == b"small"


def test_what_must_not_be_lost_stays_out_of_shared_memory(join_zenoh: Join) -> None:
    sender, receiver = join_zenoh(), join_zenoh()
    samples: Arrivals[RawSample] = Arrivals()
    _reader = receiver.link.reader("test/every", Delivery.EVERY, samples.add)
    writer = sender.link.writer("test/every", Delivery.EVERY)
    assert soon(writer.has_readers)
    count = 24
    for number in range(count):
        writer.put(b"head", payload(number), b"")
    held = samples.wait(count)
    assert not any(is_shared(sample) for sample in held)
    assert [sample.take() for sample in held] == [b"head" + payload(number) for number in range(count)]


def test_requests_never_ride_on_shared_memory(join_zenoh: Join) -> None:
    server, client = join_zenoh(), join_zenoh()
    ridden: Arrivals[bool] = Arrivals()

    def answer(request: RawRequest) -> None:
        ridden.add(request._query.payload.as_shm() is not None)  # type: ignore[attr-defined]  # Zenoh's own word
        request.reply(request.payload)
        request.close()

    server.serve("test/asked", answer)
    assert soon(lambda: client.ask("test/asked", payload(5, 1 << 19), DEADLINE).take(DEADLINE) == payload(5, 1 << 19))
    assert not any(ridden.all)


def test_a_reader_that_keeps_its_clouds_takes_none_from_others(join_zenoh: Join) -> None:
    sender, keeper, other = join_zenoh(), join_zenoh(), join_zenoh()
    kept: Arrivals[RawSample] = Arrivals()
    taken: Arrivals[bytes | None] = Arrivals()
    _readers = [
        keeper.link.reader("test/kept", Delivery.LATEST, kept.add),
        other.link.reader("test/kept", Delivery.LATEST, lambda sample: taken.add(sample.take())),
    ]
    writer = sender.link.writer("test/kept", Delivery.LATEST)
    assert soon(writer.has_readers)
    count = 24  # three times what the ring has room for
    for number in range(count):
        writer.put(b"", payload(number), b"")
        kept.wait(number + 1)
        taken.wait(number + 1)
    assert taken.all == [payload(number) for number in range(count)]
    assert all(is_shared(sample) for sample in kept.all)
    late = [sample.take() for sample in kept.all]
    # What was written over meanwhile is told to be lost; what is still there is whole.
    assert late[: count - 8] == [None] * (count - 8)
    assert all(cloud in (None, payload(number)) for number, cloud in enumerate(late))


def test_a_ring_grows_with_its_clouds(join_zenoh: Join) -> None:
    sender, receiver = join_zenoh(), join_zenoh()
    taken: Arrivals[bytes | None] = Arrivals()
    _reader = receiver.link.reader("test/grown", Delivery.LATEST, lambda sample: taken.add(sample.take()))
    writer = sender.link.writer("test/grown", Delivery.LATEST)
    assert soon(writer.has_readers)
    sizes = [1 << 17, 1 << 20, 1 << 22, 1 << 17]
    for number, size in enumerate(sizes):
        writer.put(b"", payload(number, size), b"")
        taken.wait(number + 1)
    assert taken.all == [payload(number, size) for number, size in enumerate(sizes)]


def test_a_host_with_little_shared_memory_makes_few_buffers_and_sends_what_is_too_big_through_the_socket(
    join_zenoh: Join, monkeypatch: pytest.MonkeyPatch
) -> None:
    sender, receiver = join_zenoh(), join_zenoh()
    samples: Arrivals[RawSample] = Arrivals()
    _reader = receiver.link.reader("test/little", Delivery.LATEST, samples.add)
    writer = sender.link.writer("test/little", Delivery.LATEST)
    assert soon(writer.has_readers)

    def received(data: bytes) -> RawSample:
        """A sample of data, sent again as long as a busy network drops it."""
        before = len(samples.all)
        for _ in range(10):
            writer.put(b"", data, b"")
            if soon(lambda: len(samples.all) > before, 1.0):
                break
        return samples.wait(before + 1)[-1]

    monkeypatch.setattr(shared_memory, "free_bytes", lambda: 4 * SIZE)  # half of that is not enough for three
    assert not is_shared(received(payload(0)))
    monkeypatch.setattr(shared_memory, "free_bytes", lambda: 8 * SIZE)
    small = [received(payload(number)) for number in (1, 2, 3)]
    assert all(is_shared(sample) for sample in small)
    monkeypatch.setattr(shared_memory, "free_bytes", lambda: 0)
    big = received(payload(4, 2 * SIZE))
    assert not is_shared(big)
    assert big.take() == payload(4, 2 * SIZE)
    # What went through the socket has taken no buffer from those that still hold one.
    assert [sample.take() for sample in small] == [payload(number) for number in (1, 2, 3)]


def test_a_host_without_shared_memory_sends_through_the_socket(
    join_zenoh: Join, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(size: int) -> None:
        raise zenoh.ZError(f"no room for {size} bytes")

    monkeypatch.setattr(shm.ShmProvider, "default_backend", refuse)
    sender, receiver = join_zenoh(), join_zenoh()
    reader = receiver.reader(receiver.cell.points("kinect"), PointCloud2)
    writer = sender.writer(sender.cell.points("kinect"), PointCloud2)
    assert soon(writer.has_readers)
    points = from_xyz(np.full((400, 640, 3), 1.5))
    received = None
    for _ in range(10):  # a busy network may drop one
        writer.send(cloud_from_points(points, Time(), "camera"))
        received = reader.take(1.0)
        if received is not None:
            break
    assert received is not None
    assert points_of(received.message).tobytes() == points.tobytes()


def test_no_router_is_said_with_its_endpoint(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("ZENOH_CONFIG", raising=False)
    with pytest.raises(ConnectionLost, match=r"tcp/127.0.0.1:9: refused: .* start a router with: zsight up"):
        open_link(Network().on("tcp/127.0.0.1:9"))


def test_a_taken_port_is_said(zenoh_network: Network) -> None:
    with pytest.raises(ConnectionLost, match=f"cannot listen on {zenoh_network.listen[0]}"):
        open_router(zenoh_network)


@pytest.mark.parametrize("endpoint", ["127.0.0.1:7447", "nonsense", ""])
def test_an_endpoint_that_is_none_is_said(endpoint: str) -> None:
    with pytest.raises((UsageError, ConnectionLost)) as caught:
        open_link(Network().on(endpoint))
    assert caught.value.exit_code in (2, 3)


def test_a_configuration_file_that_is_none_is_said(tmp_path: Path) -> None:
    (tmp_path / "bad.json5").write_text("{mode: 5}")
    network = Network(config_file=str(tmp_path / "bad.json5"))
    with pytest.raises(UsageError, match="network settings are not understood"):
        open_link(network)
