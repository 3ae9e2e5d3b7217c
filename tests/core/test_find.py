"""Objects are found where they are, and not where they are not."""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING

import numpy as np
import pytest
from tests.core import book_scene as book

from zsight_core import find as finder
from zsight_core.errors import Cancelled, PointsError
from zsight_core.files.pcd import read as read_pcd
from zsight_core.model import Mesh, ObjectModel, Sphere
from zsight_core.points import from_xyz, xyz
from zsight_core.scene import understand
from zsight_core.simulation.kinect import Kinect
from zsight_core.transform import angle_between, from_rpy

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from zsight_core.find import Answer, Detection


def find_in(points: np.ndarray, *models: ObjectModel) -> Answer:
    return finder.find(points, models, T_world_camera=book.T_WORLD_CAMERA)


def error_of(detection: Detection, truth: NDArray[np.float64]) -> tuple[float, float]:
    """Millimetres and degrees off, the block's own symmetries counted."""
    T = detection.T_world_model
    if T is None:
        pytest.fail("no world pose")
    turns = [from_rpy((0, 0, 0), (0, b, a)) for a in (0, np.pi) for b in np.arange(4) * np.pi / 2]
    angle = min(angle_between(T, truth @ turn) for turn in turns)
    return float(np.linalg.norm(T[:3, 3] - truth[:3, 3])) * 1e3, float(np.degrees(angle))


def test_exact_cloud_gives_the_exact_block() -> None:
    answer = find_in(book.cloud((book.TOY_BLOCK, book.T_WORLD_BLOCK)), book.TOY_BLOCK)
    assert answer.status == "found"
    assert len(answer.detections) == 1
    millimetres, degrees = error_of(answer.detections[0], book.T_WORLD_BLOCK)
    assert millimetres < 0.05
    assert degrees < 0.01


def test_noisy_clouds_give_the_block_to_the_millimetre() -> None:
    errors = []
    for seed in range(8):
        answer = find_in(book.cloud((book.TOY_BLOCK, book.T_WORLD_BLOCK), noise=Kinect(), seed=seed), book.TOY_BLOCK)
        assert len(answer.detections) == 1
        errors.append(error_of(answer.detections[0], book.T_WORLD_BLOCK))
    millimetres, degrees = np.median(errors, axis=0)
    assert millimetres < 1.0
    assert degrees < 0.5


@pytest.mark.parametrize("seed", range(4))
def test_empty_table_holds_no_block(seed: int) -> None:
    answer = find_in(book.cloud(noise=Kinect(), seed=seed), book.TOY_BLOCK)
    assert answer.status == "not_found"
    assert answer.detections == ()


def test_table_height_is_found_first() -> None:
    answer = find_in(book.cloud((book.TOY_BLOCK, book.T_WORLD_BLOCK), noise=Kinect()), book.TABLE)
    T = answer.detections[0].T_world_model
    assert T is not None
    assert T[2, 3] == pytest.approx(book.TABLE_HEIGHT, abs=0.0005)
    assert answer.detections[0].size[0] == pytest.approx(0.914, abs=0.03)  # the image cuts the other side
    assert 0.5 < answer.detections[0].size[1] < 0.93


def test_can_is_told_from_the_slim_can() -> None:
    points = book.cloud((book.COKE_CAN, book.at(0.55, -0.2, book.TABLE_HEIGHT + 0.061)), noise=Kinect())
    answer = find_in(points, book.COKE_CAN, book.SLIM_CAN)
    assert [d.type for d in answer.detections] == ["coke_can"]
    assert answer.detections[0].measured_height == pytest.approx(0.122, abs=0.006)
    T = answer.detections[0].T_world_model
    assert T is not None
    assert T[:3, 3] == pytest.approx([0.55, -0.2, book.TABLE_HEIGHT + 0.061], abs=0.002)


def test_ball_is_found() -> None:
    ball = ObjectModel("ball", Sphere(0.07))
    answer = find_in(book.cloud((ball, book.at(0.6, -0.3, book.TABLE_HEIGHT + 0.035)), noise=Kinect()), ball)
    T = answer.detections[0].T_world_model
    assert T is not None
    assert T[:3, 3] == pytest.approx([0.6, -0.3, book.TABLE_HEIGHT + 0.035], abs=0.002)


def test_same_cloud_same_answer_bit_for_bit() -> None:
    points = book.cloud((book.TOY_BLOCK, book.T_WORLD_BLOCK), noise=Kinect())
    one, two = (find_in(points, book.TOY_BLOCK, book.TABLE) for _ in range(2))
    for a, b in zip(one.detections, two.detections, strict=True):
        assert a.score == b.score
        assert a.T_camera_model.tobytes() == b.T_camera_model.tobytes()
        assert a.covariance.tobytes() == b.covariance.tobytes()


def test_region_leaves_out_what_is_elsewhere() -> None:
    points = book.cloud((book.TOY_BLOCK, book.T_WORLD_BLOCK))
    for region, count in ((((0.4, -0.5, 0.7), (0.6, -0.2, 0.9)), 1), (((0.6, -0.5, 0.7), (1.6, -0.2, 0.9)), 0)):
        answer = finder.find(points, [book.TOY_BLOCK], T_world_camera=book.T_WORLD_CAMERA, region=region)
        assert len(answer.detections) == count


def test_checkpoint_cancels() -> None:
    points = book.cloud((book.TOY_BLOCK, book.T_WORLD_BLOCK))
    scene = understand(points, T_world_camera=book.T_WORLD_CAMERA)
    stages: list[str] = []

    def stop_at_refinement(stage: str, fraction: float) -> None:
        assert 0 <= fraction <= 1
        stages.append(stage)
        if stage == "refine":
            raise Cancelled("asked to")

    with pytest.raises(Cancelled):
        finder.find(points, [book.TOY_BLOCK], scene=scene, checkpoint=stop_at_refinement)
    assert stages[-1] == "refine"


def test_each_of_many_types_is_begun_when_the_one_before_it_is_done() -> None:
    points = book.cloud((book.TOY_BLOCK, book.T_WORLD_BLOCK))
    told: list[tuple[str, float]] = []
    models = [book.TOY_BLOCK, book.COKE_CAN, book.TABLE, ObjectModel("ball", Sphere(0.07))]
    finder.find(points, models, checkpoint=lambda stage, fraction: told.append((stage, fraction)))
    begun = [number for number, (stage, _) in enumerate(told) if stage == "search"]
    assert [told[number][1] for number in begun] == pytest.approx([0, 1 / 3, 2 / 3])
    for first, last in itertools.pairwise([*begun, len(told)]):
        assert "propose" in {stage for stage, _ in told[first:last]}


def test_rival_that_explains_more_takes_the_place() -> None:
    """Two blocks end to end look like a block twice as long, which explains more."""
    long_one = ObjectModel("long", Mesh(*_box_mesh(0.035, 0.4, 0.035)))
    points = book.cloud((long_one, book.T_WORLD_BLOCK), noise=Kinect())
    answer = finder.find(points, [book.TOY_BLOCK], T_world_camera=book.T_WORLD_CAMERA, rivals=[long_one])
    assert answer.status != "found"


def test_nothing_to_see_is_an_error_and_no_surface_is_cannot_tell() -> None:
    with pytest.raises(PointsError, match="no finite point"):
        find_in(from_xyz(np.full((4, 4, 3), np.nan)), book.TOY_BLOCK)
    rng = np.random.default_rng(1)
    answer = finder.find(from_xyz(rng.uniform(0.5, 1.5, (2000, 3))), [book.TOY_BLOCK])
    assert answer.status == "cannot_tell"


def test_unorganised_cloud_works_too() -> None:
    points = book.cloud((book.TOY_BLOCK, book.T_WORLD_BLOCK), noise=Kinect())
    flat = xyz(points).reshape(-1, 3)
    shuffled = from_xyz(np.random.default_rng(0).permutation(flat[np.isfinite(flat).all(axis=1)]))
    answer = find_in(shuffled, book.TOY_BLOCK)
    assert len(answer.detections) == 1
    millimetres, degrees = error_of(answer.detections[0], book.T_WORLD_BLOCK)
    assert millimetres < 3.0
    assert degrees < 2.0


def test_drinks_can_on_a_floor_without_a_camera_pose(shared_data: Path) -> None:
    points = read_pcd(shared_data / "moveit" / "drinks_can.pcd").points
    answer = finder.find(points, [book.SLIM_CAN])
    assert answer.status == "found"
    assert len(answer.detections) == 1
    assert answer.detections[0].measured_height == pytest.approx(0.134, abs=0.006)
    assert answer.detections[0].base == 0.0


def _box_mesh(x: float, y: float, z: float) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    corners = np.array([[i, j, k] for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)]) * np.array([x, y, z]) / 2
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return corners, np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))], dtype=np.int32)
