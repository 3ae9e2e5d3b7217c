"""Answers of a recording once more; the smallest file that reproduces one; the finder after a seek."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest
from tests.core.book_scene import T_WORLD_CAMERA, TOY_BLOCK, at
from tests.core.book_scene import cloud as book_cloud
from tests.services.running import running
from tests.services.waiting import soon

from zsight import finder, object_catalogue
from zsight.client import CellClient
from zsight.convert import cloud_from_points, stamped
from zsight.errors import UsageError
from zsight.recording import player, recorder
from zsight.recording.bundle import bundle
from zsight.recording.mcap_copy import Part, copy
from zsight.recording.rerun import Tolerance, compare, rerun
from zsight.recording_client import PlayerClient, RecorderClient
from zsight_core.transform import from_rpy
from zsight_protocol.geometry import Point, TransformList
from zsight_protocol.message import Time
from zsight_protocol.point_cloud import PointCloud2

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from zsight.bus import Bus
    from zsight_protocol.find_object import DetectedObject, FindObjectResult

    Join = Callable[[], Bus]

pytestmark = pytest.mark.usefixtures("warm_kernels")

PLACES = (0.45, 0.55, 0.65)
FRAME = "kinect_pc_frame"


class Recorded:
    """A recording, and the answers that were given while it was made."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.results: list[FindObjectResult] = []


def find_in(client: CellClient, stamp: Time) -> FindObjectResult:
    """The answer from the cloud of this time, which the finder may not have taken yet."""
    found: list[FindObjectResult] = []

    def found_there() -> bool:
        found[:] = [client.find("toy_block")]
        return found[0].header.stamp == stamp

    assert soon(found_there)
    return found[0]


def record(join: Join, path: Path) -> Recorded:
    """The block at three places, seen by a camera that moves meanwhile; a find at each."""
    made, test = Recorded(path), join()
    clouds = test.writer(test.cell.points("kinect"), PointCloud2)
    moving = test.writer(test.cell.tf, TransformList)
    client, control = CellClient(join()), RecorderClient(test)
    with (
        running(recorder.run, join(), recorder.Settings(folder=str(path.parent), reserve=0.25)),
        running(finder.run, join(), finder.Settings()),
    ):
        began = control.start(str(path))
        for number, x in enumerate(PLACES):
            T = from_rpy((0.01 * number, 0, 0), (0, 0, 0)) @ T_WORLD_CAMERA
            stamp = Time.now()
            moving.send(TransformList(transforms=(stamped(T, "base_link", FRAME, stamp),)))
            points = book_cloud((TOY_BLOCK, at(x, -0.35, 0.7922, 0.3 * number)))
            clouds.send(cloud_from_points(points, stamp, FRAME))
            made.results.append(find_in(client, stamp))
        assert soon(lambda: control.status().messages >= 8)
        assert began.ok
        control.stop()
    return made


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    """Made once."""
    from zsight.bus import Bus
    from zsight.bus.memory_link import MemoryLink, MemoryNetwork
    from zsight_protocol.channels import Cell

    network = MemoryNetwork()
    return record(lambda: Bus(MemoryLink(network), Cell("test")), tmp_path_factory.mktemp("answers") / "a.mcap")


def types() -> object_catalogue.Catalogue:
    return object_catalogue.load(object_catalogue.shipped_folder())


def test_every_goal_is_searched_again_and_nothing_has_changed(recorded: Recorded) -> None:
    rows = rerun(recorded.path, types())
    assert {row["stamp_ns"] for row in rows} == {result.header.stamp.ns for result in recorded.results}
    for row in rows:
        assert (row["object_type"], row["then"], row["now"], row["regression"]) == ("toy_block", "found", "found", "")
        assert row["moved_mm"] < 1e-6
        assert row["ms_then"] > 0


def test_a_type_that_is_gone_is_taken_from_the_recording(recorded: Recorded) -> None:
    without = types()
    without.remove("toy_block")
    assert {row["regression"] for row in rerun(recorded.path, without)} == {""}


def without_ids(result: FindObjectResult) -> list[DetectedObject]:
    """What was found, without the names that tell a thing from others in the finder's memory."""
    return [found.model_copy(update={"id": ""}) for found in result.objects]


def moved(result: FindObjectResult, by: float) -> FindObjectResult:
    (found,) = result.objects
    place = found.pose.position
    pose = found.pose.model_copy(update={"position": Point(x=place.x + by, y=place.y, z=place.z)})
    return result.model_copy(update={"objects": (found.model_copy(update={"pose": pose}),)})


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda result: result, ""),
        (lambda result: moved(result, 0.004), ""),
        (lambda result: moved(result, 0.006), "6.0 mm elsewhere"),
        (lambda result: moved(result, 0.2), "1 of 1 are found no more"),
        (lambda result: result.model_copy(update={"objects": ()}), "1 of 1 are found no more"),
    ],
)
def test_what_is_a_regression(recorded: Recorded, change: Any, words: str) -> None:
    then = recorded.results[0]
    assert compare(then, change(then), Tolerance())["regression"] == words
    nothing = then.model_copy(update={"objects": ()})
    found = compare(nothing, then, Tolerance())
    assert (found["regression"], found["new"], found["lost"]) == ("", 1, 0)


def test_a_bundle_reproduces_the_last_answer_and_is_small(recorded: Recorded, tmp_path: Path) -> None:
    report = bundle(recorded.path, tmp_path / "b.mcap", namespace="test")
    assert report["object_type"] == "toy_block"
    (row,) = rerun(tmp_path / "b.mcap", types())
    assert row["stamp_ns"] == recorded.results[-1].header.stamp.ns
    assert row["regression"] == ""
    assert row["moved_mm"] < 1e-6
    assert (tmp_path / "b.mcap").stat().st_size < recorded.path.stat().st_size / 2


def test_a_recording_without_answers_has_no_bundle(recorded: Recorded, tmp_path: Path) -> None:
    copy([recorded.path], tmp_path / "no.mcap", part=Part(exclude="/goal"))
    with pytest.raises(UsageError, match="does not hold an answer"):
        bundle(tmp_path / "no.mcap", tmp_path / "b.mcap")
    with pytest.raises(UsageError, match="goal 123"):
        bundle(recorded.path, tmp_path / "b.mcap", goal_id="123")


def test_after_a_seek_the_finder_answers_as_in_the_straight_run(recorded: Recorded, join_memory: Join) -> None:
    playing = player.Player(join_memory(), player.Settings(paused=True, exclude="find_object"))
    client, control = CellClient(join_memory()), PlayerClient(join_memory())
    with running(finder.run, join_memory(), finder.Settings()):
        playing.open(str(recorded.path))
        opened = playing._recording
        assert opened is not None
        clouds = [line for line in opened.lines if line.key == "kinect/points"]
        times = [played.log_time for played in opened.messages(opened.start_ns, None, clouds)]
        for number in (2, 0, 1, 0, 2):
            control.seek((times[number] - opened.start_ns + 1000) / 1e9)
            expected = recorded.results[number]
            assert without_ids(find_in(client, expected.header.stamp)) == without_ids(expected)
    playing.close()
