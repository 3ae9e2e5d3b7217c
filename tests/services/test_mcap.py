"""Files: what is written is what other readers read, torn files are read as far as they go."""

from __future__ import annotations

import errno
import os
import tracemalloc
from typing import TYPE_CHECKING, Any

import lz4.frame
import pytest
import zstandard
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from tests.services.recordings import START, cloud, sample, transform

from zsight.errors import UsageError
from zsight.recording.compression import compressed, decompressed
from zsight.recording.mcap_file import McapFile
from zsight.recording.mcap_records import Attachment, Metadata, Opcode, packed_record
from zsight.recording.mcap_writer import McapWriter
from zsight.recording.recording_file import LOSSES, RecordingFile
from zsight_protocol.point_cloud import PointCloud2
from zsight_protocol.ros_message import from_cdr

if TYPE_CHECKING:
    from pathlib import Path

COMPRESSIONS = ["", "lz4", "zstd"]
STEP = 10_000_000


def write(path: Path, count: int = 40, *, compression: str = "", finish: bool = True) -> RecordingFile:
    """Clouds and transforms in turn, some to a chunk."""
    file = RecordingFile(path, "cell", {"purpose": "test"})
    for number in range(count):
        at = START + number * STEP
        key, message = ("cell/kinect/points", cloud(number)) if number % 2 else ("cell/tf", transform(number))
        file.write(sample(key, message, at, sequence=number + 1))
        if number % 5 == 4:
            file.mcap.close_chunk(compression)
    if finish:
        file.finish(compression)
    return file


@pytest.fixture(params=COMPRESSIONS, ids=["uncompressed", "lz4", "zstd"])
def recorded(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """A whole file."""
    write(tmp_path / "whole.mcap", compression=request.param)
    return tmp_path / "whole.mcap"


def test_mcap_and_its_ros2_decoder_read_what_was_sent(recorded: Path) -> None:
    with recorded.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        assert reader.get_header().profile == "ros2"
        found = list(reader.iter_decoded_messages())
    assert [message.log_time for _, _, message, _ in found] == [START + n * STEP for n in range(40)]
    assert {(c.topic, s.name) for s, c, _, _ in found if s is not None} == {
        ("/cell/kinect/points", "sensor_msgs/msg/PointCloud2"),
        ("/cell/tf", "tf2_msgs/msg/TFMessage"),
    }
    for number, (_, _, message, ros) in enumerate(found):
        assert message.sequence == number + 1
        assert message.publish_time == message.log_time - 1000
        if number % 2:
            assert_same_cloud(ros, cloud(number))
        else:
            assert ros.transforms[0].transform.translation.x == number


def assert_same_cloud(theirs: Any, ours: PointCloud2) -> None:
    assert bytes(theirs.data) == bytes(ours.data)
    assert (theirs.height, theirs.width, theirs.point_step, theirs.row_step, theirs.is_dense) == (
        ours.height,
        ours.width,
        ours.point_step,
        ours.row_step,
        ours.is_dense,
    )
    assert [(f.name, f.offset, f.datatype, f.count) for f in theirs.fields] == [
        (f.name, f.offset, int(f.datatype), f.count) for f in ours.fields
    ]
    assert (theirs.header.stamp.sec, theirs.header.stamp.nanosec, theirs.header.frame_id) == (
        ours.header.stamp.sec,
        ours.header.stamp.nanosec,
        ours.header.frame_id,
    )


def test_rosbags_reads_what_was_sent(recorded: Path) -> None:
    with AnyReader([recorded]) as reader:
        found = [(c.topic, time, reader.deserialize(raw, c.msgtype)) for c, time, raw in reader.messages()]
    assert [time for _, time, _ in found] == [START + n * STEP for n in range(40)]
    for number, (topic, _, message) in enumerate(found):
        assert topic == ("/cell/kinect/points" if number % 2 else "/cell/tf")
        if number % 2:
            assert_same_cloud(message, cloud(number))


def test_ours_reads_what_was_sent(recorded: Path) -> None:
    with McapFile.open(recorded) as file:
        assert file.damage == ""
        assert file.statistics.messages == 40
        entries = list(file.messages())
        assert [entry.log_time for entry in entries] == [START + n * STEP for n in range(40)]
        assert from_cdr(PointCloud2, entries[7].data) == cloud(7)
        part = list(file.messages(START + 10 * STEP, START + 20 * STEP, {entries[1].channel.id}))
        assert [(e.log_time - START) // STEP for e in part] == [11, 13, 15, 17, 19]
        last = file.last_before(START + 18 * STEP, {entries[1].channel.id})
        assert last is not None
        assert last.log_time == START + 17 * STEP
        assert file.last_before(START, {entries[1].channel.id}) is None


def test_metadata_and_attachments_are_there_for_others(tmp_path: Path) -> None:
    writer = McapWriter(tmp_path / "a.mcap", "test")
    writer.add_metadata(Metadata("who", {"name": "ü"}))
    writer.attach(Attachment("notes.txt", "text/plain", b"hello", 7))
    writer.finish()
    with (tmp_path / "a.mcap").open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        assert [(m.name, m.metadata) for m in reader.iter_metadata()] == [("who", {"name": "ü"})]
        assert [(a.name, a.media_type, a.data) for a in reader.iter_attachments()] == [
            ("notes.txt", "text/plain", b"hello")
        ]
    with McapFile.open(tmp_path / "a.mcap") as file:
        assert file.metadata == [Metadata("who", {"name": "ü"})]
        assert file.attachments == [Attachment("notes.txt", "text/plain", b"hello", 7)]


def test_a_file_that_is_there_is_not_overwritten(tmp_path: Path) -> None:
    (tmp_path / "a.mcap").write_text("precious")
    with pytest.raises(UsageError, match="there already"):
        McapWriter(tmp_path / "a.mcap", "test")
    assert (tmp_path / "a.mcap").read_text() == "precious"


def test_what_is_no_mcap_file_is_refused(tmp_path: Path) -> None:
    for content in (b"", b"PK\x03\x04 something else"):
        (tmp_path / "a.mcap").write_bytes(content)
        with pytest.raises(UsageError, match=r"a\.mcap"):
            McapFile.open(tmp_path / "a.mcap")


def test_messages_that_no_row_knows_are_kept_as_they_came(tmp_path: Path) -> None:
    file = RecordingFile(tmp_path / "a.mcap", "cell", {})
    file.write(sample("other/key", b"\x81\xa1a\x01", START))
    file.write(sample("cell/tf", b"not a transform", START + 1))
    file.finish()
    with McapFile.open(tmp_path / "a.mcap") as read:
        found = [(e.channel.metadata["key"], e.channel.encoding, bytes(e.data)) for e in read.messages()]
    assert found == [("other/key", "msgpack", b"\x81\xa1a\x01"), ("cell/tf", "msgpack", b"not a transform")]


@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_a_file_cut_anywhere_is_read_as_far_as_its_chunks_go(tmp_path: Path, compression: str) -> None:
    file = write(tmp_path / "open.mcap", compression=compression, finish=False)
    whole = (tmp_path / "open.mcap").read_bytes()
    file.mcap.abandon()
    ends = []
    for size in range(9, len(whole) + 1, 37):
        (tmp_path / "torn.mcap").write_bytes(whole[:size])
        with McapFile.open(tmp_path / "torn.mcap") as torn:
            assert "without its index" in torn.damage
            numbers = [(entry.log_time - START) // STEP for entry in torn.messages()]
        assert numbers == list(range(len(numbers)))
        ends.append(len(numbers))
    assert ends == sorted(ends)
    assert ends[-1] == 40
    # Uncompressed chunks are read message by message, the others chunk by chunk.
    assert (len(set(ends)) > 20) == (compression == "")


def test_a_disk_that_fails_at_the_end_leaves_the_chunks_that_are_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> int:
        raise OSError(errno.EIO, "Input/output error")

    file = write(tmp_path / "a.mcap", finish=False)
    with monkeypatch.context() as failing:
        failing.setattr(os, "writev", fail)
        with pytest.raises(OSError, match="Input/output"):
            file.finish()
    assert file.losses() == {}
    with McapFile.open(tmp_path / "a.mcap") as read:
        assert len(list(read.messages())) == 40


def test_a_message_outside_of_chunks_that_is_too_short_is_left_out(tmp_path: Path) -> None:
    file = write(tmp_path / "a.mcap", finish=False)
    file.mcap.abandon()
    with (tmp_path / "a.mcap").open("ab") as end:
        end.write(packed_record(Opcode.MESSAGE, bytes(12)))
    with McapFile.open(tmp_path / "a.mcap") as read:
        assert len(list(read.messages())) == 40
        assert "damaged" in read.damage


def test_a_chunk_whose_bytes_have_changed_is_left_out(tmp_path: Path) -> None:
    file = write(tmp_path / "a.mcap", finish=False)
    file.mcap.abandon()
    content = bytearray((tmp_path / "a.mcap").read_bytes())
    place = content.index(cloud(7).data)
    content[place] ^= 1
    (tmp_path / "a.mcap").write_bytes(content)
    with McapFile.open(tmp_path / "a.mcap") as read:
        numbers = [(entry.log_time - START) // STEP for entry in read.messages()]
        assert "checksum" in read.damage
    assert numbers == [n for n in range(40) if n not in range(5, 10)]


@pytest.mark.parametrize("compression", ["lz4", "zstd"])
@pytest.mark.parametrize("told", [10, 65 << 20, 1 << 62])
def test_a_chunk_takes_no_more_memory_than_it_declares_and_may(compression: str, told: int) -> None:
    bomb = b"".join(compressed(compression, [bytes(64 << 20)], 64 << 20))
    assert len(bomb) < 1 << 20
    tracemalloc.start()
    try:
        with pytest.raises(ValueError, match=compression if told < 1 << 30 else "expected at most"):
            decompressed(compression, memoryview(bomb), told)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 2 << 20 or told == 65 << 20


@pytest.mark.parametrize("compression", ["lz4", "zstd"])
def test_a_chunk_that_does_not_tell_its_size_or_is_cut_is_read_no_further_than_it_may(compression: str) -> None:
    silent = {"lz4": lz4.frame.compress(bytes(64 << 20), store_size=False), "zstd": _zstd_without_size(bytes(64 << 20))}
    stored = memoryview(silent[compression])
    assert decompressed(compression, stored, 64 << 20) == bytes(64 << 20)
    for wrong, told in ((stored, (64 << 20) - 1), (stored[:-4], 64 << 20), (stored[:0], 64 << 20)):
        with pytest.raises(ValueError, match=compression):
            decompressed(compression, wrong, told)


def _zstd_without_size(data: bytes) -> bytes:
    zstd = zstandard.ZstdCompressor().compressobj()
    return zstd.compress(data) + zstd.flush()


def test_losses_are_told_in_the_file(tmp_path: Path) -> None:
    file = RecordingFile(tmp_path / "a.mcap", "cell", {})
    file.write(sample("cell/tf", transform(1), START))
    file.lose("cell/tf", 3)
    file.lose("cell/kinect/points")
    assert file.finish() == {"cell/kinect/points": 1, "cell/tf": 3}
    with McapFile.open(tmp_path / "a.mcap") as read:
        assert read.metadata[-1] == Metadata(LOSSES, {"cell/kinect/points": "1", "cell/tf": "3"})


def test_checksums_are_those_of_the_bytes(tmp_path: Path) -> None:
    write(tmp_path / "a.mcap")
    with McapFile.open(tmp_path / "a.mcap") as read:
        assert all(read.entries(chunk) for chunk in read.chunks)
