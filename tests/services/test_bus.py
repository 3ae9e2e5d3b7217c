"""What every link owes the bus: the same tests in memory and over Zenoh."""

from __future__ import annotations

import logging
import threading
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import TYPE_CHECKING

import pytest
from tests.services.waiting import DEADLINE, Arrivals, known, soon

from zsight.bus.attachment import Attachment
from zsight.errors import ConnectionLost, RequestRefused, UsageError
from zsight_protocol.camera_info import CameraInfo
from zsight_protocol.channels import Delivery
from zsight_protocol.codec import encode
from zsight_protocol.errors import KeyNameError
from zsight_protocol.geometry import Plane, Pose, Transform, TransformList, TransformStamped, Vector3
from zsight_protocol.message import Header, Time

if TYPE_CHECKING:
    from collections.abc import Callable

    from zsight.bus import Bus, RawRequest, Reader

    Join = Callable[[], Bus]


def plane(number: int) -> Plane:
    """A message of a 'latest' channel that tells its number."""
    return Plane(
        header=Header(stamp=Time(nanosec=number)),
        normal=Vector3(z=1.0),
        distance=-float(number),
        pose=Pose(),
        inliers=number,
        tolerance=0.01,
        rms=0.0,
    )


def transforms(*children: str) -> TransformList:
    return TransformList(
        transforms=tuple(
            TransformStamped(header=Header(frame_id="world"), child_frame_id=child, transform=Transform())
            for child in children
        )
    )


def children_of(message: TransformList) -> list[str]:
    return [entry.child_frame_id for entry in message.transforms]


def camera_info(width: int) -> CameraInfo:
    return CameraInfo(header=Header(), height=1, width=width, k=(0.0,) * 9, r=(0.0,) * 9, p=(0.0,) * 12)


def taken(reader: Reader[Plane]) -> int:
    """Number of the next plane."""
    received = reader.take(DEADLINE)
    assert received is not None
    return received.message.inliers


# Latest.


def test_latest_gives_the_newest_and_counts_what_it_superseded(join: Join) -> None:
    sender, receiver = join(), join()
    reader = receiver.reader(receiver.cell.plane("kinect"), Plane)
    writer = sender.writer(sender.cell.plane("kinect"), Plane)
    assert soon(writer.has_readers)
    for number in range(1, 11):
        writer.send(plane(number))
    assert soon(lambda: reader.counter.superseded == 9)
    assert taken(reader) == 10
    assert reader.take(0) is None
    counter = reader.counter
    assert (counter.received, counter.superseded, counter.lost, counter.refused) == (1, 9, 0, 0)


def test_latest_keeps_the_newest_of_every_key(join: Join) -> None:
    sender, receiver = join(), join()
    reader = receiver.reader(f"{receiver.cell.namespace}/*/plane", Plane, delivery=Delivery.LATEST)
    writers = [sender.writer(sender.cell.plane(camera), Plane) for camera in ("left", "right")]
    assert all(soon(writer.has_readers) for writer in writers)
    for number in range(6):
        writers[number % 2].send(plane(number))
    assert soon(lambda: reader.counter.superseded == 4)
    got = {received.key: received.message.inliers for _ in range(2) if (received := reader.take(DEADLINE))}
    assert got == {sender.cell.plane("left"): 4, sender.cell.plane("right"): 5}


def test_a_message_comes_with_its_key_its_number_and_its_time(join: Join) -> None:
    sender, receiver = join(), join()
    reader = receiver.reader(receiver.cell.plane("kinect"), Plane)
    writer = sender.writer(sender.cell.plane("kinect"), Plane)
    assert soon(writer.has_readers)
    before = Time.now().ns
    writer.send(plane(1))
    received = reader.take(DEADLINE)
    assert received is not None
    assert received.message == plane(1)
    assert received.key == sender.cell.plane("kinect")
    assert received.attachment is not None
    assert received.attachment.sequence == 1
    assert before <= received.attachment.sent_ns <= received.received_ns <= Time.now().ns


# Every.


def test_every_message_comes_in_order(join: Join) -> None:
    sender, receiver = join(), join()
    reader = receiver.reader(receiver.cell.tf, TransformList)
    writer = sender.writer(sender.cell.tf, TransformList)
    assert soon(writer.has_readers)
    names = [f"frame{number}" for number in range(200)]
    for name in names:
        writer.send(transforms(name))
    got = [children_of(received.message)[0] for _ in names if (received := reader.take(DEADLINE))]
    assert got == names
    assert (reader.counter.lost, reader.counter.superseded) == (0, 0)


def test_every_counts_what_no_longer_fits_its_queue(join: Join) -> None:
    sender, receiver = join(), join()
    reader = receiver.reader(receiver.cell.tf, TransformList)
    writer = sender.writer(sender.cell.tf, TransformList)
    assert soon(writer.has_readers)
    for number in range(300):
        writer.send(transforms(f"frame{number}"))
    assert soon(lambda: reader.counter.lost == 300 - 256)
    first = reader.take(DEADLINE)
    assert first is not None
    assert children_of(first.message) == ["frame44"]


def test_a_gap_is_counted_as_lost(join: Join) -> None:
    sender, receiver = join(), join()
    reader = receiver.reader(receiver.cell.tf, TransformList)
    raw = sender.link.writer(sender.cell.tf, Delivery.EVERY)
    assert soon(raw.has_readers)
    for sequence in (7, 8, 11, 12):
        raw.put(encode(transforms(f"frame{sequence}")), b"", Attachment(1, sequence, Time.now().ns).pack())
    got = [children_of(received.message)[0] for _ in range(4) if (received := reader.take(DEADLINE))]
    assert got == ["frame7", "frame8", "frame11", "frame12"]
    assert reader.counter.lost == 2  # what was sent before the reader came is no loss


def test_a_writer_without_attachment_is_read_and_not_counted(join: Join) -> None:
    sender, receiver = join(), join()
    reader = receiver.reader(receiver.cell.plane("kinect"), Plane)
    raw = sender.link.writer(sender.cell.plane("kinect"), Delivery.LATEST)
    assert soon(raw.has_readers)
    raw.put(encode(plane(3)), b"", b"")
    received = reader.take(DEADLINE)
    assert received is not None
    assert received.attachment is None
    assert received.message == plane(3)
    assert reader.counter.lost == 0


# Latched.


def test_a_late_reader_gets_the_last_value(join: Join) -> None:
    sender, early, receiver = join(), join(), join()
    writer = sender.writer(sender.cell.tf_static, TransformList)
    present = early.reader(early.cell.tf_static, TransformList)
    writer.send(transforms("old"))
    writer.send(transforms("new"))
    # Late is who comes when both are through: one on its way may reach who comes meanwhile, and then the other.
    while (seen := present.take(DEADLINE)) is not None and children_of(seen.message) != ["new"]:
        pass
    assert seen is not None
    reader = receiver.reader(receiver.cell.tf_static, TransformList)
    received = reader.take(DEADLINE)
    assert received is not None
    assert children_of(received.message) == ["new"]
    assert reader.take(0.05) is None


def test_a_waiting_reader_gets_the_value_of_a_late_writer(join: Join) -> None:
    sender, receiver = join(), join()
    reader = receiver.reader(receiver.cell.tf_static, TransformList)
    sender.writer(sender.cell.tf_static, TransformList).send(transforms("camera"))
    received = reader.take(DEADLINE)
    assert received is not None
    assert children_of(received.message) == ["camera"]


@pytest.mark.parametrize("reader_first", [True, False])
def test_values_of_several_writers_stand_side_by_side(join: Join, reader_first: bool) -> None:
    left, right, receiver = join(), join(), join()
    reader = receiver.reader(receiver.cell.tf_static, TransformList) if reader_first else None
    for bus, name in ((left, "left"), (right, "right")):
        writer = bus.writer(bus.cell.tf_static, TransformList)
        assert reader is None or soon(writer.has_readers)
        writer.send(transforms(name))
    reader = reader or receiver.reader(receiver.cell.tf_static, TransformList)
    got = {children_of(received.message)[0] for _ in range(2) if (received := reader.take(DEADLINE))}
    assert got == {"left", "right"}


def test_a_late_reader_of_many_keys_gets_the_last_value_of_each(join: Join) -> None:
    sender, receiver = join(), join()
    for width, camera in enumerate(("left", "right"), start=1):
        sender.writer(sender.cell.camera_info(camera), CameraInfo).send(camera_info(width))
    reader = receiver.reader(f"{receiver.cell.namespace}/*/camera_info", CameraInfo, delivery=Delivery.LATCHED)
    got = {received.key: received.message.width for _ in range(2) if (received := reader.take(DEADLINE))}
    assert got == {sender.cell.camera_info("left"): 1, sender.cell.camera_info("right"): 2}


def test_what_a_writer_latched_goes_with_it(join: Join) -> None:
    sender, receiver = join(), join()
    sender.writer(sender.cell.tf_static, TransformList).send(transforms("camera"))
    sender.close()
    reader = receiver.reader(receiver.cell.tf_static, TransformList)
    assert reader.take(0.2) is None


# Bad bytes.


def test_who_waits_for_a_reader_to_catch_up_waits_for_its_taker(join: Join) -> None:
    sender, receiver = join(), join()
    reader = receiver.reader(receiver.cell.tf, TransformList)
    assert reader.caught_up(0)
    writer = sender.writer(sender.cell.tf, TransformList)
    assert soon(writer.has_readers)
    writer.send(transforms("a"))
    writer.send(transforms("b"))
    assert reader.take(DEADLINE) is not None
    assert not reader.caught_up(0)  # one is in hand, the other waits or is on its way
    assert reader.take(DEADLINE) is not None
    assert not reader.caught_up(0)
    with ThreadPoolExecutor() as pool:
        waiting = pool.submit(reader.caught_up, DEADLINE)
        assert reader.take(0) is None
        assert waiting.result()


@pytest.mark.parametrize("bad", [b"", b"\xc1", b"\xff" * 9, encode(plane(1))])
def test_bad_bytes_are_refused_and_the_loop_goes_on(join: Join, bad: bytes, caplog: pytest.LogCaptureFixture) -> None:
    sender, receiver = join(), join()
    reader = receiver.reader(receiver.cell.tf, TransformList)
    raw = sender.link.writer(sender.cell.tf, Delivery.EVERY)
    assert soon(raw.has_readers)
    raw.put(bad, b"", b"")
    raw.put(encode(transforms("good")), b"", b"")
    with caplog.at_level(logging.WARNING):
        assert children_of(next(iter(reader))) == ["good"]
    assert (reader.counter.received, reader.counter.refused) == (1, 1)
    assert f"refused a message on {sender.cell.tf}: not a TransformList" in caplog.text


# Who reads.


def test_a_writer_knows_whether_it_is_read(join: Join) -> None:
    sender, receiver = join(), join()
    writer = sender.writer(sender.cell.plane("kinect"), Plane)
    assert not writer.has_readers()
    reader = receiver.reader(receiver.cell.plane("kinect"), Plane)
    assert soon(writer.has_readers)
    reader.close()
    assert soon(lambda: not writer.has_readers())


def test_wildcards_need_a_delivery_only_where_the_table_has_none(join: Join) -> None:
    with pytest.raises(KeyNameError):
        join().reader("elsewhere/kinect/points", Plane)


# Stopping.


def test_stop_wakes_a_waiting_reader(join: Join) -> None:
    bus = join()
    reader = bus.reader(bus.cell.plane("kinect"), Plane)
    waiting = threading.Event()
    got: list[Plane] = []

    def loop() -> None:
        waiting.set()
        got.extend(reader)

    thread = threading.Thread(target=loop)
    thread.start()
    assert waiting.wait(DEADLINE)
    bus.stop()
    thread.join(DEADLINE)
    assert not thread.is_alive()
    assert got == []


def test_stop_ends_a_loop_that_always_has_another_message(join: Join) -> None:
    """A service that is slower than its camera finds the next cloud waiting each time."""
    sender, receiver = join(), join()
    reader = receiver.reader(receiver.cell.plane("kinect"), Plane)
    writer = sender.writer(sender.cell.plane("kinect"), Plane)
    assert soon(writer.has_readers)
    writer.send(plane(0))
    rounds = 0
    for _ in reader:
        rounds += 1
        writer.send(plane(rounds))
        assert soon(lambda: bool(reader._pending))
        if rounds == 5:
            receiver.stop()
        assert rounds < 20, "the loop goes on after stop"
    assert rounds == 5


def test_a_reader_made_after_stop_ends_at_once(join: Join) -> None:
    bus = join()
    bus.stop()
    assert list(bus.reader(bus.cell.plane("kinect"), Plane)) == []


def test_a_closed_reader_ends_its_loop(join: Join) -> None:
    bus = join()
    reader = bus.reader(bus.cell.plane("kinect"), Plane)
    reader.close()
    assert list(reader) == []


def test_sending_after_the_end_says_so(join: Join) -> None:
    bus = join()
    writer = bus.writer(bus.cell.plane("kinect"), Plane)
    bus.close()
    with pytest.raises(ConnectionLost, match=r"cannot send on .+/kinect/plane"):
        writer.send(plane(1))


def acts_of(bus: Bus) -> list[Callable[[str], object]]:
    """All that is done on a key."""
    return [
        partial(bus.link.writer, delivery=Delivery.LATEST),
        partial(bus.link.reader, delivery=Delivery.LATEST, arrival=lambda _: None),
        partial(bus.serve, handler=lambda request: request.close()),
        partial(bus.ask, payload=b"", timeout=DEADLINE),
        bus.link.declare_alive,
    ]


@pytest.mark.parametrize("key", ["", "//", "/a", "a/", "a//b", "a#b", "a?b", "a/b*", "***"])
def test_what_is_no_key_is_told(join: Join, key: str) -> None:
    for act in acts_of(join()):
        with pytest.raises(UsageError) as told:
            act(key)
        assert str(told.value).startswith(f"key is {key!r}; expected names with one / between")


def test_who_has_left_is_told_so(join: Join) -> None:
    bus = join()
    bus.close()
    for act in acts_of(bus):
        with pytest.raises(ConnectionLost, match=r"cannot \w+( on)? a/b: the session was closed"):
            act("a/b")


# Requests.


def test_a_request_gets_its_replies_and_then_an_end(join: Join) -> None:
    server, client = join(), join()

    def answer(request: RawRequest) -> None:
        for number in range(3):
            request.reply(request.payload + bytes([number]))
        request.close()

    server.serve(server.cell.find_object("finder"), answer)
    known(server, client)
    replies = client.ask(client.cell.find_object("finder"), b"which", DEADLINE)
    assert [replies.take(DEADLINE) for _ in range(4)] == [b"which\0", b"which\1", b"which\2", None]


def answer_once(request: RawRequest, payload: bytes) -> None:
    request.reply(payload)
    request.close()


def test_nobody_answers(join: Join) -> None:
    client = join()
    assert client.ask(client.cell.find_object("finder"), b"", DEADLINE).take(DEADLINE) is None


def test_a_server_that_closes_a_request_ends_it_without_an_answer(join: Join) -> None:
    server, client = join(), join()
    server.serve(server.cell.find_object("finder"), lambda request: request.close())
    known(server, client)
    assert client.ask(client.cell.find_object("finder"), b"", DEADLINE).take(DEADLINE) is None


def test_a_server_says_why_it_refuses(join: Join) -> None:
    server, client = join(), join()
    server.serve(server.cell.find_object("finder"), lambda request: request.refuse("no such thing"))
    known(server, client)
    with pytest.raises(RequestRefused, match="no such thing"):
        client.ask(client.cell.find_object("finder"), b"", DEADLINE).take(DEADLINE)


def test_a_server_that_leaves_ends_what_it_was_asked(join: Join) -> None:
    server, client = join(), join()
    asked: Arrivals[RawRequest] = Arrivals()
    server.serve(server.cell.find_object("finder"), asked.add)
    known(server, client)
    replies = client.ask(client.cell.find_object("finder"), b"", DEADLINE)
    asked.wait(1)[0].reply(b"working")
    assert replies.take(DEADLINE) == b"working"
    server.close()
    assert replies.take(DEADLINE) is None


def test_a_slow_server_is_waited_for_as_long_as_said(join: Join) -> None:
    server, client = join(), join()
    asked: Arrivals[RawRequest] = Arrivals()
    server.serve(server.cell.find_object("finder"), asked.add)
    known(server, client)
    replies = client.ask(client.cell.find_object("finder"), b"", DEADLINE)
    with pytest.raises(TimeoutError):
        replies.take(0.05)
    replies.close()
    for request in asked.wait(1):
        request.close()


@pytest.mark.parametrize("everyone", [True, False])
def test_one_server_answers_or_everyone_does(join: Join, everyone: bool) -> None:
    client = join()
    for name in ("a", "b"):
        server = join()
        server.serve(server.cell.health("host", name), partial(answer_once, payload=name.encode()))
        known(server, client)
    key = client.cell.health("host", "*" if everyone else "b")
    replies = client.ask(key, b"", DEADLINE, everyone=everyone)
    got = []
    while (reply := replies.take(DEADLINE)) is not None:
        got.append(reply)
    assert sorted(got) == ([b"a", b"b"] if everyone else [b"b"])


def test_a_withdrawn_server_is_not_asked(join: Join) -> None:
    server, client = join(), join()
    key = server.cell.find_object("finder")
    served = server.serve(key, lambda request: request.close())
    known(server, client)
    served.close()
    assert client.ask(key, b"", DEADLINE).take(DEADLINE) is None


# Liveliness.


def test_liveliness_is_seen_to_come_and_go(join: Join) -> None:
    here, there, watcher = join(), join(), join()
    seen: Arrivals[tuple[str, bool]] = Arrivals()
    early = here.link.declare_alive(here.cell.alive("host", "early"))
    assert soon(lambda: watcher.link.alive(watcher.cell.alive("*", "*"), 1.0) == {here.cell.alive("host", "early")})
    watch = watcher.link.watch_alive(watcher.cell.alive("host", "*"), lambda key, alive: seen.add((key, alive)))
    assert seen.wait(1) == [(here.cell.alive("host", "early"), True)]
    _late = there.link.declare_alive(there.cell.alive("host", "late"))
    assert seen.wait(2)[1] == (there.cell.alive("host", "late"), True)
    early.close()
    assert seen.wait(3)[2] == (here.cell.alive("host", "early"), False)
    there.close()
    assert seen.wait(4)[3] == (here.cell.alive("host", "late"), False)
    watch.close()
    assert watcher.link.alive(watcher.cell.alive("*", "*"), 1.0) == set()


def test_other_cells_and_hosts_are_not_seen(join: Join) -> None:
    bus = join()
    token = bus.link.declare_alive(bus.cell.alive("host", "voxel"))
    assert bus.link.alive(bus.cell.alive("elsewhere", "*"), 1.0) == set()
    assert bus.link.alive("**", 1.0) == set()
    token.close()
