"""Votes propose a pose near the true one, for every way to rest, and where a thing touches or carries another one."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from tests.core import book_scene as book

from zsight_core.errors import Cancelled
from zsight_core.model import Box, Cylinder, Mesh, ObjectModel, Sphere
from zsight_core.scene import go_on, understand
from zsight_core.search.candidates import Candidates
from zsight_core.search.clues import clues_of
from zsight_core.search.recognise import hypotheses
from zsight_core.simulation.kinect import Kinect
from zsight_core.solid import solid_of
from zsight_core.transform import from_rpy, inverse

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from zsight_core.model import Shape
    from zsight_core.scene import Scene
    from zsight_core.search.clues import Hypothesis

Z = book.TABLE_HEIGHT
NEAR = 0.02
"""Metres that a surface proposed is off at most: some 10 mm and 10 degrees are what a fit makes up for."""
TEA_BOX = ObjectModel("tea_box", Box((0.075, 0.13, 0.065)))
WEDGE = Mesh(  # a ramp, 80 mm long, 50 wide, 60 high at one end
    np.array([[0, 0, 0], [80, 0, 0], [80, 50, 0], [0, 50, 0], [80, 0, 60], [80, 50, 60]]) / 1000 - [0.04, 0.025, 0.03],
    np.array([[0, 2, 1], [0, 3, 2], [1, 2, 5], [1, 5, 4], [0, 1, 4], [3, 5, 2], [0, 4, 5], [0, 5, 3]], np.int32),
)


def scene_of(*objects: tuple[ObjectModel, NDArray[np.float64]]) -> Scene:
    return understand(book.cloud(*objects, noise=Kinect()), T_world_camera=book.T_WORLD_CAMERA)


def farthest(scene: Scene, shape: Shape, guess: Hypothesis, T_world_model: NDArray[np.float64]) -> float:
    """Metres that the proposed surface is off, at most."""
    vertices = solid_of(shape, coarse=True).vertices
    T_world_support = book.T_WORLD_CAMERA @ scene.supports[guess.support].T_camera_support
    true = inverse(T_world_support) @ T_world_model
    a, b = (T[:3, :3] @ vertices.T + T[:3, 3:] for T in (guess.T_support_model, true))
    return float(np.linalg.norm(a[:, :, None] - b[:, None, :], axis=0).min(axis=1).max())


def best(scene: Scene, shape: Shape, T_world_model: NDArray[np.float64]) -> float:
    return min(farthest(scene, shape, guess, T_world_model) for guess in hypotheses(shape, clues_of(scene)))


@pytest.mark.parametrize(
    ("shape", "pose"),
    [
        (Box((0.035, 0.2, 0.035)), ((0.5, -0.3, Z + 0.0175), (0, 0, 0.7))),
        (Box((0.075, 0.13, 0.065)), ((0.6, -0.1, Z + 0.0375), (0, np.pi / 2, 0.3))),
        (Cylinder(0.066, 0.122), ((0.6, -0.2, Z + 0.061), (0, 0, 0))),
        (Cylinder(0.066, 0.122), ((0.6, -0.2, Z + 0.033), (0, np.pi / 2, 1.1))),
        (Sphere(0.067), ((0.7, -0.3, Z + 0.0335), (0, 0, 0))),
        (WEDGE, ((0.55, -0.2, Z + 0.03), (0, 0, 2.5))),
    ],
)
def test_a_pose_near_the_true_one_is_proposed(shape: Shape, pose: tuple[tuple[float, ...], tuple[float, ...]]) -> None:
    T = from_rpy(*pose)
    assert best(scene_of((ObjectModel("it", shape), T)), shape, T) < NEAR


def test_things_that_touch_are_proposed_one_by_one() -> None:
    """Two boxes of one height side by side have one top: no segment has the size of either."""
    one, other = book.at(0.6, -0.2, Z + 0.0325), book.at(0.6752, -0.2, Z + 0.0325)
    scene = scene_of((TEA_BOX, one), (TEA_BOX, other))
    assert best(scene, TEA_BOX.shape, one) < NEAR
    assert best(scene, TEA_BOX.shape, other) < NEAR


def test_a_can_on_a_box_is_proposed_at_its_height() -> None:
    above = book.at(0.6, -0.2, Z + 0.065 + 0.061)
    scene = scene_of((TEA_BOX, book.at(0.6, -0.2, Z + 0.0325)), (book.COKE_CAN, above))
    assert best(scene, book.COKE_CAN.shape, above) < NEAR


def test_an_empty_table_makes_no_proposals() -> None:
    assert hypotheses(TEA_BOX.shape, clues_of(scene_of())) == []


def test_a_search_can_be_stopped_among_its_votes() -> None:
    asked: list[str] = []

    def stop(stage: str, fraction: float) -> None:
        assert 0 <= fraction <= 1
        asked.append(stage)
        if len(asked) == 2:
            raise Cancelled("stopped")

    with pytest.raises(Cancelled):
        hypotheses(TEA_BOX.shape, clues_of(scene_of((TEA_BOX, book.at(0.6, -0.2, Z + 0.0325)))), stop)
    assert asked == ["propose", "propose"]


def test_a_type_is_looked_for_once_in_a_scene() -> None:
    scene = scene_of((TEA_BOX, book.at(0.6, -0.2, Z + 0.0325)))
    first, _ = Candidates(scene, go_on).of(TEA_BOX)
    again = Candidates(scene, go_on)
    assert again.knows(TEA_BOX)
    assert again.of(TEA_BOX)[0] is first
    assert not again.knows(book.COKE_CAN)


def test_candidates_of_one_type_do_not_share_their_room() -> None:
    scene = scene_of((book.TOY_BLOCK, book.T_WORLD_BLOCK))
    kept = [c for c in Candidates(scene, go_on).of(book.TOY_BLOCK)[0].kept if c.probability > 0.5]
    assert len(kept) == 1


def test_a_fine_mesh_is_clustered_for_a_quick_look() -> None:
    ball = solid_of(Sphere(0.1))
    mesh = Mesh(ball.vertices, ball.faces)
    fine, coarse = solid_of(mesh), solid_of(mesh, coarse=True)
    assert len(fine.faces) == len(ball.faces)
    assert len(coarse.faces) <= 500
    assert np.linalg.norm(coarse.vertices, axis=1) == pytest.approx(0.05, abs=0.002)
