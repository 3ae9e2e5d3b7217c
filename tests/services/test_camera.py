"""The camera service: what it publishes, in which order and how fast."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from tests.services.running import running
from tests.services.waiting import DEADLINE, Arrivals

from zsight import camera
from zsight.convert import points_of
from zsight.errors import UsageError
from zsight_core.files import pcd
from zsight_core.points import from_xyz
from zsight_protocol.camera_info import CameraInfo
from zsight_protocol.channels import Delivery
from zsight_protocol.geometry import TransformList
from zsight_protocol.message import Time
from zsight_protocol.point_cloud import PointCloud2

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from zsight.bus import Bus

    Join = Callable[[], Bus]


pytestmark = pytest.mark.usefixtures("warm_kernels")


def files(folder: Path, *numbers: int) -> str:
    for number in numbers:
        pcd.write(folder / f"{number}.pcd", from_xyz(np.full((1, 2, 3), number)))
    return str(folder)


def watch(bus: Bus, name: str) -> Arrivals[PointCloud2]:
    """Every cloud of a camera, none superseded."""
    clouds: Arrivals[PointCloud2] = Arrivals()
    reader = bus.reader(bus.cell.points(name), PointCloud2, delivery=Delivery.EVERY)

    def follow() -> None:
        for cloud in reader:
            clouds.add(cloud)

    threading.Thread(target=follow, daemon=True).start()
    return clouds


def numbers(clouds: list[PointCloud2]) -> list[int]:
    return [int(points_of(cloud)["x"][0, 0]) for cloud in clouds]


def test_a_folder_comes_in_order_and_again(join_memory: Join, tmp_path: Path) -> None:
    sender, receiver = join_memory(), join_memory()
    clouds = watch(receiver, "left")
    settings = camera.Settings(camera="left", source=files(tmp_path, 10, 2, 1), rate=1000)
    before = Time.now().ns
    with running(camera.run, sender, settings):
        came = clouds.wait(7)[:7]
    assert numbers(came) == [1, 2, 10, 1, 2, 10, 1]
    stamps = [cloud.header.stamp.ns for cloud in came]
    assert before <= stamps[0]
    assert stamps == sorted(set(stamps))
    assert {cloud.header.frame_id for cloud in came} == {"left_optical_frame"}


def test_without_loop_it_ends_after_the_last(join_memory: Join, tmp_path: Path) -> None:
    sender, receiver = join_memory(), join_memory()
    clouds = watch(receiver, "kinect")
    camera.run(sender, camera.Settings(source=files(tmp_path, 1, 2), rate=1000, loop=False, frame="eye"))
    assert numbers(clouds.wait(2)) == [1, 2]
    assert clouds.all[0].header.frame_id == "eye"


def test_a_file_that_went_bad_is_passed_over_and_told(
    join_memory: Join, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    sender, receiver = join_memory(), join_memory()
    clouds = watch(receiver, "kinect")
    source = files(tmp_path, 1, 2, 3)
    (tmp_path / "2.pcd").write_bytes(b"VERSION 0.7\n")
    camera.run(sender, camera.Settings(source=source, rate=1000, loop=False))
    assert numbers(clouds.wait(2)) == [1, 3]
    assert "passed over: " in caplog.text
    assert "2.pcd" in caplog.text


def test_a_late_reader_learns_where_the_camera_is_and_how_it_projects(join_memory: Join) -> None:
    sender, receiver = join_memory(), join_memory()
    with running(camera.run, sender, camera.Settings(source="book", rate=100)):
        info = receiver.reader(receiver.cell.camera_info("kinect"), CameraInfo).take(DEADLINE)
        places = receiver.reader(receiver.cell.tf_static, TransformList).take(DEADLINE)
        cloud = receiver.reader(receiver.cell.points("kinect"), PointCloud2).take(DEADLINE)
    assert info is not None
    assert places is not None
    assert cloud is not None
    assert (info.message.width, info.message.height) == (640, 480)
    assert [step.child_frame_id for step in places.message.transforms] == ["kinect_link", "kinect_pc_frame"]
    assert (cloud.message.width, cloud.message.height) == (640, 480)
    assert cloud.message.header.frame_id == info.message.header.frame_id == "kinect_pc_frame"


def test_a_source_that_is_none_is_refused(join_memory: Join) -> None:
    with pytest.raises(UsageError, match="boook"):
        camera.run(join_memory(), camera.Settings(source="boook"))


# Pace, by a clock of the test's own.


class Clock:
    """A clock that only goes on when somebody waits or works."""

    def __init__(self, bus: Bus) -> None:
        self.now = 0.0
        self.bus = bus
        bus.stopping.wait = self.wait  # type: ignore[method-assign]  # what the camera waits with

    def monotonic(self) -> float:
        return self.now

    def wait(self, timeout: float | None = None) -> bool:
        self.now += timeout or 0.0
        return self.bus.stopping.is_set()


@pytest.fixture
def clock(bus: Bus, monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock(bus)
    monkeypatch.setattr("zsight.camera.time", clock)
    return clock


def worked(clock: Clock, seconds: list[float]) -> Iterator[Any]:
    """Clouds that take so long to make."""
    for duration in seconds:
        clock.now += duration
        yield None


def test_clouds_come_at_their_rate(clock: Clock) -> None:
    times = [clock.now for _ in camera._paced(worked(clock, [0.0, 0.03, 0.09, 0.0]), lambda: 10, clock.bus)]
    assert times == pytest.approx([0.0, 0.1, 0.2, 0.3])


def test_a_slow_cloud_shifts_the_others_and_none_is_crowded(clock: Clock) -> None:
    times = [clock.now for _ in camera._paced(worked(clock, [0.0, 0.35, 0.0, 0.0]), lambda: 10, clock.bus)]
    assert times == pytest.approx([0.0, 0.35, 0.45, 0.55])


def test_a_new_rate_holds_before_the_next_cloud(clock: Clock) -> None:
    times = [
        clock.now for _ in camera._paced(worked(clock, [0.0] * 3), lambda: 0.01 if clock.now < 5 else 1, clock.bus)
    ]
    assert times[0] == 0.0
    assert times[1] == pytest.approx(5.0, abs=0.11)
    assert times[2] - times[1] == pytest.approx(1.0)


def test_stop_ends_the_wait(clock: Clock) -> None:
    times = []
    for _ in camera._paced(worked(clock, [0.0] * 5), lambda: 10, clock.bus):
        times.append(clock.now)
        if len(times) == 2:
            clock.bus.stop()
    assert len(times) == 2
