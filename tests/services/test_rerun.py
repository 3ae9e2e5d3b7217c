"""Answers of a recording once more; the smallest file that reproduces one; the finder after a seek."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import pytest
from tests.services.recorded_answers import Recorded, find_in, record
from tests.services.running import running
from tests.services.waiting import soon

from zsight import finder
from zsight.catalogue import type_files
from zsight.client import CellClient
from zsight.errors import UsageError
from zsight.recording import player
from zsight.recording.answers import answers
from zsight.recording.bundle import bundle
from zsight.recording.mcap_copy import Part, copy
from zsight.recording.opening import open_recording
from zsight.recording.rerun import Tolerance, _find_again, compare, rerun
from zsight.recording.rerun_process import RerunProcess
from zsight.recording_client import PlayerClient
from zsight_core.scene_limits import SceneLimits
from zsight_protocol.geometry import Point

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from zsight.bus import Bus
    from zsight_protocol.find_object import DetectedObject, FindObjectResult

    Join = Callable[[], Bus]

pytestmark = pytest.mark.usefixtures("warm_kernels")


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    """Made once."""
    from zsight.bus import Bus
    from zsight.bus.memory_link import MemoryLink, MemoryNetwork
    from zsight_protocol.channels import Cell

    network = MemoryNetwork()
    return record(lambda: Bus(MemoryLink(network), Cell("test")), tmp_path_factory.mktemp("answers") / "a.mcap")


def types() -> type_files.Catalogue:
    return type_files.load(type_files.shipped_folder())


def test_every_goal_is_searched_again_and_nothing_has_changed(recorded: Recorded) -> None:
    rows = rerun(recorded.path, types())
    assert {row["stamp_ns"] for row in rows} == {result.header.stamp.ns for result in recorded.results}
    for row in rows:
        assert (row["object_type"], row["then"], row["now"], row["regression"]) == ("toy_block", "found", "found", "")
        assert row["moved_mm"] < 1e-6
        assert row["ms_then"] > 0


def test_a_known_height_is_taken_as_the_finder_takes_it(recorded: Recorded) -> None:
    recording = open_recording(recorded.path)
    answer = next(iter(answers(recording)))
    asked = replace(answer, goal=answer.goal.model_copy(update={"known_height": 0.7747}))
    assert _find_again(asked, types(), SceneLimits()).objects
    tilted = replace(asked, result=asked.result.model_copy(update={"header": asked.cloud.header}))
    with pytest.raises(UsageError, match="degrees off the world's"):
        _find_again(tilted, types(), SceneLimits())
    recording.close()


def test_settings_that_are_tried_change_the_answers(recorded: Recorded) -> None:
    heard: list[tuple[dict[str, Any], float]] = []
    rows = rerun(
        recorded.path, types(), limits=SceneLimits(lowest=0.1), say=lambda row, share: heard.append((row, share))
    )
    assert {row["regression"] for row in rows} == {"1 of 1 are found no more"}  # the block is 35 mm high
    assert [(row["segments_then"], row["segments_now"]) for row in rows] == [(2, 0)] * len(rows)
    assert [row for row, _ in heard] == rows
    shares = [share for _, share in heard]
    assert shares == sorted(shares)
    assert 0 < shares[0] < shares[-1] <= 1


def ended(process: RerunProcess) -> bool:
    process.look()
    return process.ended


def test_a_run_in_a_process_of_its_own_gives_the_same(recorded: Recorded) -> None:
    process = RerunProcess(recorded.path)
    process.start((), SceneLimits())
    assert soon(lambda: ended(process), 120)
    assert process.error == ""
    untimed = [{name: value for name, value in row.items() if name != "ms_now"} for row in process.rows]
    assert untimed == [
        {name: value for name, value in row.items() if name != "ms_now"} for row in rerun(recorded.path, types())
    ]
    assert process.share > 0.5


def test_a_run_is_cancelled_and_its_process_ends(recorded: Recorded) -> None:
    process = RerunProcess(recorded.path)
    process.start((), SceneLimits())
    process.cancel()
    assert (process.ended, process.error) == (True, "cancelled")
    assert not process._process.is_alive()
    assert not process.look()


def test_a_run_over_what_is_no_recording_says_so(tmp_path: Path) -> None:
    (tmp_path / "no.mcap").write_bytes(b"no recording")
    process = RerunProcess(tmp_path / "no.mcap")
    process.start((), SceneLimits())
    assert soon(lambda: ended(process), 120)
    assert "no.mcap" in process.error
    assert process.rows == []


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


def test_settings_that_change_no_answer_are_refused_by_name() -> None:
    from zsight.cli.bag import _tried

    assert _tried(["lowest=0.01", "smallest=100"]) == SceneLimits(lowest=0.01, smallest=100)
    with pytest.raises(UsageError, match="queue changes no answer"):
        _tried(["queue=3"])
    with pytest.raises(UsageError, match="lowest is '9'"):
        _tried(["lowest=9"])
