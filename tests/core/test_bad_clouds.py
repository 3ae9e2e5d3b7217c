"""Clouds that are no picture of a table: an answer or a clear error, within bounded memory."""

from __future__ import annotations

import tracemalloc
from typing import TYPE_CHECKING

import numpy as np
import pytest
from tests.core import book_scene as book

from zsight_core import find as finder
from zsight_core.errors import PointsError
from zsight_core.points import from_xyz, xyz
from zsight_core.scene import understand

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from zsight_core.find import Answer
    from zsight_core.points import Points

pytestmark = pytest.mark.usefixtures("warm_kernels")

T = book.T_WORLD_CAMERA
GENERATOR = np.random.default_rng(0)
V, U = np.mgrid[:48, :64]
RAYS = np.stack([(U - 32) / 55, (V - 24) / 55, np.ones(U.shape)], axis=-1)


@pytest.fixture(scope="module")
def scene() -> Points:
    return book.cloud((book.TOY_BLOCK, book.T_WORLD_BLOCK))


def found(points: Points, T_world_camera: NDArray[np.float64] | None = T) -> Answer:
    return finder.find(points, [book.TOY_BLOCK], T_world_camera=T_world_camera)


def row(coordinates: NDArray[np.floating]) -> Points:
    """A cloud (1, N) that is no image."""
    return from_xyz(coordinates.reshape(1, -1, 3))


def error_of(answer: Answer, T_world_camera: NDArray[np.float64]) -> float:
    """Millimetres from the block to where it was found."""
    (block,) = answer.detections
    return float(np.linalg.norm((T_world_camera @ block.T_camera_model - book.T_WORLD_BLOCK)[:3, 3]) * 1e3)


@pytest.mark.parametrize(
    "cloud",
    [
        pytest.param(row(np.ones((1, 3))), id="one point"),
        pytest.param(row(np.eye(3)), id="three points"),
        pytest.param(row(np.ones((1000, 3))), id="one point again and again"),
        pytest.param(row(np.linspace([0, 0, 0.5], [0, 0, 2], 1000)), id="a line"),
        pytest.param(row(GENERATOR.uniform([-0.5, -0.5, 0.5], [0.5, 0.5, 2], (5000, 3))), id="a cloud indeed"),
        pytest.param(row(GENERATOR.standard_normal((1000, 3)) * 1e-30), id="nearly nothing"),
        pytest.param(from_xyz(np.zeros((48, 64, 3))), id="zeros for holes"),
        pytest.param(from_xyz(RAYS * 1.5), id="a wall"),
        pytest.param(from_xyz(RAYS * GENERATOR.uniform(0.5, 3, (48, 64, 1))), id="noise"),
        pytest.param(from_xyz(np.ones((2, 2, 3))), id="four pixels"),
    ],
)
def test_where_no_surface_is_seen_nothing_can_be_told(cloud: Points) -> None:
    answer = found(cloud)
    assert (answer.status, answer.detections, answer.p_absent) == ("cannot_tell", (), 0.0)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("shape", [(48, 64, 3), (1, 3072, 3)])
def test_without_a_finite_point_the_reason_is_said(value: float, shape: tuple[int, ...]) -> None:
    with pytest.raises(PointsError, match="no finite point"):
        found(from_xyz(np.full(shape, value)))


def test_a_cloud_of_no_points_is_refused() -> None:
    with pytest.raises(PointsError, match=r"expected .* at least one point"):
        found(row(np.zeros((0, 3))))


@pytest.mark.parametrize("shape", [(480, 640, 3), (1, -1, 3)], ids=["image", "row"])
def test_millimetres_are_told(scene: Points, shape: tuple[int, ...]) -> None:
    with pytest.raises(PointsError, match="these look like millimetres: divide by 1000"):
        found(from_xyz(xyz(scene).reshape(shape) * 1000))


def test_infinite_points_are_holes(scene: Points) -> None:
    points = scene.copy()
    holes = GENERATOR.random(points.shape) < 0.05
    for axis in "xyz":
        points[axis][holes] = np.inf
    assert error_of(found(points), T) < 0.5


def test_a_cloud_in_any_order_is_searched(scene: Points) -> None:
    coordinates = GENERATOR.permutation(xyz(scene).reshape(-1, 3))
    assert error_of(found(row(coordinates)), T) < 2


def test_memory_is_a_few_times_that_of_the_cloud(scene: Points) -> None:
    coordinates = xyz(scene).reshape(-1, 3)
    points = row(np.tile(coordinates[np.isfinite(coordinates).all(axis=1)], (4, 1)))
    understand(points)
    tracemalloc.start()
    try:
        understand(points)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 8 * points.nbytes


def test_the_same_cloud_gives_the_same_answer_bit_for_bit(scene: Points) -> None:
    one, other = found(scene), found(scene.copy())
    for first, second in zip(one.detections, other.detections, strict=True):
        assert first.score == second.score
        np.testing.assert_array_equal(first.T_camera_model, second.T_camera_model)
        np.testing.assert_array_equal(first.covariance, second.covariance)
    assert one.p_absent == other.p_absent
