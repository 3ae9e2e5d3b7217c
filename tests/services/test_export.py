"""Clouds of a recording as files, and as a camera's."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import numpy as np
import pytest
from tests.services.recordings import START, cloud, sample, transform
from typer.testing import CliRunner

from zsight.cli import bag
from zsight.convert import cloud_from_points, points_of
from zsight.errors import UsageError
from zsight.recording.depth_coder import DepthCoder
from zsight.recording.export import export
from zsight.recording.mcap_file import McapFile
from zsight.recording.opening import open_recording
from zsight.recording.recording_file import RecordingFile
from zsight.sources import camera_info, open_source
from zsight_core import depth_image
from zsight_core.files import pcd, ply
from zsight_core.pinhole import Pinhole
from zsight_core.points import colours, xyz
from zsight_protocol.message import Time
from zsight_protocol.point_cloud import PointCloud2

if TYPE_CHECKING:
    from pathlib import Path

    from zsight_core.points import Points

COUNT = 5
CAMERA = Pinhole(40, 30, 35.0, 35.0, 19.5, 14.5)


def seen(number: int) -> Points:
    """What a depth camera measures: a slope with holes."""
    depth = np.tile(np.linspace(0.6, 1.4, 40, dtype=np.float32), (30, 1)) + np.float32(0.01 * number)
    depth[3:6, 4:9] = np.nan
    rgb = np.random.default_rng(number).integers(0, 256, (30, 40, 3), dtype=np.uint8)
    return depth_image.to_points(depth, CAMERA, colour=rgb)


@pytest.fixture
def recorded(tmp_path: Path) -> Path:
    file = RecordingFile(tmp_path / "a.mcap", "cell", {})
    file.write(sample("cell/tf_static", transform(3.0), START - 1))
    for number in range(COUNT):
        at = START + number * 100_000_000
        made = cloud_from_points(seen(number), Time.from_ns(at), "eye")
        file.write(sample("cell/kinect/points", made, at, sequence=number + 1))
        file.write(sample("cell/other/points", cloud(number), at + 1, sequence=number + 1, writer=8))
    file.finish()
    return tmp_path / "a.mcap"


def test_clouds_become_files_point_by_point(recorded: Path, tmp_path: Path) -> None:
    assert export(recorded, tmp_path / "pcd", "pcd", key="kinect/points") == (COUNT, {})
    assert export(recorded, tmp_path / "ply", "ply", key="kinect/points") == (COUNT, {})
    files = sorted((tmp_path / "pcd").iterdir())
    assert files[0].name == f"kinect_points_{START}.pcd"
    for number, file in enumerate(files):
        read = pcd.read(file).points
        assert read.shape == (30, 40)
        np.testing.assert_array_equal(xyz(read), xyz(seen(number)))
        np.testing.assert_array_equal(colours(read), colours(seen(number)))
    assert ply.read(tmp_path / "ply" / f"kinect_points_{START}.ply").points.size == 30 * 40
    assert export(recorded, tmp_path / "all", "pcd")[0] == 2 * COUNT


def test_clouds_become_image_pairs_that_are_read_again(recorded: Path, tmp_path: Path) -> None:
    assert export(recorded, tmp_path / "pairs", "rgbd", key="kinect/points") == (COUNT, {})
    again = next(open_source(str(tmp_path / "pairs"), frame="eye").clouds())
    np.testing.assert_allclose(xyz(again), xyz(seen(0)), atol=1e-4)
    np.testing.assert_array_equal(colours(again), colours(seen(0)))
    count, left = export(recorded, tmp_path / "others", "rgbd", key="other/points")
    assert (count, sum(left.values())) == (0, COUNT)  # these are no depth camera's


@pytest.mark.parametrize("kind", ["pcd", "ply", "rgbd"])
def test_clouds_that_are_there_are_overwritten_only_where_that_is_asked_for(
    recorded: Path, tmp_path: Path, kind: str
) -> None:
    options = [str(recorded), "-o", str(tmp_path / "out"), "--to", kind, "--key", "kinect/points"]
    assert CliRunner().invoke(bag.app, ["export", *options]).exit_code == 0
    for file in (tmp_path / "out").glob("kinect*"):
        file.write_bytes(b"mine")
    told = CliRunner().invoke(bag.app, ["export", *options])
    assert isinstance(told.exception, UsageError)
    assert re.search("is there already: choose another folder, or overwrite with --force$", str(told.exception))
    assert {file.read_bytes() for file in (tmp_path / "out").glob("kinect*")} == {b"mine"}
    assert CliRunner().invoke(bag.app, ["export", *options, "--force"]).exit_code == 0
    assert all(len(file.read_bytes()) > 100 for file in (tmp_path / "out").glob("kinect*"))


@pytest.mark.parametrize("overwrite", [False, True])
def test_clouds_of_one_name_are_counted(tmp_path: Path, overwrite: bool) -> None:
    file = RecordingFile(tmp_path / "a.mcap", "cell", {})
    for number in range(3):
        file.write(sample("cell/kinect/points", cloud(1), START + number, sequence=number + 1))
    file.finish()
    count, left = export(tmp_path / "a.mcap", tmp_path / "pcd", "pcd", overwrite=overwrite)
    assert (count, left) == (1, {"kinect/points: there is a cloud of the same stamp before it": 2})


def test_depth_coded_clouds_are_played_and_exported_as_plain_ones(tmp_path: Path) -> None:
    file = RecordingFile(tmp_path / "coded.mcap", "cell", {}, DepthCoder())
    file.write(sample("cell/kinect/camera_info", camera_info(CAMERA, "eye"), START))
    for number in range(COUNT):
        at = START + 1 + number
        file.write(sample("cell/kinect/points", cloud_from_points(seen(number), Time.from_ns(at), "eye"), at))
        file.write(sample("cell/other/points", cloud(number), at + COUNT, writer=8))  # no depth camera's
    file.finish()
    with McapFile.open(tmp_path / "coded.mcap") as coded:
        kinds = {coded.schemas[c.schema_id].name for c in coded.channels.values()}
        assert "zsight_msgs/msg/DepthCodedCloud" in kinds
        assert len(next(e for e in coded.messages() if "kinect/points" in e.channel.topic).data) < 30 * 40 * 16 / 2
    assert export(tmp_path / "coded.mcap", tmp_path / "plain.mcap", "mcap") == (2 * COUNT + 1, {})
    with McapFile.open(tmp_path / "plain.mcap") as plain:
        kinds = {plain.schemas[c.schema_id].name for c in plain.channels.values()}
    assert kinds == {"sensor_msgs/msg/PointCloud2", "sensor_msgs/msg/CameraInfo"}
    for path in ("coded.mcap", "plain.mcap"):
        recording = open_recording(tmp_path / path)
        messages = [played.load() for played in recording.messages(START + 1, None, recording.lines)]
        clouds = [message for message in messages if isinstance(message, PointCloud2)]
        recording.close()
        assert clouds[COUNT:] == [cloud(n) for n in range(COUNT)]
        for number, message in enumerate(clouds[:COUNT]):
            assert message.header.stamp.ns == START + 1 + number
            np.testing.assert_allclose(xyz(points_of(message)), xyz(seen(number)), atol=1.01e-4)
            np.testing.assert_array_equal(colours(points_of(message)), colours(seen(number)))


def test_a_calibration_that_makes_no_sense_ends_no_recording(tmp_path: Path) -> None:
    info = camera_info(CAMERA, "eye")
    turned = info.model_copy(update={"k": tuple(-number for number in info.k)})
    message = cloud_from_points(seen(0), Time.from_ns(START + 1), "eye")
    file = RecordingFile(tmp_path / "a.mcap", "cell", {}, DepthCoder())
    file.write(sample("cell/kinect/camera_info", turned, START))
    file.write(sample("cell/kinect/points", message, START + 1))
    file.finish()
    recording = open_recording(tmp_path / "a.mcap")
    assert [played.load() for played in recording.messages(START, None, recording.lines)] == [turned, message]
    recording.close()


def test_what_cannot_be_exported_is_refused(recorded: Path, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="expected one of pcd"):
        export(recorded, tmp_path / "x", "las")
    with pytest.raises(UsageError, match="keys with clouds: kinect/points, other/points"):
        export(recorded, tmp_path / "x", "pcd", key="left/points")


def test_a_recording_is_a_cameras_source(recorded: Path) -> None:
    source = open_source(f"{recorded}#kinect/points", frame="unused")
    assert source.frame_id == "eye"
    assert source.rate == pytest.approx(10, rel=0.01)
    assert source.transforms == transform(3.0)
    for _ in range(2):  # a stream that begins again
        clouds = list(source.clouds())
        assert len(clouds) == COUNT
        np.testing.assert_array_equal(xyz(clouds[4]), xyz(seen(4)))
    with pytest.raises(UsageError, match="no clouds on left"):
        open_source(f"{recorded}#left/points", frame="")


@pytest.mark.parametrize("name", ["jsk/watercan.bag"])
def test_a_real_bag_is_a_cameras_source(shared_data: Path, name: str) -> None:
    if not (shared_data / name).is_file():
        pytest.skip(f"no {shared_data / name}")
    source = open_source(str(shared_data / name), frame="")
    (points,) = source.clouds()
    recording = open_recording(shared_data / name)
    line = next(line for line in recording.lines if line.key.endswith("/points"))
    played = next(iter(recording.messages(0, None, [line])))
    message = played.load()
    assert isinstance(message, PointCloud2)
    assert points.tobytes() == bytes(message.data)
    recording.close()
