"""Where nothing is measured on a table, nothing may be said to be absent."""

from __future__ import annotations

import numpy as np
import pytest
from tests.core import book_scene as book

from zsight_core import find as finder
from zsight_core.model import Box, ObjectModel
from zsight_core.points import xyz
from zsight_core.scene import understand


def test_a_blind_patch_of_the_table_is_a_hole_of_its_size() -> None:
    points = book.cloud()
    T = book.T_WORLD_CAMERA
    world = xyz(points).astype(float) @ T[:3, :3].T + T[:3, 3]
    blind = (np.abs(world - [0.6, -0.3, book.TABLE_HEIGHT]) < [0.06, 0.04, 0.01]).all(axis=2)
    for axis in "xyz":
        points[axis][blind] = np.nan
    scene = understand(points, T_world_camera=T)
    hole = scene.holes[0]
    place = T @ hole.T_camera_box
    assert place[:3, 3] == pytest.approx([0.6, -0.3, book.TABLE_HEIGHT], abs=0.01)
    assert hole.area == pytest.approx(0.12 * 0.08, rel=0.15)
    assert not hole.is_shadow


def test_a_seen_table_has_no_holes() -> None:
    scene = understand(book.cloud(), T_world_camera=book.T_WORLD_CAMERA)
    assert [hole for hole in scene.holes if hole.support == 0] == []


def test_blind_patches_make_absence_less_probable() -> None:
    points = book.cloud()
    blind = np.random.default_rng(0).random(points.shape) < 0.3
    for axis in "xyz":
        points[axis][blind] = np.nan
    some = finder.find(points, [book.TOY_BLOCK], T_world_camera=book.T_WORLD_CAMERA)
    free = finder.find(book.cloud(), [book.TOY_BLOCK], T_world_camera=book.T_WORLD_CAMERA)
    assert free.p_absent > 0.95
    assert some.p_absent == pytest.approx(0.7, abs=0.07)


def test_what_is_not_asked_for_is_an_obstacle() -> None:
    stranger = ObjectModel("stranger", Box((0.08, 0.08, 0.12)))
    points = book.cloud((stranger, book.at(0.6, -0.1, book.TABLE_HEIGHT + 0.06)), (book.TOY_BLOCK, book.T_WORLD_BLOCK))
    answer = finder.find(points, [book.TOY_BLOCK], T_world_camera=book.T_WORLD_CAMERA)
    assert len(answer.detections) == 1
    obstacles = [
        segment for segment in answer.obstacles if segment.support == 0
    ]  # the table's foot is one on the floor
    assert len(obstacles) == 1
    place = book.T_WORLD_CAMERA @ np.append(obstacles[0].centroid, 1.0)
    assert place[:2] == pytest.approx([0.6, -0.1], abs=0.04)
    assert obstacles[0].high == pytest.approx(0.12, abs=0.006)
