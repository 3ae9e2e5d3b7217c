"""Real recordings through the same commands."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from tests.system.commands import run

from zsight.patch_plane import plane_of_patch
from zsight_core import plane
from zsight_core.files import cloud_file

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from zsight_core.points import Points

pytestmark = [pytest.mark.system, pytest.mark.usefixtures("warm_kernels")]


def degrees_between(a: NDArray[np.float64], b: NDArray[np.float64]) -> float:
    return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b)))


def test_the_drinks_can_stands_on_the_floor(shared_data: Path) -> None:
    ended = run("find", "slim_can", "--cloud", shared_data / "moveit" / "drinks_can.pcd", "--all", "--json")
    assert ended.code == 0
    report = ended.json
    assert (report["status"], report["frame_id"]) == ("found", "camera")
    (can,) = report["objects"]
    assert can["measured_height"] == pytest.approx(0.134, abs=0.006)
    # The floor was measured in the recording: SOURCES.md gives its normal and the camera's height over it.
    floor = np.array([-0.061, -0.934, -0.353])
    normal = np.array([can["support"]["normal"][axis] for axis in "xyz"])
    point = np.array([can["support"]["point"][axis] for axis in "xyz"])
    assert degrees_between(normal, floor) < 0.5
    assert point @ normal == pytest.approx(-0.543, abs=0.005)
    assert (can["position"] - point) @ normal == pytest.approx(0.134 / 2, abs=0.006)


@pytest.fixture(scope="module")
def milk(shared_data: Path) -> Path:
    """Three bottles and cartons on a carpet."""
    return shared_data / "pcl" / "milk_cartoon_all_small_clorox.pcd"


@pytest.fixture(scope="module")
def points(milk: Path) -> Points:
    return cloud_file.read(milk).points


@pytest.fixture(scope="module")
def carpet(points: Points) -> NDArray[np.float64]:
    """Normal of the cloud's dominant plane."""
    return plane.ransac_plane(points, 0.01).plane.normal


def normal_of(points: Points, u0: int, v0: int, u1: int, v1: int) -> NDArray[np.float64]:
    """As the command finds it."""
    return plane_of_patch(points, points[v0 : v1 + 1, u0 : u1 + 1]).fit.plane.normal


def test_a_patch_of_the_carpet_finds_the_carpet(milk: Path, points: Points, carpet: NDArray[np.float64]) -> None:
    ended = run("plane", milk, "--patch", 250, 380, 350, 440, "--json")
    assert ended.code == 0
    normal = np.array(ended.json["normal"])
    assert degrees_between(normal, carpet) < 0.3
    np.testing.assert_allclose(normal, normal_of(points, 250, 380, 350, 440), atol=1e-9)
    assert ended.json["inliers"] > 150_000


@pytest.mark.parametrize(
    "patch", [(215, 270, 590, 440), (510, 100, 590, 400), (340, 100, 390, 400), (40, 60, 140, 130), (30, 310, 100, 380)]
)
def test_any_patch_of_the_carpet_finds_it(
    points: Points, carpet: NDArray[np.float64], patch: tuple[int, int, int, int]
) -> None:
    assert degrees_between(normal_of(points, *patch), carpet) < 0.3


@pytest.mark.parametrize(
    ("clean", "spoilt"),
    [
        ((250, 250, 350, 330), (250, 190, 350, 330)),  # the milk carton's foot ends at row 230
        ((400, 270, 490, 330), (400, 230, 490, 330)),  # the white bottle's at row 260
        ((60, 310, 200, 370), (60, 260, 200, 370)),  # the blue bottle's at row 295
    ],
)
def test_a_part_of_an_object_in_the_patch_changes_little(
    points: Points, clean: tuple[int, int, int, int], spoilt: tuple[int, int, int, int]
) -> None:
    assert degrees_between(normal_of(points, *clean), normal_of(points, *spoilt)) < 0.5


def test_a_smaller_cloud_keeps_its_floor(shared_data: Path, tmp_path: Path) -> None:
    cloud = shared_data / "moveit" / "drinks_can.pcd"
    small = tmp_path / "small.pcd"
    report = run("downsample", cloud, "--leaf", "0.01", "-o", small, "--json").json
    points = cloud_file.read(small).points
    assert points.size == report["points_out"] < report["points_in"] / 5
    whole = run("segment", cloud, "--json").json["support"]
    part = plane.ransac_plane(points, 0.01).plane
    assert degrees_between(part.normal, np.array(whole["normal"])) < 0.5
    assert part.distance == pytest.approx(whole["distance"], abs=0.005)
