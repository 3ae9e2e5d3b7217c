"""The recorder: everything that comes is in the file, in order; what could not be written is counted."""

from __future__ import annotations

import errno
import os
import threading
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from tests.services.recordings import START, cloud, sample, transform
from tests.services.running import running
from tests.services.waiting import known, soon

from zsight.bus.attachment import Attachment
from zsight.errors import NobodyAnswers, RequestRefused
from zsight.recording import disk_writer, recorder
from zsight.recording.disk_writer import DiskPolicy, DiskWriter, OnFull
from zsight.recording.file_series import Split
from zsight.recording.mcap_file import McapFile
from zsight.recording.mcap_writer import McapWriter
from zsight.recording.recording_file import IN_FORCE, LOSSES
from zsight.recording_client import RecorderClient
from zsight_protocol.action import GoalState, Update, new_goal_id
from zsight_protocol.channels import Delivery
from zsight_protocol.codec import encode
from zsight_protocol.find_object import FindObjectGoal, FindObjectResult, ResultCode, Status
from zsight_protocol.geometry import TransformList
from zsight_protocol.message import Header, Message
from zsight_protocol.point_cloud import PointCloud2
from zsight_protocol.recording import Recording
from zsight_protocol.ros_message import from_cdr

if TYPE_CHECKING:
    from collections.abc import Callable

    from zsight.bus import Bus

    Join = Callable[[], Bus]


def keys_in(path: Path) -> list[str]:
    """The key of every message, in the order of the file, without those that were in force before."""
    with McapFile.open(path) as file:
        assert file.damage == ""
        return [e.channel.metadata["key"] for e in file.messages() if IN_FORCE not in e.channel.metadata]


def settings(folder: Path, **values: Any) -> recorder.Settings:
    return recorder.Settings(folder=str(folder), reserve=0.25, **values)


def test_all_that_is_sent_is_recorded_with_when_and_by_whom(join: Join, tmp_path: Path) -> None:
    server, test = join(), join()
    static = test.writer(test.cell.tf_static, TransformList)
    static.send(transform(5.0))  # before anybody records
    with running(recorder.run, server, settings(tmp_path)):
        control = RecorderClient(test)
        known(server, test)
        assert control.status().state is Recording.IDLE
        state = control.start(str(tmp_path / "one"))
        assert state.state is Recording.RECORDING
        points = test.writer(test.cell.points("kinect"), PointCloud2)
        moving = test.writer(test.cell.tf, TransformList)
        assert soon(points.has_readers)
        assert soon(moving.has_readers)
        for number in range(20):
            points.send(cloud(number))
            moving.send(transform(number))
        assert soon(lambda: control.status().messages == 41)
        assert soon(lambda: control.status().safe_ns > 0)
        ended = control.stop()
    assert (ended.state, ended.messages, ended.lost) == (Recording.IDLE, 41, 0)
    with McapFile.open(tmp_path / "one.mcap") as file:
        entries = list(file.messages())
    of_points = [e for e in entries if e.channel.metadata["key"] == test.cell.points("kinect")]
    assert [from_cdr(PointCloud2, e.data) for e in of_points] == [cloud(n) for n in range(20)]
    assert [e.sequence for e in of_points] == list(range(1, 21))
    assert all(e.publish_time <= e.log_time for e in of_points)
    assert len({e.log_time for e in entries}) == 41
    (latched,) = [e for e in entries if e.channel.metadata["key"] == test.cell.tf_static]
    assert from_cdr(TransformList, latched.data) == transform(5.0)


def test_only_wanted_keys_are_recorded_and_each_once(join_memory: Join, tmp_path: Path) -> None:
    server, test = join_memory(), join_memory()
    wanted = settings(tmp_path, keys="test/*/points test/** other/**", exclude="voxel", start=True)
    writers = [
        test.writer(test.cell.points("kinect"), PointCloud2),
        test.writer(test.cell.voxel_points("kinect"), PointCloud2),
        test.writer(test.cell.selected_points("kinect"), PointCloud2),
    ]
    with running(recorder.run, server, wanted):
        for writer in writers:
            writer.send(cloud(1))
    (path,) = tmp_path.glob("*.mcap")
    assert keys_in(path) == ["test/kinect/points", "test/kinect/selected_points"]


def test_a_recorder_says_no_with_its_reason(join_memory: Join, tmp_path: Path) -> None:
    server, test = join_memory(), join_memory()
    control = RecorderClient(test)
    with pytest.raises(NobodyAnswers):
        control.status()
    with running(recorder.run, server, settings(tmp_path)):
        with pytest.raises(RequestRefused, match="ring"):
            control.trigger()
        with pytest.raises(RequestRefused, match="no folder"):
            control.start(str(tmp_path / "nowhere" / "a.mcap"))
        control.start(str(tmp_path / "a.mcap"))
        with pytest.raises(RequestRefused, match="recorded already"):
            control.start(str(tmp_path / "b.mcap"))
        control.stop()
        (tmp_path / "away").symlink_to(tmp_path.parent)
        for outside in ("../b.mcap", "/b.mcap", "away/b.mcap"):
            with pytest.raises(RequestRefused, match=f"{outside} is not in the recorder's folder"):
                control.start(outside)
        assert not (tmp_path.parent / "b.mcap").exists()
        with pytest.raises(RequestRefused, match="there already"):
            control.start(str(tmp_path / "a.mcap"))


def test_the_seconds_before_a_trigger_are_written_with_what_was_in_force(join_memory: Join, tmp_path: Path) -> None:
    server, test = join_memory(), join_memory()
    test.writer(test.cell.tf_static, TransformList).send(transform(5.0))
    points = test.writer(test.cell.points("kinect"), PointCloud2)
    with running(recorder.run, server, settings(tmp_path, ring=100, ring_memory=0.02, after=0.2)):
        control = RecorderClient(test)
        assert control.status().state is Recording.ARMED
        for number in range(200):  # more than the ring holds: the first are forgotten, the transform with them
            points.send(cloud(number))
        assert not list(tmp_path.glob("*"))
        assert control.trigger().state is Recording.RECORDING
        points.send(cloud(200))
        assert soon(lambda: control.status().state is Recording.ARMED)
    (path,) = tmp_path.glob("*.mcap")
    with McapFile.open(path) as file:
        entries = list(file.messages())
    numbers = [from_cdr(PointCloud2, e.data) for e in entries if e.channel.topic == "/test/kinect/points"]
    assert len(numbers) > 20
    assert numbers == [cloud(n) for n in range(201 - len(numbers), 201)]
    before = [e for e in entries if IN_FORCE in e.channel.metadata]
    assert [from_cdr(TransformList, e.data) for e in before] == [transform(5.0)]


def test_all_that_was_kept_is_written_however_little_may_wait_for_the_disk(join_memory: Join, tmp_path: Path) -> None:
    server, test = join_memory(), join_memory()
    points = test.writer(test.cell.points("kinect"), PointCloud2)
    with running(recorder.run, server, settings(tmp_path, ring=100, memory=0.05, after=100)):
        for number in range(60):  # 1.4 MiB
            points.send(cloud(number, size=(30, 40)))
        state = RecorderClient(test).trigger()
        points.send(cloud(60))  # finds room beside what was kept
        ended = RecorderClient(test).stop()
    assert (ended.messages, ended.lost) == (61, 0)
    assert len(keys_in(Path(state.path))) == 61


def test_what_is_kept_stays_so_where_no_file_can_be_made(join_memory: Join, tmp_path: Path) -> None:
    server, test = join_memory(), join_memory()
    points = test.writer(test.cell.points("kinect"), PointCloud2)
    (tmp_path / "taken.mcap").touch()
    with running(recorder.run, server, settings(tmp_path, ring=100)):
        control = RecorderClient(test)
        for number in range(5):
            points.send(cloud(number))
        with pytest.raises(RequestRefused, match="there already"):
            control.start("taken")
        control.start("free")
        assert control.stop().messages == 5


def test_how_it_stands_is_told_while_a_file_is_closed(
    join_memory: Join, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    server, test = join_memory(), join_memory()
    closing, going_on = threading.Event(), threading.Event()
    real = DiskWriter.close

    def slow(writer: DiskWriter) -> None:
        closing.set()
        assert going_on.wait(10)
        real(writer)

    monkeypatch.setattr(DiskWriter, "close", slow)
    with running(recorder.run, server, settings(tmp_path)):
        control = RecorderClient(test)
        control.start("one")
        stopping = threading.Thread(target=control.stop)
        stopping.start()
        assert closing.wait(10)
        assert control.status().state is Recording.RECORDING
        going_on.set()
        stopping.join()
        assert control.status().state is Recording.IDLE


def result(code: ResultCode) -> Update[FindObjectResult]:
    answer = FindObjectResult(header=Header(), code=code, status=Status.FOUND if not code else Status.NOT_FOUND)
    return Update(goal_id=new_goal_id(), state=GoalState.SUCCEEDED, final=True, result=answer)


@pytest.mark.parametrize("code", [ResultCode.FOUND, ResultCode.NOT_FOUND])
def test_a_failed_find_triggers(join_memory: Join, tmp_path: Path, code: ResultCode) -> None:
    server, test = join_memory(), join_memory()
    goals = test.writer(test.cell.goal("finder"), FindObjectGoal)
    feedback = test.writer(test.cell.feedback("finder"), Update[Message])
    with running(recorder.run, server, settings(tmp_path, ring=100, after=0.1, trigger_failed_find=True)):
        goals.send(FindObjectGoal(goal_id=new_goal_id(), object_type="ball"))
        feedback.send(result(code))  # type: ignore[arg-type]  # an Update of any result is an Update of a Message
        if code:
            assert soon(lambda: bool(list(tmp_path.glob("*.mcap"))))
            assert soon(lambda: RecorderClient(test).status().state is Recording.ARMED)
    files = list(tmp_path.glob("*.mcap"))
    assert len(files) == (code is ResultCode.NOT_FOUND)
    for path in files:
        assert keys_in(path) == ["test/find_object/finder/goal", "test/find_object/finder/feedback"]


@pytest.mark.parametrize("key", ["elsewhere/feedback", "test/find_object/feedback"])
def test_other_keys_that_end_like_the_answers_of_finds_are_recorded(
    join_memory: Join, tmp_path: Path, key: str
) -> None:
    server, test = join_memory(), join_memory()
    writer = test.link.writer(key, Delivery.EVERY)
    payload = encode(FindObjectGoal(goal_id=new_goal_id(), object_type="ball"))
    with running(recorder.run, server, settings(tmp_path, keys=key, ring=100, trigger_failed_find=True)):
        writer.put(payload, b"", Attachment(7, 1, START).pack())
        state = RecorderClient(test).trigger()
    assert keys_in(Path(state.path)) == [key]


def test_a_message_on_a_key_triggers(join_memory: Join, tmp_path: Path) -> None:
    server, test = join_memory(), join_memory()
    patches = test.writer(test.cell.selected_points("kinect"), PointCloud2)
    with running(recorder.run, server, settings(tmp_path, ring=100, after=0.1, trigger_key="test/*/selected_points")):
        patches.send(cloud(1))
        assert soon(lambda: bool(list(tmp_path.glob("*.mcap"))))
    (path,) = tmp_path.glob("*.mcap")
    assert keys_in(path) == ["test/kinect/selected_points"]


# The disk's side, without a network.


def disk(path: Path, **policy: Any) -> DiskWriter:
    return DiskWriter(path, "cell", {}, DiskPolicy(reserve=1 << 18, **policy), in_force=[])


def numbered(number: int, *, size: tuple[int, int] = (4, 5)) -> Any:
    return sample("cell/kinect/points", cloud(number, size=size), START + number, sequence=number + 1)


def test_a_recording_is_split_each_file_stands_alone_and_the_last_are_kept(tmp_path: Path) -> None:
    writer = disk(tmp_path / "a.mcap", split=Split(bytes=30_000_000, keep=2), compression="none")
    writer.put(sample("cell/tf_static", transform(5.0), START))
    for number in range(1, 20):
        writer.put(numbered(number, size=(480, 640)))
    writer.close()
    files = sorted(tmp_path.iterdir())
    assert files == writer.series.files
    assert [file.name for file in files] == ["a_1.mcap", "a_2.mcap"]
    found = []
    for path in files:
        with McapFile.open(path) as file:
            entries = list(file.messages())
        assert from_cdr(TransformList, entries[0].data) == transform(5.0)
        assert IN_FORCE in entries[0].channel.metadata
        found += [e.sequence - 1 for e in entries[1:]]
    assert found == list(range(20 - len(found), 20))
    assert writer.losses() == {}


def test_a_file_that_cannot_be_begun_takes_none_of_those_that_are_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    refused = threading.Semaphore(0)

    def refuse(*_: object) -> None:
        refused.release()
        raise OSError(errno.EMFILE, "Too many open files")

    monkeypatch.setattr(disk_writer, "_LOOK_AGAIN", 0.001)
    policy = {"split": Split(bytes=1_000_000, keep=3), "on_full": OnFull.WAIT, "compression": "none"}
    writer = disk(tmp_path / "a.mcap", **policy)
    writer.put(numbered(0, size=(480, 640)))
    assert soon(lambda: len(writer.series.files) == 2)
    with monkeypatch.context() as full:
        full.setattr(disk_writer, "RecordingFile", refuse)
        writer.put(numbered(1, size=(480, 640)))
        for _ in range(4):
            assert refused.acquire(timeout=10)
    assert soon(lambda: not writer.full)
    writer.put(numbered(2))
    writer.close()
    assert sorted(tmp_path.iterdir()) == writer.series.files
    assert [file.name for file in writer.series.files] == ["a_0.mcap", "a_1.mcap", "a_2.mcap"]
    assert [len(keys_in(file)) for file in writer.series.files] == [1, 1, 1]


def test_a_file_that_can_be_made_but_not_begun_is_not_left_behind(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(McapWriter, "channel", refuse)
    in_force = [sample("cell/tf_static", transform(5.0), START)]
    with pytest.raises(OSError, match="No space"):
        DiskWriter(tmp_path / "a.mcap", "cell", {}, DiskPolicy(), in_force=in_force)
    assert list(tmp_path.iterdir()) == []


def refuse(*_: object) -> int:
    raise OSError(errno.ENOSPC, "No space left on device")


def test_a_message_that_the_disk_refuses_is_lost_and_not_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(McapWriter, "channel", refuse)  # the first message of a key needs one
    writer = disk(tmp_path / "a.mcap")
    writer.put(numbered(0))
    writer.close()
    assert (writer.messages, writer.bytes_in) == (0, 0)
    assert writer.losses() == {"cell/kinect/points": 1}


def test_what_a_full_disk_takes_back_is_lost_and_not_safe(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    in_force = [sample("cell/tf_static", transform(5.0), START - 1)]
    writer = DiskWriter(tmp_path / "a.mcap", "cell", {}, DiskPolicy(reserve=1 << 18), in_force=in_force)
    writer.put(numbered(0))
    assert soon(lambda: writer.safe_ns == START)
    with monkeypatch.context() as full:
        full.setattr(os, "writev", refuse)  # so not even the index finds room, and chunks give way to it
        writer.put(numbered(1))
        writer.close()
    assert writer.messages == 0
    assert writer.losses() == {"cell/kinect/points": 2}
    assert writer.safe_ns == START


def test_what_finds_no_room_in_memory_is_dropped_at_once_and_counted(tmp_path: Path) -> None:
    writer = disk(tmp_path / "a.mcap", memory=20_000, compression="none")
    hold, held = threading.Event(), threading.Event()

    def slow(bytes_per_second: float, backlog: float) -> str:
        del bytes_per_second, backlog
        held.set()
        assert hold.wait(10)
        return ""

    writer.choice.next = slow  # type: ignore[method-assign]  # a disk that does not come back
    writer.put(numbered(0))
    assert held.wait(10)
    for number in range(1, 300):
        writer.put(numbered(number))
    lost = writer.losses()["cell/kinect/points"]
    assert 100 < lost < 299
    hold.set()
    writer.close()
    assert writer.losses() == {"cell/kinect/points": lost}
    with McapFile.open(tmp_path / "a.mcap") as file:
        assert file.statistics.messages == 300 - lost
        assert {m.name: m.entries for m in file.metadata}[LOSSES] == {"cell/kinect/points": str(lost)}


def test_a_chunk_is_closed_in_time_though_little_comes(tmp_path: Path) -> None:
    writer = disk(tmp_path / "a.mcap")
    writer.put(numbered(0))
    assert soon(lambda: writer.safe_ns == START)  # far below the size of a chunk, and nothing more comes
    with McapFile.open(tmp_path / "a.mcap") as file:
        assert [e.sequence for e in file.messages()] == [1]
    writer.close()
