"""Recordings cut, joined, converted, mended and checked; recordings of others read as other readers read them."""

from __future__ import annotations

import dataclasses
import re
import tracemalloc
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from rosbags.rosbag1 import Writer as Bag1Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Bag2Writer
from rosbags.typesys import Stores, get_typestore
from tests.services.recordings import START, cloud, damage, sample, transform
from typer.testing import CliRunner

from zsight.cli import bag
from zsight.convert import points_of
from zsight.errors import UsageError
from zsight.recording.about import about
from zsight.recording.checking import check
from zsight.recording.conversion import convert
from zsight.recording.export import export
from zsight.recording.mcap_copy import Part, copy
from zsight.recording.mcap_file import McapFile
from zsight.recording.opening import open_recording
from zsight.recording.recorded_source import RecordedClouds
from zsight.recording.recording_file import IN_FORCE, RecordingFile
from zsight_core.errors import FileError
from zsight_core.points import colours, xyz
from zsight_protocol.errors import DecodeError
from zsight_protocol.geometry import TransformList
from zsight_protocol.point_cloud import PointCloud2
from zsight_protocol.ros_message import from_cdr

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

STEP = 10_000_000
COUNT = 100


def write(
    path: Path,
    *,
    first: int = 0,
    count: int = COUNT,
    writer: int = 7,
    lose: int | None = None,
    compression: str = "zstd",
) -> Path:
    file = RecordingFile(path, "cell", {})
    file.write(sample("cell/tf_static", transform(1.0), START + first * STEP - 1, writer=99))
    for number in range(first, first + count):
        if number != lose:
            at = START + number * STEP + writer
            file.write(sample("cell/kinect/points", cloud(number), at, sequence=number + 1, writer=writer))
        if number % 10 == 9:
            file.mcap.close_chunk(compression)
    file.finish()
    return path


def copy_one(source: Path, target: Path) -> object:
    return copy([source], target)


def compressions(path: Path) -> set[str]:
    with McapFile.open(path) as file:
        return {chunk.compression for chunk in file.chunks}


def numbers(path: Path) -> list[int]:
    with McapFile.open(path) as file:
        assert file.damage == ""
        kept = [e for e in file.messages() if e.channel.topic == "/cell/kinect/points"]
        return [int(points_of(from_cdr(PointCloud2, e.data))["x"][0, 0]) for e in kept]


def test_a_part_begins_with_what_was_in_force(tmp_path: Path) -> None:
    whole = write(tmp_path / "whole.mcap")
    part = Part(start=START + 40 * STEP, end=START + 60 * STEP)
    assert copy([whole], tmp_path / "part.mcap", part=part, compression="lz4").messages == 20
    assert numbers(tmp_path / "part.mcap") == list(range(40, 60))
    with McapFile.open(tmp_path / "part.mcap") as file:
        first = next(file.messages())
    assert IN_FORCE in first.channel.metadata
    assert from_cdr(TransformList, first.data) == transform(1.0)
    assert check(tmp_path / "part.mcap")["sound"]


def test_topics_can_be_left_out(tmp_path: Path) -> None:
    whole = write(tmp_path / "whole.mcap")
    assert copy([whole], tmp_path / "a.mcap", part=Part(topics="tf_static$")).messages == 1
    assert copy([whole], tmp_path / "b.mcap", part=Part(exclude="points")).messages == 1
    with pytest.raises(UsageError, match="there already"):
        copy([whole], tmp_path / "b.mcap")
    with pytest.raises(UsageError, match="one of the files"):
        copy([whole], whole)


def test_several_become_one_in_order(tmp_path: Path) -> None:
    left = write(tmp_path / "left.mcap", writer=1)
    right = write(tmp_path / "right.mcap", writer=2)
    later = write(tmp_path / "later.mcap", first=COUNT, writer=1)
    assert copy([later, right, left], tmp_path / "all.mcap").messages == 3 * COUNT + 3
    found = numbers(tmp_path / "all.mcap")
    assert found == sorted([*range(COUNT), *range(2 * COUNT)])
    report = check(tmp_path / "all.mcap")
    assert (report["sound"], report["gaps"]) == (True, {})


def test_a_folder_of_split_files_is_one_recording(tmp_path: Path) -> None:
    folder = tmp_path / "split"
    folder.mkdir()
    for part in range(3):
        write(folder / f"a_{part}.mcap", first=part * 30, count=30)
    recording = open_recording(folder)
    found = [played.load() for played in recording.messages(recording.start_ns, None, recording.lines)]
    clouds = [int(points_of(m)["x"][0, 0]) for m in found if isinstance(m, PointCloud2)]
    assert clouds == list(range(90))
    last = recording.last_before(START + 45 * STEP, [line for line in recording.lines if line.key == "kinect/points"])
    assert last is not None
    assert last.load() == cloud(44)
    recording.close()


def test_check_finds_what_is_wrong(tmp_path: Path) -> None:
    sound = write(tmp_path / "sound.mcap")
    assert check(sound) == {
        "file": str(sound), "messages": 101, "chunks": 10, "errors": [], "gaps": {}, "losses": {}, "sound": True,
    }  # fmt: skip
    lossy = write(tmp_path / "lossy.mcap", lose=50)
    assert check(lossy)["gaps"] == {"/cell/kinect/points": 1}
    torn = tmp_path / "torn.mcap"
    torn.write_bytes(sound.read_bytes()[:-100])
    assert not check(torn)["sound"]
    bad = bytearray(sound.read_bytes())
    bad[bad.index(b"zstd") + 100] ^= 0xFF  # inside of the first chunk
    (tmp_path / "bad.mcap").write_bytes(bad)
    assert any("damaged" in words for words in check(tmp_path / "bad.mcap")["errors"])


AFTER = Part(start=START + 40 * STEP)  # begins with what was in force, which is in the first chunk


@pytest.mark.parametrize("compression", ["", "lz4", "zstd"])
@pytest.mark.parametrize(
    ("chunk", "take"),
    [
        (2, lambda source, target: copy([source], target)),
        (0, lambda source, target: copy([source], target, part=AFTER)),
        (2, convert),
        (2, lambda source, target: export(source, target, "mcap")),
        (0, lambda source, target: export(source, target, "pcd")),
    ],
)
def test_a_damaged_chunk_is_refused_where_all_is_wanted(
    tmp_path: Path, chunk: int, take: Callable[[Path, Path], object], compression: str
) -> None:
    damaged = damage(write(tmp_path / "whole.mcap", compression=compression), chunk, tmp_path / "damaged.mcap")
    with pytest.raises(UsageError, match=rf"is damaged: .*mend it first with: zsight bag recover {damaged}"):
        take(damaged, tmp_path / "new.mcap")
    copy([damaged], tmp_path / "mended.mcap", walk=True)
    first = chunk * 10
    assert numbers(tmp_path / "mended.mcap") == [*range(first), *range(first + 10, COUNT)]
    take(tmp_path / "mended.mcap", tmp_path / "mended")


@pytest.mark.parametrize("compression", ["", "lz4", "zstd"])
def test_check_tells_every_damaged_chunk_of_a_file_with_an_index(tmp_path: Path, compression: str) -> None:
    once = damage(write(tmp_path / "whole.mcap", compression=compression), 2, tmp_path / "once.mcap")
    twice = damage(once, 7, tmp_path / "twice.mcap")
    report = check(twice)
    assert (report["sound"], report["messages"]) == (False, 81)
    assert sum("is damaged" in words for words in report["errors"]) == 2


@pytest.mark.parametrize("begin", [0, 9, 40])
def test_a_chunk_whose_beginning_was_wiped_out_is_damaged(tmp_path: Path, begin: int) -> None:
    whole = write(tmp_path / "whole.mcap", compression="zstd")
    with McapFile.open(whole) as file:
        chunk = file.chunks[5]
    content = bytearray(whole.read_bytes())
    content[chunk.offset + begin : chunk.offset + chunk.length] = bytes(chunk.length - begin)
    (tmp_path / "wiped.mcap").write_bytes(content)
    assert not check(tmp_path / "wiped.mcap")["sound"]
    with pytest.raises(UsageError, match="is damaged"):
        copy([tmp_path / "wiped.mcap"], tmp_path / "new.mcap")


@pytest.mark.parametrize("compression", ["", "lz4", "zstd"])
@pytest.mark.parametrize("take", [copy_one, convert, lambda source, target: export(source, target, "mcap")])
def test_the_compression_is_kept(tmp_path: Path, compression: str, take: Callable[[Path, Path], object]) -> None:
    take(write(tmp_path / "whole.mcap", compression=compression), tmp_path / "new.mcap")
    assert compressions(tmp_path / "new.mcap") == {compression}


def test_the_compression_is_the_one_asked_for_or_that_of_the_sources(tmp_path: Path) -> None:
    plain = write(tmp_path / "plain.mcap", compression="")
    packed = write(tmp_path / "packed.mcap", compression="lz4")
    copy([plain, packed], tmp_path / "both.mcap")
    assert compressions(tmp_path / "both.mcap") == {"lz4"}
    copy([packed], tmp_path / "unpacked.mcap", compression="none")
    assert compressions(tmp_path / "unpacked.mcap") == {""}
    convert(packed, tmp_path / "other.mcap", compression="zstd")
    assert compressions(tmp_path / "other.mcap") == {"zstd"}
    for name in ("auto", "gzip"):
        with pytest.raises(UsageError, match=f"compression is '{name}'; expected"):
            convert(packed, tmp_path / "refused.mcap", compression=name)
    assert not (tmp_path / "refused.mcap").exists()


@pytest.mark.parametrize("offset", [-2000, -30, 0, 300])  # of the wiped place from the beginning of a chunk
def test_what_follows_a_wiped_place_is_recovered_where_the_index_is_there(tmp_path: Path, offset: int) -> None:
    whole = write(tmp_path / "whole.mcap", compression="zstd")
    with McapFile.open(whole) as file:
        chunks, metadata = file.chunks, file.metadata
    place = chunks[5].offset + offset
    content = bytearray(whole.read_bytes())
    content[place : place + 600] = bytes(600)
    (tmp_path / "wiped.mcap").write_bytes(content)
    copy([tmp_path / "wiped.mcap"], tmp_path / "mended.mcap", walk=True)
    hit = [n for n, c in enumerate(chunks) if c.offset < place + 600 and place < c.offset + c.length]
    assert numbers(tmp_path / "mended.mcap") == [n for n in range(COUNT) if n // 10 not in hit]
    assert check(tmp_path / "mended.mcap")["sound"]
    assert not check(tmp_path / "wiped.mcap")["sound"]
    with McapFile.open(tmp_path / "mended.mcap") as file:
        assert file.metadata == metadata


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--start", "50"], "from 50 s on is empty: .* is 0.990 s long"),
        (["--start", "0.6", "--end", "0.4"], "from 0.6 s on is empty"),
        (["--end", "0"], "from 0 s on is empty"),
        (["--topics", "nothing"], "holds nothing that can be taken over"),
    ],
)
def test_a_part_with_nothing_in_it_is_refused(tmp_path: Path, options: list[str], words: str) -> None:
    whole, target = write(tmp_path / "whole.mcap"), tmp_path / "part.mcap"
    told = CliRunner().invoke(bag.app, ["cut", str(whole), "-o", str(target), *options])
    assert isinstance(told.exception, UsageError)
    assert re.search(words, str(told.exception))
    assert not target.exists()


def test_what_holds_nothing_is_not_mended(tmp_path: Path) -> None:
    torn = tmp_path / "torn.mcap"
    torn.write_bytes(write(tmp_path / "whole.mcap").read_bytes()[:600])
    with pytest.raises(UsageError, match="holds nothing that can be taken over: the file ends without its index"):
        copy([torn], tmp_path / "mended.mcap", walk=True)
    assert not (tmp_path / "mended.mcap").exists()


@pytest.mark.parametrize("cut", [0.2, 0.5, 0.9, 0.999])
def test_a_torn_file_is_mended_and_left_as_it_is(tmp_path: Path, cut: float) -> None:
    whole = write(tmp_path / "whole.mcap").read_bytes()
    torn = tmp_path / "torn.mcap"
    torn.write_bytes(whole[: int(len(whole) * cut)])
    before = torn.read_bytes()
    copied = copy([torn], tmp_path / "mended.mcap", walk=True)
    assert copied.damage
    assert torn.read_bytes() == before
    found = numbers(tmp_path / "mended.mcap")
    assert found == list(range(len(found)))
    assert len(found) >= (cut - 0.15) * COUNT
    assert check(tmp_path / "mended.mcap")["sound"]


# Recordings of others.


def clouds_of(path: Path) -> list[PointCloud2]:
    recording = open_recording(path)
    found = [played.load() for played in recording.messages(recording.start_ns, None, recording.lines)]
    recording.close()
    return [message for message in found if isinstance(message, PointCloud2)]


@pytest.mark.parametrize("name", ["jsk/watercan.bag", "moveit/perception_tutorial.bag"])
def test_real_bags_are_read_as_rosbags_reads_them(shared_data: Path, name: str, tmp_path: Path) -> None:
    path = shared_data / name
    if not path.is_file():
        pytest.skip(f"no {path}")
    with AnyReader([path]) as reader:
        theirs = [(time, reader.deserialize(raw, c.msgtype)) for c, time, raw in reader.messages()]
    recording = open_recording(path)
    ours = list(recording.messages(recording.start_ns, None, recording.lines))
    assert [played.log_time for played in ours] == [time for time, _ in theirs]
    for played, (_, message) in [*zip(ours, theirs, strict=True)][::20]:
        assert_same(played.load(), message)
    recording.close()
    if len(ours) > 1:
        return
    count, left = convert(path, tmp_path / "converted.mcap", compression="zstd")
    assert (count, left) == (len(theirs), {})
    assert check(tmp_path / "converted.mcap")["sound"]
    assert clouds_of(tmp_path / "converted.mcap") == clouds_of(path)


def assert_same(ours: Any, theirs: Any) -> None:
    if isinstance(ours, TransformList):
        assert len(ours.transforms) == len(theirs.transforms)
        for a, b in zip(ours.transforms, theirs.transforms, strict=True):
            assert (a.header.frame_id, a.child_frame_id) == (b.header.frame_id, b.child_frame_id)
            assert a.header.stamp.ns == b.header.stamp.sec * 10**9 + b.header.stamp.nanosec
            for part in ("translation", "rotation"):
                for axis, value in getattr(a.transform, part).model_dump().items():
                    assert getattr(getattr(b.transform, part), axis) == value
    else:
        assert bytes(ours.data) == bytes(theirs.data)
        assert (ours.height, ours.width, ours.point_step) == (theirs.height, theirs.width, theirs.point_step)
        assert ours.header.stamp.ns == theirs.header.stamp.sec * 10**9 + theirs.header.stamp.nanosec
        assert ours.header.frame_id == theirs.header.frame_id


def test_a_check_holds_some_chunks_of_a_recording_at_once_and_not_all(tmp_path: Path) -> None:
    file = RecordingFile(tmp_path / "a.mcap", "cell", {})
    for number in range(30):  # 1 MiB each
        file.write(sample("cell/kinect/points", cloud(1, size=(100, 640)), START + number, sequence=number + 1))
        file.mcap.close_chunk("zstd")
    file.finish()
    tracemalloc.start()
    try:
        assert check(tmp_path / "a.mcap")["sound"]
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 15 << 20


DEPTH = np.tile(np.linspace(500, 1500, 8, dtype=np.uint16), (6, 1))
COLOUR = np.random.default_rng(5).integers(0, 256, (6, 8, 3), dtype=np.uint8)


def messages_of_a_camera(store: Any, *, ros1: bool) -> list[tuple[str, Any]]:
    """A depth image in millimetres, its colours as BGR with padded rows, and its calibration."""
    t = store.types
    extra = {"seq": 0} if ros1 else {}
    header = t["std_msgs/msg/Header"](
        stamp=t["builtin_interfaces/msg/Time"](sec=5, nanosec=6), frame_id="optical", **extra
    )
    image = t["sensor_msgs/msg/Image"]
    k = np.array([10.0, 0, 3.5, 0, 10, 2.5, 0, 0, 1])
    names = ("D", "K", "R", "P") if ros1 else ("d", "k", "r", "p")
    values = dict(zip(names, (np.zeros(5), k, np.eye(3).ravel(), np.zeros(12)), strict=True))
    roi = t["sensor_msgs/msg/RegionOfInterest"](x_offset=0, y_offset=0, height=0, width=0, do_rectify=False)
    info = t["sensor_msgs/msg/CameraInfo"](
        header=header, height=6, width=8, distortion_model="plumb_bob", binning_x=0, binning_y=0, roi=roi, **values
    )
    padded = np.zeros((6, 30), np.uint8)
    padded[:, :24] = COLOUR[:, :, ::-1].reshape(6, 24)
    depth = image(header=header, height=6, width=8, encoding="16UC1", is_bigendian=0, step=16,
                  data=DEPTH.view(np.uint8).ravel())  # fmt: skip
    colour = image(header=header, height=6, width=8, encoding="bgr8", is_bigendian=0, step=30, data=padded.ravel())
    return [("/cam/depth/camera_info", info), ("/cam/rgb/image", colour), ("/cam/depth/image", depth)]


def write_ros1(path: Path) -> None:
    store = get_typestore(Stores.ROS1_NOETIC)
    with Bag1Writer(path) as bag:
        for number, (topic, message) in enumerate(messages_of_a_camera(store, ros1=True)):
            connection = bag.add_connection(topic, message.__msgtype__, typestore=store)
            bag.write(connection, START + number, store.serialize_ros1(message, message.__msgtype__))


def write_ros2(path: Path, storage: StoragePlugin, change: Callable[[Any], Any] = lambda info: info) -> None:
    store = get_typestore(Stores.ROS2_JAZZY)
    with Bag2Writer(path, version=9, storage_plugin=storage) as bag:
        (calibrated, info), *images = messages_of_a_camera(store, ros1=False)
        for number, (topic, message) in enumerate([(calibrated, change(info)), *images]):
            connection = bag.add_connection(topic, message.__msgtype__, typestore=store)
            bag.write(connection, START + number, store.serialize_cdr(message, message.__msgtype__))


@pytest.mark.parametrize("kind", ["ros1", "sqlite3", "mcap folder", "mcap"])
def test_depth_and_colour_images_become_clouds(tmp_path: Path, kind: str) -> None:
    path = tmp_path / ("a.bag" if kind == "ros1" else "a")
    if kind == "ros1":
        write_ros1(path)
    else:
        write_ros2(path, StoragePlugin.SQLITE3 if kind == "sqlite3" else StoragePlugin.MCAP)
    if kind == "mcap":
        (path,) = path.glob("*.mcap")
    (message,) = clouds_of(path)
    assert (message.header.stamp.ns, message.header.frame_id) == (5 * 10**9 + 6, "optical")
    points = points_of(message)
    z = DEPTH * np.float32(0.001)
    np.testing.assert_allclose(xyz(points)[..., 2], z, rtol=1e-6)
    np.testing.assert_allclose(xyz(points)[..., 0], (np.arange(8) - 3.5) / 10 * z, rtol=1e-5)
    np.testing.assert_array_equal(colours(points), COLOUR)
    keys = {topic["key"] for topic in about(path)["topics"]}
    assert keys == {"cam_depth/points", "cam_depth/camera_info"}


def test_what_is_no_depth_image_is_refused_and_the_rest_goes_on(tmp_path: Path) -> None:
    write_ros2(tmp_path / "a", StoragePlugin.SQLITE3)
    recording = open_recording(tmp_path / "a")
    line = next(line for line in recording.lines if line.kind is PointCloud2)
    played = next(iter(recording.messages(0, None, [line])))
    recording._images[line.number].info[0].__dict__["kind"] = None  # type: ignore[attr-defined]  # as if it were damaged
    with pytest.raises(DecodeError, match="no message for"):
        played.load()
    recording.close()


def larger(info: Any) -> Any:
    return dataclasses.replace(info, width=16, height=12)


def without_focal_length(info: Any) -> Any:
    return dataclasses.replace(info, k=-info.k)


@pytest.mark.parametrize(("change", "words"), [(larger, r"the camera's is \(12, 16\)"), (without_focal_length, "fx")])
def test_a_depth_image_that_does_not_fit_its_calibration_is_refused_and_the_rest_goes_on(
    tmp_path: Path, change: Callable[[Any], Any], words: str
) -> None:
    write_ros2(tmp_path / "a", StoragePlugin.SQLITE3, change)
    with pytest.raises(DecodeError, match=words):
        clouds_of(tmp_path / "a")
    count, left = convert(tmp_path / "a", tmp_path / "b.mcap")
    assert (count, left["/cam/depth/image"]) == (1, 1)
    assert McapFile.open(tmp_path / "b.mcap").statistics.messages == 1
    clouds = RecordedClouds.open(tmp_path / "a").clouds()
    with pytest.raises(FileError, match=words):
        next(clouds)
    assert next(clouds, None) is None


def test_a_calibration_that_tells_no_size_is_that_of_the_image(tmp_path: Path) -> None:
    write_ros2(tmp_path / "a", StoragePlugin.SQLITE3, lambda info: dataclasses.replace(info, width=0, height=0))
    (message,) = clouds_of(tmp_path / "a")
    assert (message.height, message.width) == DEPTH.shape


def test_what_is_no_recording_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.bag").write_bytes(b"#ROSBAG V1.2\n")
    (tmp_path / "a.txt").write_text("text")
    (tmp_path / "empty").mkdir()
    for name, words in [("a.bag", "as a bag"), ("a.txt", "is no recording"), ("empty", "holds no recording")]:
        with pytest.raises(UsageError, match=words):
            open_recording(tmp_path / name)
