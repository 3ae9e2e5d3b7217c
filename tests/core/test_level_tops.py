"""Level tops are found at their heights, and nothing steep or round is one."""

from __future__ import annotations

from tests.core import book_scene as book

from zsight_core.level_tops import level_tops
from zsight_core.model import Box, ObjectModel, Sphere
from zsight_core.scene import understand
from zsight_core.simulation.kinect import Kinect

Z = book.TABLE_HEIGHT


def test_each_step_of_a_stack_is_a_top() -> None:
    low, high = ObjectModel("low", Box((0.2, 0.14, 0.05))), ObjectModel("high", Box((0.08, 0.08, 0.06)))
    points = book.cloud((low, book.at(0.6, -0.3, Z + 0.025)), (high, book.at(0.6, -0.3, Z + 0.08)), noise=Kinect())
    scene = understand(points, T_world_camera=book.T_WORLD_CAMERA)
    on_table = {segment.label for segment in scene.segments if segment.support == 0}
    tops = [top for top in level_tops(scene) if top.segment in on_table]
    heights = {round(top.height, 2) for top in tops}  # the lower top may be seen in several pieces
    assert heights == {0.05, 0.11}
    assert all(abs(top.height - round(top.height, 2)) < 0.003 for top in tops)


def test_a_ball_has_no_top_of_any_size() -> None:
    ball = ObjectModel("ball", Sphere(0.2))
    points = book.cloud((ball, book.at(0.6, -0.3, Z + 0.1)), noise=Kinect())
    scene = understand(points, T_world_camera=book.T_WORLD_CAMERA)
    labels = {segment.label for segment in scene.segments if segment.support == 0}
    assert labels
    assert [top for top in level_tops(scene) if top.segment in labels] == []
