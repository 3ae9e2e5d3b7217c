"""The voxel service: every cloud smaller, with the stamp and frame it came with."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from tests.services.running import running
from tests.services.waiting import DEADLINE, soon

from zsight import voxel
from zsight.convert import cloud_from_points, points_of
from zsight_core.points import colours, from_xyz, xyz
from zsight_core.voxel_grid import voxel_grid
from zsight_protocol.message import Time
from zsight_protocol.point_cloud import PointCloud2

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from zsight.bus import Bus, Reader, Writer


pytestmark = pytest.mark.usefixtures("warm_kernels")


@pytest.fixture
def ends(join_memory: Callable[[], Bus]) -> Iterator[tuple[Writer[PointCloud2], Reader[PointCloud2]]]:
    """What goes into a running service, and what comes out."""
    service, test = join_memory(), join_memory()
    out = test.reader(test.cell.voxel_points("kinect"), PointCloud2)
    with running(voxel.run, service, voxel.Settings(leaf=0.1)):
        yield test.writer(test.cell.points("kinect"), PointCloud2), out


def test_a_cloud_comes_out_smaller_with_its_stamp_and_frame(
    ends: tuple[Writer[PointCloud2], Reader[PointCloud2]],
) -> None:
    rng = np.random.default_rng(3)
    points = from_xyz(rng.uniform(0, 1, (40, 50, 3)), rng.integers(0, 256, (40, 50, 3)))
    into, out = ends
    into.send(cloud_from_points(points, Time(sec=7, nanosec=8), "eye"))
    received = out.take(DEADLINE)
    assert received is not None
    assert received.message.header.stamp == Time(sec=7, nanosec=8)
    assert received.message.header.frame_id == "eye"
    assert received.message.is_dense
    got, expected = points_of(received.message), voxel_grid(points, 0.1)
    assert 500 < got.size <= 1000
    np.testing.assert_array_equal(xyz(got), xyz(expected))
    np.testing.assert_array_equal(colours(got), colours(expected))


@pytest.mark.parametrize(
    "bad", [from_xyz(np.full((2, 2, 3), np.nan)), np.zeros((1, 3), [("intensity", "<f4")])], ids=["all holes", "no x"]
)
def test_a_cloud_that_cannot_be_averaged_is_told_and_the_loop_goes_on(
    ends: tuple[Writer[PointCloud2], Reader[PointCloud2]], bad: np.ndarray, caplog: pytest.LogCaptureFixture
) -> None:
    into, out = ends
    into.send(cloud_from_points(bad, Time(nanosec=1), "eye"))
    assert soon(lambda: "cloud of eye at 1 ns left out" in caplog.text)
    into.send(cloud_from_points(from_xyz(np.ones((1, 1, 3))), Time(nanosec=2), "eye"))
    received = out.take(DEADLINE)
    assert received is not None
    assert received.message.header.stamp.ns == 2


def test_a_bug_is_logged_and_the_loop_goes_on(
    ends: tuple[Writer[PointCloud2], Reader[PointCloud2]],
    caplog: pytest.LogCaptureFixture,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    into, out = ends
    with monkeypatch.context() as broken:
        broken.setattr("zsight_core.voxel_grid.voxel_grid", lambda *_: int("no number"))
        into.send(cloud_from_points(from_xyz(np.ones((1, 1, 3))), Time(nanosec=1), "eye"))
        assert soon(lambda: "invalid literal" in caplog.text)
    into.send(cloud_from_points(from_xyz(np.ones((1, 1, 3))), Time(nanosec=2), "eye"))
    received = out.take(DEADLINE)
    assert received is not None
    assert received.message.header.stamp.ns == 2
