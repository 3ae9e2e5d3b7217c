"""The planes service: a patch goes in; its plane, the plane's points and what stands on it come out."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from tests.services.running import running
from tests.services.waiting import DEADLINE, soon

from zsight import planes
from zsight.client import CellClient
from zsight.convert import cloud_from_points, matrix_of, points_of
from zsight.errors import DeadlinePassed, NobodyAnswers, UsageError
from zsight.patch_plane import plane_of_patch
from zsight_core.points import from_xyz, xyz
from zsight_protocol.message import Time
from zsight_protocol.point_cloud import PointCloud2

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from zsight.bus import Bus
    from zsight_core.points import Points
    from zsight_protocol.geometry import Plane

pytestmark = pytest.mark.usefixtures("warm_kernels")

NORMAL = np.array([0.0, -0.8, -0.6])
DISTANCE = -0.9
BOX = (slice(20, 30), slice(30, 40))
GAP = 60  # image column without data, right of which the floor goes on
STAMP = Time(sec=5, nanosec=6)


def floor(box: float = 0.05) -> Points:
    """A floor seen by a tilted camera, with a box of 5 cm on it and a strip without data."""
    v, u = np.mgrid[0:60, 0:80]
    rays = np.stack([(u - 39.5) / 60, (v - 29.5) / 60, np.ones(u.shape)], axis=-1)
    height = np.zeros(u.shape)
    height[BOX] = box
    points = rays * ((DISTANCE + height) / (rays @ NORMAL))[..., np.newaxis]
    points[:, GAP : GAP + 4] = np.nan
    return from_xyz(points)


def message(points: Points, frame: str = "eye") -> PointCloud2:
    return cloud_from_points(points, STAMP, frame)


class Cell:
    """A running planes service with a cloud, and a client."""

    def __init__(self, test: Bus) -> None:
        self.bus = test
        self.client = CellClient(test)
        self.points = test.reader(test.cell.plane_points("kinect"), PointCloud2)
        self.above = test.reader(test.cell.points_above_plane("kinect"), PointCloud2)
        self.clouds = test.writer(test.cell.points("kinect"), PointCloud2)

    def select(self, *patch: slice, frame: str = "eye", timeout: float = DEADLINE) -> Plane:
        return self.client.select(message(floor()[patch], frame), timeout=timeout)


@pytest.fixture
def start(join_memory: Callable[[], Bus]) -> Iterator[Callable[..., Cell]]:
    """Start the service with some settings, and send the floor."""
    contexts = []

    def started(*, cloud: bool = True, **settings: bool | float) -> Cell:
        contexts.append(running(planes.run, join_memory(), planes.Settings.model_validate(settings)))
        contexts[-1].__enter__()
        cell = Cell(join_memory())
        if cloud:
            cell.clouds.send(message(floor()))
        return cell

    yield started
    for context in contexts:
        context.__exit__(None, None, None)


def test_a_patch_of_the_floor_finds_the_floor(start: Callable[..., Cell]) -> None:
    cell = start()
    found = cell.select(slice(40, 50), slice(10, 30))
    np.testing.assert_allclose([found.normal.x, found.normal.y, found.normal.z], NORMAL, atol=1e-5)
    assert found.distance == pytest.approx(DISTANCE, abs=1e-5)
    assert (found.header.stamp, found.header.frame_id) == (STAMP, "eye")
    assert found.inliers == 60 * 76 - 100
    assert found.rms < 5e-4
    T = matrix_of(found.pose)
    np.testing.assert_allclose(T[:3, 2], NORMAL, atol=1e-5)
    patch = xyz(floor()[40:50, 10:30]).reshape(-1, 3)
    np.testing.assert_allclose(T[:3, 3], patch.mean(axis=0), atol=1e-4)


def test_its_points_come_with_it(start: Callable[..., Cell]) -> None:
    cell = start()
    found = cell.select(slice(40, 50), slice(10, 30))
    received = cell.points.take(DEADLINE)
    assert received is not None
    inside = xyz(points_of(received.message)).reshape(-1, 3)
    assert len(inside) == found.inliers
    np.testing.assert_allclose(inside @ NORMAL, DISTANCE, atol=1e-5)
    assert received.message.header.stamp == STAMP


def test_a_patch_that_holds_some_of_the_box_still_finds_the_floor(start: Callable[..., Cell]) -> None:
    found = start().select(slice(25, 50), slice(20, 42))
    np.testing.assert_allclose([found.normal.x, found.normal.y, found.normal.z], NORMAL, atol=1e-4)


def test_a_patch_of_a_thin_thing_on_the_floor_is_not_taken_for_the_floor() -> None:
    points = floor(box=0.004)
    found = plane_of_patch(points, points[BOX])
    assert found.fit.plane.distance == pytest.approx(DISTANCE + 0.004, abs=1e-4)


def test_what_stands_on_the_plane_is_published_where_asked_for(start: Callable[..., Cell]) -> None:
    cell = start(above=True, above_low=0.02, above_high=0.1)
    cell.select(slice(40, 50), slice(10, 30))
    received = cell.above.take(DEADLINE)
    assert received is not None
    standing = xyz(points_of(received.message)).reshape(-1, 3)
    assert len(standing) == 100
    np.testing.assert_allclose(standing @ NORMAL - DISTANCE, 0.05, atol=1e-5)


def test_only_what_is_connected_to_the_patch_where_asked_for(start: Callable[..., Cell]) -> None:
    left = start(connected=True, gap=0.5).select(slice(40, 50), slice(10, 30))
    assert left.inliers == 60 * GAP - 100


def test_the_newest_cloud_counts(start: Callable[..., Cell]) -> None:
    cell = start()
    assert cell.select(slice(40, 50), slice(10, 30)).header.stamp == STAMP
    cell.clouds.send(cloud_from_points(floor(), Time(sec=9), "eye"))
    assert cell.select(slice(40, 50), slice(10, 30)).header.stamp == Time(sec=9)


def test_a_patch_in_another_frame_is_told(start: Callable[..., Cell], caplog: pytest.LogCaptureFixture) -> None:
    cell = start()
    with pytest.raises(DeadlinePassed, match="log of the planes service"):
        cell.select(slice(40, 50), slice(10, 30), frame="world", timeout=0.05)
    assert soon(lambda: "patch is in frame world, the cloud in eye" in caplog.text)


def test_a_patch_without_a_plane_is_told_and_the_loop_goes_on(
    start: Callable[..., Cell], caplog: pytest.LogCaptureFixture
) -> None:
    cell = start()
    with pytest.raises(DeadlinePassed):
        cell.select(slice(40, 41), slice(10, 13), timeout=0.05)
    assert soon(lambda: "no plane of this patch" in caplog.text)
    assert cell.select(slice(40, 50), slice(10, 30)).inliers > 4000


def test_a_patch_that_is_too_small_is_refused_before_it_is_sent(start: Callable[..., Cell]) -> None:
    with pytest.raises(UsageError, match=r"the patch is 2 x 1 points; a plane needs at least three"):
        start().select(slice(40, 41), slice(10, 12))


def test_heights_in_the_wrong_order_are_told_and_the_loop_goes_on(
    start: Callable[..., Cell], caplog: pytest.LogCaptureFixture
) -> None:
    cell = start(above=True, above_low=0.6, above_high=0.5)
    for _ in range(2):
        assert cell.select(slice(40, 50), slice(10, 30)).inliers > 4000
    assert soon(lambda: "heights are 0.6 to 0.5 m" in caplog.text)


def test_a_patch_that_the_newest_cloud_does_not_hold_is_told_and_the_loop_goes_on(
    start: Callable[..., Cell], caplog: pytest.LogCaptureFixture
) -> None:
    cell = start(connected=True, above=True)
    gone = floor()[40:50, 10:30].copy()
    gone["x"] += 10
    assert cell.client.select(message(gone), timeout=DEADLINE).inliers == 0
    assert soon(lambda: "the surface has 0 points" in caplog.text)
    assert cell.select(slice(40, 50), slice(10, 30)).inliers > 1000


def test_a_bug_is_logged_and_the_loop_goes_on(
    start: Callable[..., Cell], caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    cell = start()
    with monkeypatch.context() as broken:
        broken.setattr(planes, "plane_of_patch", lambda *_, **__: int("no number"))
        with pytest.raises(DeadlinePassed):
            cell.select(slice(40, 50), slice(10, 30), timeout=0.05)
        assert soon(lambda: "invalid literal" in caplog.text)
    assert cell.select(slice(40, 50), slice(10, 30)).inliers > 4000


def test_a_patch_before_any_cloud_is_told(
    start: Callable[..., Cell], caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(planes, "_CLOUD_WAIT", 0.01)
    cell = start(cloud=False)
    with pytest.raises(DeadlinePassed):
        cell.select(slice(40, 50), slice(10, 30), timeout=0.05)
    assert soon(lambda: "is the camera running?" in caplog.text)


def test_without_the_service_nobody_answers(join_memory: Callable[[], Bus]) -> None:
    bus = join_memory()
    with pytest.raises(NobodyAnswers, match="start the planes service"):
        CellClient(bus).select(message(floor()), timeout=0.02)
    assert (bus.writers, bus.readers) == ([], [])
