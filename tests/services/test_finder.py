"""The finder service on clouds of the book's scene: found, late, refused, and said why."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from tests.core import book_scene
from tests.services.running import running
from tests.services.waiting import DEADLINE, soon

from zsight import finder
from zsight.catalogue.type_files import read_type
from zsight.client import CellClient, answer_of
from zsight.convert import cloud_from_points, matrix_of, stamped
from zsight.errors import DeadlinePassed, GoalCancelled, NobodyAnswers, RequestRefused, UsageError
from zsight.explaining import explain
from zsight.hosts.clocks import Clock
from zsight.offline import find_in_file
from zsight.sources import open_source
from zsight_core import find as find_core
from zsight_core import scene as scene_core
from zsight_core.files import pcd
from zsight_core.transform import angle_between, from_rpy
from zsight_protocol.action import GoalState
from zsight_protocol.codec import encode
from zsight_protocol.find_object import Capture, ResultCode, Status
from zsight_protocol.geometry import Region, TransformList
from zsight_protocol.message import Time
from zsight_protocol.object_type import BoxShape, ObjectType, ShapeOf
from zsight_protocol.point_cloud import PointCloud2
from zsight_protocol.scene import Scene

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from zsight.bus import Bus, Reader
    from zsight_core.points import Points

    Join = Callable[[], Bus]

pytestmark = pytest.mark.usefixtures("warm_kernels")

T_WORLD_BLOCK = from_rpy((0.5, -0.35, 0.7922), (0, 0, 0.43))
FRAME = "kinect_pc_frame"


@pytest.fixture(scope="module")
def view() -> tuple[Points, TransformList]:
    """The book's cloud, and where its camera is."""
    source = open_source("book", frame="")
    assert source.transforms is not None
    return next(source.clouds()), source.transforms


class Stage:
    """A running finder, its camera, and a client."""

    def __init__(self, join: Join, view: tuple[Points, TransformList]) -> None:
        self.points, transforms = view
        self.camera = join()
        self.clouds = self.camera.writer(self.camera.cell.points("kinect"), PointCloud2)
        self.camera.writer(self.camera.cell.tf_static, TransformList).send(transforms)
        self.client = CellClient(join())

    def show(self, stamp: Time | None = None, frame: str = FRAME) -> Time:
        """Publish the cloud."""
        stamp = stamp or Time.now()
        self.clouds.send(cloud_from_points(self.points, stamp, frame))
        return stamp


@pytest.fixture
def start(join_memory: Join, view: tuple[Points, TransformList]) -> Iterator[Callable[..., Stage]]:
    """Start a finder with some settings."""
    contexts = []

    def started(**settings: Any) -> Stage:
        stage = Stage(join_memory, view)
        patient = {"oldest": 100, **settings}  # several finds on one cloud, however slow the machine is
        contexts.append(running(finder.run, join_memory(), finder.Settings.model_validate(patient)))
        contexts[-1].__enter__()
        return stage

    yield started
    for context in contexts:
        context.__exit__(None, None, None)


# Found.


def test_the_block_is_found_in_the_world_with_the_clouds_stamp(start: Callable[..., Stage]) -> None:
    stage = start()
    stamp = stage.show()
    result = stage.client.find("toy_block")
    assert (result.code, result.status) == (ResultCode.FOUND, Status.FOUND)
    assert (result.header.stamp, result.header.frame_id, result.finder) == (stamp, "base_link", "finder")
    (block,) = result.objects
    T = matrix_of(block.pose)
    assert np.linalg.norm(T[:3, 3] - T_WORLD_BLOCK[:3, 3]) < 0.001
    turns = [from_rpy((0, 0, 0), (0, b, a)) for a in (0, np.pi) for b in np.arange(4) * np.pi / 2]
    assert min(angle_between(T, T_WORLD_BLOCK @ turn) for turn in turns) < np.radians(0.5)
    assert (block.type, block.code, block.runner_up == "toy_block") == ("toy_block", 1000, False)
    assert block.support is not None
    assert block.support.point.z == pytest.approx(0.7747, abs=0.0005)
    assert block.support.normal.z == pytest.approx(1, abs=1e-4)
    assert result.report["camera"] == "kinect"
    assert result.timings_ms["age_of_cloud"] >= 0


def test_the_answer_is_the_same_place_in_any_frame(start: Callable[..., Stage]) -> None:
    stage = start()
    stage.show()
    world, camera = (stage.client.find("1000", frame=frame) for frame in ("base_link", FRAME))
    assert camera.header.frame_id == FRAME
    source = open_source("book", frame="").transforms
    assert source is not None
    T_world_camera = matrix_of(source.transforms[0].transform) @ matrix_of(source.transforms[1].transform)
    np.testing.assert_allclose(
        T_world_camera @ matrix_of(camera.objects[0].pose), matrix_of(world.objects[0].pose), atol=1e-6
    )


def test_a_camera_that_nobody_placed_answers_in_its_own_frame(start: Callable[..., Stage]) -> None:
    stage = start()
    stage.show(frame="elsewhere")
    result = stage.client.find("toy_block")
    assert (result.status, result.header.frame_id) == (Status.FOUND, "elsewhere")


def test_what_is_not_there_is_not_found(start: Callable[..., Stage]) -> None:
    stage = start()
    stage.show()
    result = stage.client.find("mug", maximum=0)
    assert (result.code, result.status, result.objects) == (ResultCode.NOT_FOUND, Status.NOT_FOUND, ())
    assert 0.5 < result.p_absent <= 1


@pytest.mark.parametrize(
    ("low", "high", "found"),
    [((0.4, -0.45, 0.7), (0.6, -0.25, 0.9), True), ((0.6, -0.2, 0.7), (1.0, 0.2, 0.9), False)],
)
def test_only_the_region_counts(
    start: Callable[..., Stage], low: tuple[float, float, float], high: tuple[float, float, float], found: bool
) -> None:
    stage = start()
    stage.show()
    assert bool(stage.client.find("toy_block", region=Region(low=low, high=high)).objects) is found


def test_of_a_region_that_is_not_in_view_nothing_is_claimed(start: Callable[..., Stage]) -> None:
    stage = start()
    stage.show()
    result = stage.client.find("toy_block", region=Region(low=(5.0, 5.0, 5.0), high=(6.0, 6.0, 6.0)))
    assert (result.status, result.p_absent) == (Status.CANNOT_TELL, 0.0)
    assert "nothing was measured between (5.0, 5.0, 5.0) and (6.0, 6.0, 6.0) of base_link" in result.message


def test_of_a_region_that_is_not_in_view_nothing_is_claimed_in_a_file_either(tmp_path: Path) -> None:
    pcd.write(tmp_path / "book.pcd", book_scene.cloud())
    region = Region(low=(5.0, 5.0, 5.0), high=(6.0, 6.0, 6.0))
    result = find_in_file(tmp_path / "book.pcd", "toy_block", region=region)
    assert (result.status, result.p_absent) == (Status.CANNOT_TELL, 0.0)
    assert "nothing was measured between" in result.message


def test_why_says_nothing_of_absence_where_nothing_was_measured(start: Callable[..., Stage]) -> None:
    stage = start()
    stage.show()
    stage.client.find("toy_block", region=Region(low=(5.0, 5.0, 5.0), high=(6.0, 6.0, 6.0)))
    words = "".join(explain(update) for update in stage.client.results())
    assert "nothing was measured between" in words
    assert "absence" not in words


def test_the_answer_says_what_it_was_made_of(start: Callable[..., Stage]) -> None:
    stage = start()
    stamp = stage.show()
    report = stage.client.find("mug").report
    assert (report["object_type"], report["camera"], report["stamp_ns"]) == ("mug", "kinect", stamp.ns)
    assert report["transforms"] == [
        {"parent": "kinect_link", "child": "kinect_pc_frame", "static": True},
        {"parent": "base_link", "child": "kinect_link", "static": True},
    ]


def test_a_known_height_is_used(start: Callable[..., Stage]) -> None:
    stage = start()
    stage.show()
    (block,) = stage.client.find("toy_block", known_height=0.7747).objects
    assert block.pose.position.z == pytest.approx(0.7922, abs=0.001)


def test_a_known_height_is_one_in_the_frame_of_the_answer(start: Callable[..., Stage]) -> None:
    stage = start()
    raised = stamped(from_rpy((0.3, 0.1, 0.5), (0, 0, 1.0)), "base_link", "base_raised", Time())
    stage.camera.writer(stage.camera.cell.tf_static, TransformList).send(TransformList(transforms=(raised,)))
    stage.show()
    assert soon(lambda: _knows_frame(stage.client, "base_raised"))
    (block,) = stage.client.find("toy_block", frame="base_raised", known_height=0.2747).objects
    assert block.pose.position.z == pytest.approx(0.2922, abs=0.001)
    assert stage.client.find("toy_block", frame="base_raised", known_height=0.7747).objects == ()


def test_a_known_height_in_a_frame_that_is_not_upright_is_refused(start: Callable[..., Stage]) -> None:
    stage = start()
    stage.show()
    with pytest.raises(RequestRefused, match="degrees off the world's: ask in a frame that stands upright"):
        stage.client.find("toy_block", frame=FRAME, known_height=0.7747)


def test_a_known_height_where_no_world_is_known_is_refused(start: Callable[..., Stage]) -> None:
    stage = start()
    stage.show(frame="elsewhere")
    with pytest.raises(RequestRefused, match="which way is up in elsewhere is not known"):
        stage.client.find("toy_block", known_height=0.7747)


def test_goals_on_one_cloud_share_its_scene(start: Callable[..., Stage], monkeypatch: pytest.MonkeyPatch) -> None:
    understood = []
    whole = scene_core.understand

    def counted(*arguments: Any, **options: Any) -> scene_core.Scene:
        understood.append(1)
        return whole(*arguments, **options)

    monkeypatch.setattr(scene_core, "understand", counted)
    stage = start()
    stage.show()
    for name in ("toy_block", "table_surface", "toy_block"):
        assert stage.client.find(name).objects
    assert len(understood) == 1
    stage.show()
    assert soon(lambda: bool(stage.client.find("toy_block").objects) and len(understood) == 2)


def test_millimetres_are_told(start: Callable[..., Stage]) -> None:
    stage = start()
    for axis in "xyz":
        stage.points = stage.points.copy()
        stage.points[axis] *= 1000
    stage.show()
    result = stage.client.find("toy_block", timeout=60)
    assert (result.status, result.objects) == (Status.CANNOT_TELL, ())
    assert "these look like millimetres: divide by 1000" in result.message


def test_a_cloud_without_rows_is_searched(start: Callable[..., Stage]) -> None:
    stage = start()
    scenes = stage.client.bus.reader(stage.client.bus.cell.scene("kinect"), Scene)
    seen = stage.points[np.isfinite(stage.points["z"])]
    stage.points = np.random.default_rng(0).permutation(seen).reshape(1, -1)
    stage.show()
    (block,) = stage.client.find("toy_block", timeout=60).objects
    assert matrix_of(block.pose)[:3, 3] == pytest.approx(T_WORLD_BLOCK[:3, 3], abs=0.003)
    assert taken(scenes).labels is None


def test_a_broken_mesh_in_the_folder_stops_no_finder(
    start: Callable[..., Stage], tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "part.yaml").write_text("name: part\nshape:\n  mesh: {file: part.stl}\n")
    (tmp_path / "part.stl").write_bytes(b"this is no mesh")
    stage = start(catalogue=str(tmp_path))
    stage.show()
    assert stage.client.find("toy_block", timeout=60).objects
    assert "object type part cannot be found" in caplog.text
    assert "part.stl" in stage.client.find("part").message


# The scene.


def test_a_scene_is_published_once_a_cloud_and_again_when_a_find_explains_it(start: Callable[..., Stage]) -> None:
    stage = start(scene_rate=0)
    scenes = stage.client.bus.reader(stage.client.bus.cell.scene("kinect"), Scene)
    stamp = stage.show()
    stage.client.find("coke_can")
    first = taken(scenes)
    stage.client.find("toy_block")
    second = taken(scenes)
    for scene in (first, second):
        assert (scene.header.stamp, scene.header.frame_id, scene.finder) == (stamp, FRAME, "finder")
        assert scene.supports[0].height == pytest.approx(0.7747, abs=0.0005)
    assert [segment.type for segment in first.segments if segment.support == 0] == [""]
    assert [segment.type for segment in second.segments if segment.support == 0] == ["toy_block"]
    for name in ("coke_can", "toy_block"):
        stage.client.find(name)
    after = stage.show()
    assert soon(lambda: stage.client.find("coke_can").header.stamp == after)
    assert taken(scenes).header.stamp == after
    assert scenes.counter.received == 3


def test_a_scene_is_published_without_a_goal(start: Callable[..., Stage]) -> None:
    stage = start(scene_rate=100)
    scenes = stage.client.bus.reader(stage.client.bus.cell.scene("kinect"), Scene)
    stamp = stage.show()
    assert taken(scenes).header.stamp == stamp


def test_a_cloud_without_data_ends_no_scenes(start: Callable[..., Stage], caplog: pytest.LogCaptureFixture) -> None:
    stage = start(scene_rate=100)
    scenes = stage.client.bus.reader(stage.client.bus.cell.scene("kinect"), Scene)
    good, stage.points = stage.points, stage.points.copy()
    stage.points["z"] = np.nan
    stage.show()
    assert soon(lambda: "no scene of the cloud" in caplog.text)
    stage.points = good
    stamp = stage.show()
    assert taken(scenes).header.stamp == stamp


def test_a_bug_is_logged_and_ends_no_scenes(
    start: Callable[..., Stage], monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    stage = start(scene_rate=100)
    scenes = stage.client.bus.reader(stage.client.bus.cell.scene("kinect"), Scene)
    with monkeypatch.context() as broken:
        broken.setattr(scene_core, "understand", lambda *_, **__: int("no number"))
        stage.show()
        assert soon(lambda: "no scene of the cloud" in caplog.text)
        assert caplog.records[-1].exc_info is not None
    stamp = stage.show()
    assert taken(scenes).header.stamp == stamp


# The same again.


def test_the_same_cloud_gives_the_same_answer_bit_for_bit(start: Callable[..., Stage]) -> None:
    """From two finders, each asked twice: all bytes of the answer but its finder and how long things took."""
    stage, _ = start(name="one"), start(name="two")
    stamp, answers = stage.show(), set()
    for name in ("one", "two", "one", "two"):
        result = stage.client.find("any", finder=name, maximum=0, timeout=60)
        assert (result.header.stamp, result.finder) == (stamp, name)
        answers.add(encode(result.model_copy(update={"timings_ms": {}, "finder": ""})))
    assert len(answers) == 1


# Followed.


def shifted(points: Points, metres: float) -> Points:
    """The cloud as if the camera had moved sideways by so much."""
    moved = points.copy()
    moved["x"] += np.float32(metres)
    return moved


def test_an_object_keeps_its_name_while_it_moves_a_little(start: Callable[..., Stage]) -> None:
    stage = start()
    first = stage.points
    names = []
    for metres in (0.0, 0.05, 0.1, 0.4):
        stage.points = shifted(first, metres)
        stamp = stage.show()
        assert soon(lambda stamp=stamp: stage.client.find("table_surface").header.stamp == stamp)  # type: ignore[misc]  # bound now
        (block,) = stage.client.find("toy_block").objects
        names.append(block.id)
    assert names == ["toy_block-1", "toy_block-1", "toy_block-1", "toy_block-2"]


def test_all_types_at_once_and_what_is_not_known(start: Callable[..., Stage]) -> None:
    stage = start()
    stage.show()
    everything = stage.client.find("any", maximum=0, timeout=60)
    assert {found.type for found in everything.objects} == {"table_surface", "toy_block"}
    labels = {obstacle.label for obstacle in everything.obstacles}
    nothing = stage.client.find("mug", timeout=60)
    assert nothing.objects == ()
    T_world_box = [matrix_of(o.pose) for o in nothing.obstacles if o.label not in labels and o.label]
    (block,) = T_world_box
    assert block[:2, 3] == pytest.approx(T_WORLD_BLOCK[:2, 3], abs=0.03)


def test_the_cameras_own_doubt_is_told_apart(start: Callable[..., Stage]) -> None:
    stage = start(extrinsic_position=0.003, extrinsic_rotation=0.0)
    stage.show()
    (block,) = stage.client.find("toy_block").objects
    assert block.covariance_world is not None
    assert block.covariance_support is not None
    world, own = (np.reshape(c, (6, 6)) for c in (block.covariance_world, block.covariance))
    np.testing.assert_allclose(world - own, np.diag([9e-6, 9e-6, 9e-6, 0, 0, 0]), atol=1e-12)
    assert np.trace(np.reshape(block.covariance_support, (6, 6))) == pytest.approx(np.trace(own))
    (seen,) = stage.client.find("toy_block", frame=FRAME).objects
    assert seen.covariance_world == seen.covariance


# Taught.


def test_a_thing_is_taught_and_then_found(start: Callable[..., Stage], tmp_path: Path) -> None:
    stage = start(catalogue=str(tmp_path))
    stamp = stage.show()
    stage.client.catalog.remove("toy_block")
    kind, taught = stage.client.catalog.teach("bar", code=4711, notes="Red.")
    assert kind.shape.box is not None
    assert sorted(kind.shape.box.size) == pytest.approx([0.035, 0.035, 0.2], abs=0.0005)
    assert kind.colour is not None
    assert max(kind.colour) == kind.colour[0]
    assert (taught.header.stamp, taught.header.frame_id) == (stamp, "base_link")
    assert matrix_of(taught.pose)[:3, 3] == pytest.approx(T_WORLD_BLOCK[:3, 3], abs=0.0005)
    assert taught.picture.startswith(b"\x89PNG")
    assert read_type(tmp_path / "bar.yaml") == kind
    (found,) = stage.client.find("4711").objects
    assert found.type == "bar"
    assert matrix_of(found.pose)[:3, 3] == pytest.approx(T_WORLD_BLOCK[:3, 3], abs=0.0005)


def test_a_type_that_is_taught_again_keeps_what_else_is_known_of_it(start: Callable[..., Stage]) -> None:
    stage = start()
    stage.show()
    catalog = stage.client.catalog
    known = catalog.get("toy_block").model_copy(update={"properties": {"mass": 0.15}, "grasps": ({"width": 0.04},)})
    catalog.add(known)
    taught, _ = catalog.teach("toy_block", notes="Measured.")
    assert taught == catalog.get("toy_block")
    assert (taught.version, taught.code, taught.notes) == (3, known.code, "Measured.")
    assert (taught.properties, taught.grasps) == (known.properties, known.grasps)
    assert taught.shape != known.shape


def test_what_is_only_measured_is_not_kept(start: Callable[..., Stage]) -> None:
    stage = start()
    stage.show()
    place = (0.5, -0.35, 0.79)
    assert stage.client.catalog.teach("bar", place=place, shape="box", keep=False)[0].shape.box is not None
    with pytest.raises(RequestRefused):
        stage.client.catalog.get("bar")


def test_without_a_cloud_nothing_is_taught(start: Callable[..., Stage]) -> None:
    with pytest.raises(RequestRefused, match="no cloud comes on test/kinect/points"):
        start(oldest=0.05).client.catalog.teach("bar")


def test_what_makes_no_type_is_told(start: Callable[..., Stage]) -> None:
    stage = start()
    stage.show()
    teach = stage.client.catalog.teach
    with pytest.raises(RequestRefused, match=r"nothing is at \(0.800, 0.000, 0.800\): .* things stand there, at \(0.4"):
        teach("bar", place=(0.8, 0.0, 0.8))
    with pytest.raises(RequestRefused, match="no shape explains the thing"):
        teach("bar", place=(0.5, -0.35, 0.79), shape="sphere")
    with pytest.raises(RequestRefused, match="this finder reads camera kinect, not other"):
        teach("bar", camera="other")
    with pytest.raises(UsageError):
        teach("Bar")
    with pytest.raises(UsageError):
        teach("bar", shape="cone")


def taken(scenes: Reader[Scene]) -> Scene:
    received = scenes.take(DEADLINE)
    assert received is not None
    return received.message


def test_types_are_told_while_the_finder_starts(join_memory: Join, monkeypatch: pytest.MonkeyPatch) -> None:
    warm, bus = threading.Event(), join_memory()
    monkeypatch.setattr(find_core, "warm_up", lambda: warm.wait(DEADLINE))
    starting = threading.Thread(target=finder.run, args=(bus, finder.Settings()))
    starting.start()
    client = CellClient(join_memory())
    assert soon(lambda: _knows_types(client))
    assert "toy_block" in [kind.name for kind in client.catalog.list()]
    with pytest.raises(NobodyAnswers, match="is the service running"):
        client.find("toy_block")
    warm.set()
    bus.stop()
    starting.join()


def _knows_frame(client: CellClient, frame: str) -> bool:
    try:
        return client.find("table_surface", frame=frame).header.frame_id == frame
    except RequestRefused:
        return False


def _knows_types(client: CellClient) -> bool:
    try:
        return bool(client.catalog.list())
    except NobodyAnswers:
        return False


# Late, or not at all.


def test_no_camera_is_told(start: Callable[..., Stage]) -> None:
    result = start(oldest=0.05).client.find("toy_block")
    assert (result.status, result.objects) == (Status.CANNOT_TELL, ())
    assert "no cloud has come on test/kinect/points: is the camera running?" in result.message


def test_a_camera_that_stopped_is_told(start: Callable[..., Stage]) -> None:
    stage = start(oldest=0.05)
    stage.show()
    assert soon(lambda: "the newest cloud on test/kinect/points came" in stage.client.find("toy_block").message)


def test_a_new_cloud_is_waited_for(start: Callable[..., Stage]) -> None:
    stage = start(oldest=30)
    old = stage.show()
    assert stage.client.find("toy_block").header.stamp == old
    call = stage.client.start_find("toy_block", capture=Capture.NEW)
    assert any(update.stage == "cloud" for update in call)
    new = stage.show()
    final = call.wait()
    assert final.result is not None
    assert final.result.header.stamp == new


def test_a_new_cloud_that_never_comes_is_told(start: Callable[..., Stage]) -> None:
    stage = start(oldest=0.05)
    stage.show()  # it may come after the first question, and is no new one for the second
    words = "has the camera stopped?"
    assert soon(lambda: words in stage.client.find("toy_block", capture=Capture.NEW).message)


def test_a_new_cloud_with_an_old_stamp_is_told(start: Callable[..., Stage]) -> None:
    stage = start(oldest=0.3)
    call = stage.client.start_find("toy_block", capture=Capture.NEW)
    assert any(update.stage == "cloud" for update in call)
    stage.show(Time.from_ns(Time.now().ns - 5 * 10**9))  # as a camera does whose clock is behind
    final = call.wait()
    assert final.result is not None
    assert "s before the question by its stamp: do the hosts' clocks agree?" in final.result.message


def test_a_goal_that_waits_for_the_scene_of_another_can_be_cancelled(
    start: Callable[..., Stage], monkeypatch: pytest.MonkeyPatch
) -> None:
    began, go_on, whole = threading.Event(), threading.Event(), scene_core.understand

    def slow(*arguments: Any, **options: Any) -> scene_core.Scene:
        began.set()
        assert go_on.wait(DEADLINE)
        return whole(*arguments, **options)

    monkeypatch.setattr(scene_core, "understand", slow)
    stage = start(parallel=2)
    stage.show()
    first = stage.client.start_find("toy_block")
    assert began.wait(DEADLINE)
    second = stage.client.start_find("toy_block")
    assert any(update.stage == "scene" for update in second)
    second.cancel()
    assert second.wait().state is GoalState.CANCELLED
    go_on.set()
    assert first.wait().state is GoalState.SUCCEEDED


def test_a_clock_that_is_off_is_told_in_every_answer(
    start: Callable[..., Stage], monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(finder, "_CLOCKS_EVERY", 0.01)
    monkeypatch.setattr(finder, "ask_clocks", lambda _: [Clock("attic", 0.1, 0.001), Clock("desk", 0.01, 0.001)])
    stage = start()
    stage.show()
    expected = [Clock("attic", 0.1, 0.001).warning]
    assert soon(lambda: stage.client.find("toy_block").report["warnings"] == expected)
    assert [record.getMessage() for record in caplog.records].count(expected[0]) == 1


def test_the_deadline_is_kept(start: Callable[..., Stage]) -> None:
    with pytest.raises(DeadlinePassed):
        start(oldest=30).client.find("toy_block", timeout=0.001)


def test_what_was_found_before_the_deadline_is_told(
    start: Callable[..., Stage], monkeypatch: pytest.MonkeyPatch
) -> None:
    find = find_core.find

    def overtaken(*arguments: Any, checkpoint: Any, on_found: Any, **options: Any) -> Any:
        def found(detection: Any) -> None:
            on_found(detection)
            checkpoint._checkpoint.__self__.deadline = 0.0  # the goal's
            checkpoint("verify", 1.0)

        return find(*arguments, checkpoint=checkpoint, on_found=found, **options)

    monkeypatch.setattr(find_core, "find", overtaken)
    stage = start(oldest=30)
    stage.show()
    with pytest.raises(DeadlinePassed) as late:
        stage.client.find("any", maximum=0)
    assert late.value.known is not None
    assert [found.type for found in late.value.known.objects] == ["toy_block"]


def test_an_answer_that_is_ready_is_not_lost_to_the_deadline(
    start: Callable[..., Stage], monkeypatch: pytest.MonkeyPatch
) -> None:
    handles: list[Any] = []
    execute, whole = finder.FindObject.execute, scene_core.understand

    def kept(work: finder.FindObject, handle: Any) -> Any:
        handles.append(handle)
        return execute(work, handle)

    def overtaken(points: Points, *, T_world_camera: Any = None, **options: Any) -> scene_core.Scene:
        if T_world_camera is None:  # a second look, at what may be wrong with the camera's pose
            handles[-1].deadline = 0.0
        return whole(points, T_world_camera=T_world_camera, **options)

    monkeypatch.setattr(finder.FindObject, "execute", kept)
    monkeypatch.setattr(scene_core, "understand", overtaken)
    stage = start(oldest=30)
    stage.show()
    result = stage.client.find("mug")
    assert (result.status, result.deadline_passed) == (Status.NOT_FOUND, False)


def test_progress_does_not_go_back_where_nothing_is_found(start: Callable[..., Stage]) -> None:
    stage = start()
    stage.show()
    fractions: list[float] = []
    stage.client.find("mug", on_update=lambda update: fractions.append(update.fraction))
    assert fractions == sorted(fractions)


def test_a_goal_that_waits_for_its_cloud_can_be_cancelled(start: Callable[..., Stage]) -> None:
    stage = start(oldest=30)
    call = stage.client.start_find("toy_block", finder="finder")
    assert any(update.stage == "cloud" for update in call)
    call.cancel()
    final = call.wait()
    assert final.result is not None
    assert final.result.message == "cancelled at stage cloud"
    with pytest.raises(GoalCancelled):
        answer_of(final)


# Refused.


def test_an_unknown_type_is_refused_with_the_nearest_name(start: Callable[..., Stage]) -> None:
    with pytest.raises(RequestRefused, match="did you mean toy_block"):
        start().client.find("toy_blok")


def test_an_unknown_frame_is_told_with_those_that_are_known(start: Callable[..., Stage]) -> None:
    stage = start()
    stage.show()
    with pytest.raises(RequestRefused, match="'mars': known are base_link, kinect_link, kinect_pc_frame"):
        stage.client.find("toy_block", frame="mars")
    with pytest.raises(RequestRefused, match="did you mean base_link"):
        stage.client.find("toy_block", frame="base_lnk")


def test_a_cloud_without_data_is_told(start: Callable[..., Stage], view: tuple[Points, TransformList]) -> None:
    stage = start()
    stage.points = view[0].copy()
    for axis in "xyz":
        stage.points[axis] = np.nan
    stage.show()
    result = stage.client.find("toy_block")
    assert (result.status, result.objects) == (Status.CANNOT_TELL, ())
    assert "finite" in result.message


def test_another_finder_is_not_there(start: Callable[..., Stage]) -> None:
    with pytest.raises(NobodyAnswers, match="find_object/other"):
        start().client.find("toy_block", finder="other")


def test_a_type_that_was_just_added_is_found(start: Callable[..., Stage], tmp_path: Path) -> None:
    stage = start(catalogue=str(tmp_path))
    stage.show()
    bar = ObjectType(name="bar", code=4711, shape=ShapeOf(box=BoxShape(size=(0.2, 0.035, 0.035))))
    stage.client.catalog.remove("toy_block")
    stage.client.catalog.add(bar)
    result = stage.client.find("4711")
    assert [found.type for found in result.objects] == ["bar"]
    assert result.objects[0].code == 4711
