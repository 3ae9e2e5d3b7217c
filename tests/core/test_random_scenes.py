"""Laws of resting bodies and of the scenes drawn from seeds."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest

from zsight_core.errors import ModelError
from zsight_core.model import Box, Cylinder, Mesh, ObjectModel, Shape, Sphere, Surface, size_of
from zsight_core.simulation.random_scenes import LEVELS, TABLE_HEIGHT, Level, Placed, RandomScene, draw_scene, scaled
from zsight_core.simulation.settle import gap, resting_poses, slide_to, stands_on
from zsight_core.solid import solid_of
from zsight_core.transform import inverse

WEDGE = Mesh(
    np.array([[x, y, z] for y in (-0.03, 0.03) for x, z in ((-0.04, -0.02), (0.04, -0.02), (-0.04, 0.02))]),
    np.array([[0, 1, 2], [3, 5, 4], [0, 3, 1], [1, 3, 4], [1, 4, 2], [2, 4, 5], [2, 5, 0], [0, 5, 3]], dtype=np.int32),
)
SHAPES: dict[str, Shape] = {
    "block": Box((0.035, 0.2, 0.035)),
    "box": Box((0.075, 0.13, 0.065)),
    "can": Cylinder(0.066, 0.122),
    "ball": Sphere(0.067),
    "wedge": WEDGE,
}
MODELS = [ObjectModel(name, shape) for name, shape in SHAPES.items()]
SEEDS = (3, 4)


@lru_cache
def scene(level: Level, seed: int) -> RandomScene:
    return draw_scene(level, seed, MODELS)


def surface_points(placed: Placed) -> np.ndarray:
    """Points (N, 3) on the surface, world frame."""
    solid, generator = solid_of(placed.model.shape), np.random.default_rng(0)
    corners = solid.vertices[solid.faces[generator.integers(len(solid.faces), size=2000)]]
    shares = generator.dirichlet((1, 1, 1), 2000)
    points = np.concatenate([solid.vertices, (shares[..., np.newaxis] * corners).sum(axis=1)])
    T = placed.T_world_model
    moved: np.ndarray = points @ T[:3, :3].T + T[:3, 3]
    return moved


def depth_inside(placed: Placed, points: np.ndarray) -> np.ndarray:
    """How far points (N, 3) of the world lie inside a body, metres; below zero outside."""
    T = inverse(placed.T_world_model)
    there = points @ T[:3, :3].T + T[:3, 3]
    shape = placed.model.shape
    half = np.array(size_of(shape)) / 2
    if isinstance(shape, Box):
        deep: np.ndarray = (half - np.abs(there)).min(axis=1)
    elif isinstance(shape, Cylinder):
        deep = np.minimum(half[0] - np.hypot(there[:, 0], there[:, 1]), half[2] - np.abs(there[:, 2]))
    elif isinstance(shape, Sphere):
        deep = half[0] - np.linalg.norm(there, axis=1)
    else:  # the wedge: five planes
        slope = np.array([0.02, 0, 0.04]) / np.hypot(0.02, 0.04)
        deep = np.minimum((half - np.abs(there)).min(axis=1), -(there @ slope))
    return deep


@pytest.mark.parametrize("shape", SHAPES.values(), ids=SHAPES)
def test_a_resting_body_touches_the_ground_below_its_centre_of_mass(shape: Shape) -> None:
    poses = resting_poses(shape)
    assert sum(pose.share for pose in poses) == pytest.approx(1)
    vertices = solid_of(shape).vertices
    for pose in poses:
        assert np.allclose(pose.R @ pose.R.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(pose.R) == pytest.approx(1)
        z = vertices @ pose.R[2]
        assert z.min() == pytest.approx(-pose.below, abs=2e-4)  # a solid has facets half outside of a round body
        assert z.max() == pytest.approx(pose.above, abs=2e-4)
        assert stands_on(pose.ground, pose.centre)


def test_slender_bodies_do_not_stand_upright() -> None:
    assert {round(pose.below, 6) for pose in resting_poses(SHAPES["block"])} == {0.0175}
    assert {round(pose.below, 6) for pose in resting_poses(SHAPES["can"])} == {0.061, 0.033}


def test_a_wedge_lies_on_its_flat_sides_and_slope() -> None:
    assert {round(pose.below + pose.above, 4) for pose in resting_poses(WEDGE)} >= {0.04, 0.06}


def test_an_open_mesh_or_surface_does_not_rest() -> None:
    with pytest.raises(ModelError, match="expected a solid"):
        resting_poses(Surface())
    flat = Mesh(np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0.0]]), np.array([[0, 1, 2]], dtype=np.int32))
    with pytest.raises(ModelError, match="encloses no volume"):
        resting_poses(flat)


@pytest.mark.parametrize("angle", [0.0, 0.7, 2.0, 4.0])
@pytest.mark.parametrize("distance", [0.0, 0.0007, 0.02])
def test_sliding_ends_at_the_distance(angle: float, distance: float) -> None:
    moving, still = (
        resting_poses(SHAPES["can"])[0].ground,
        resting_poses(SHAPES["box"])[0].ground + np.array([0.3, -0.1]),
    )
    shift = slide_to(moving, still, np.array([np.cos(angle), np.sin(angle)]), distance)
    assert gap(moving + shift, still) == pytest.approx(distance, abs=1e-7)
    assert gap(still, moving + shift) == gap(moving + shift, still)


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("level", LEVELS)
def test_nothing_penetrates_anything(level: Level, seed: int) -> None:
    objects = scene(level, seed).objects
    assert objects
    for one in objects:
        points = surface_points(one)
        assert points[:, 2].min() > TABLE_HEIGHT - 5e-4
        for other in objects:
            if other is not one:
                assert depth_inside(other, points).max() < 5e-4


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("level", LEVELS)
def test_everything_is_carried(level: Level, seed: int) -> None:
    objects = scene(level, seed).objects
    for one in objects:
        assert surface_points(one)[:, 2].min() == pytest.approx(TABLE_HEIGHT + one.base, abs=3e-4)
        if one.base > 0:
            carriers = [o for o in objects if abs(o.base + o.height - one.base) < 1e-9]
            assert any(gap(o.outline, one.outline) < 0 for o in carriers)


def test_levels_are_what_they_say() -> None:
    assert any(thing.base > 0 for seed in SEEDS for thing in scene("stacked", seed).objects)
    assert all(any(thing.truncated for thing in scene("truncated", seed).objects) for seed in SEEDS)
    assert not any(thing.truncated for thing in scene("+7", SEEDS[0]).objects)
    assert all(thing.model.name != MODELS[0].name for thing in scene("absent", SEEDS[0]).objects)
    like, *others = scene("lookalike", SEEDS[0]).objects
    assert like.model.name.removesuffix("-like") not in {thing.model.name for thing in others}
    assert [thing.reflects < 0.1 for thing in scene("glass", SEEDS[0]).objects] == [True, False, False, False]
    (block,) = scene("book", SEEDS[0]).objects
    assert block.T_world_model[:3, 3] == pytest.approx([0.5, -0.35, 0.7922])
    tilted = scene("tilted", SEEDS[0])
    turn = tilted.T_world_camera[:3, :3] @ tilted.camera.T_world_camera[:3, :3].T
    assert 0 < np.degrees(np.arccos((np.trace(turn) - 1) / 2)) <= 2.0


def test_in_the_crowd_most_things_touch() -> None:
    objects = scene("+11 touching", SEEDS[0]).objects
    nearest = [min(gap(one.outline, other.outline) for other in objects if other is not one) for one in objects]
    assert sum(distance < 0.001 for distance in nearest) > len(objects) / 2


@pytest.mark.parametrize("level", LEVELS)
def test_visible_shares_follow_from_the_picture(level: Level) -> None:
    drawn = scene(level, SEEDS[0])
    first = len(drawn.world.bodies) - len(drawn.objects)
    for number, thing in enumerate(drawn.objects):
        assert 0 <= thing.visible <= 1
        assert (thing.visible > 0) == bool((drawn.view.body_index == first + number).any())


def test_the_same_seed_gives_the_same_scene() -> None:
    one, same, other = (draw_scene("+7", seed, MODELS) for seed in (5, 5, 6))
    assert np.array_equal(one.view.depth, same.view.depth, equal_nan=True)
    assert [thing.T_world_model.tobytes() for thing in one.objects] == [t.T_world_model.tobytes() for t in same.objects]
    assert not np.array_equal(one.view.depth, other.view.depth, equal_nan=True)


def test_scaling_scales_all_lengths() -> None:
    for shape in SHAPES.values():
        assert np.allclose(size_of(scaled(shape, 1.15)), 1.15 * np.array(size_of(shape)))
    assert scaled(Surface(0.1), 2.0) == Surface(0.1)


def test_there_must_be_a_solid() -> None:
    with pytest.raises(ModelError, match="at least one"):
        draw_scene("alone", 0, [ObjectModel("table", Surface())])
