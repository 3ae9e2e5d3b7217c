from __future__ import annotations

import numpy as np
import pytest

from zsight_core import points
from zsight_core.errors import GeometryError
from zsight_core.model import Box, ObjectModel, Surface
from zsight_core.pinhole import Pinhole
from zsight_core.simulation.camera import Noise, capture, expose
from zsight_core.simulation.kinect import Kinect
from zsight_core.simulation.raycast import render
from zsight_core.simulation.time_of_flight import TimeOfFlight
from zsight_core.simulation.world import Body, Camera, World
from zsight_core.transform import from_rpy

PINHOLE = Pinhole(160, 120, 138.6, 138.6, 79.5, 59.5)
CAMERA = Camera(PINHOLE, np.eye(4))
NOISES = [Kinect(), TimeOfFlight()]


def wall(distance: float, reflects: float = 1.0) -> Body:
    return Body("wall", ObjectModel("wall", Surface()), from_rpy((0, 0, distance), (0, 0, 0)), reflects)


def box_before_wall() -> World:
    box = Body("box", ObjectModel("box", Box((0.2, 0.2, 0.1)), (10, 200, 30)), from_rpy((0, 0, 0.9), (0, 0, 0)))
    return World((wall(1.6), box))


def test_a_cloud_without_noise_is_the_true_surface() -> None:
    cloud = capture(World((wall(1.25),)), CAMERA)
    assert cloud.shape == (120, 160)
    assert cloud.dtype == points.XYZRGB
    assert np.all(cloud["z"] == np.float32(1.25))
    rays = PINHOLE.rays()
    assert np.allclose(cloud["x"], rays[..., 0] * 1.25, rtol=0, atol=1e-7)
    assert np.allclose(cloud["y"], rays[..., 1] * 1.25, rtol=0, atol=1e-7)


def test_colours_are_those_of_the_bodies() -> None:
    view = render(box_before_wall(), CAMERA)
    seen = points.colours(expose(view, PINHOLE))
    assert np.array_equal(seen, view.colour)
    red, green, blue = seen[60, 80].astype(int)
    assert green > 5 * red
    assert green > 5 * blue


@pytest.mark.parametrize(("distance", "millimetres"), [(0.8, 1.05), (1.5, 3.7), (3.0, 14.8)])
def test_kinect_noise_of_a_wall_has_the_published_spread(distance: float, millimetres: float) -> None:
    depth = capture(World((wall(distance),)), CAMERA, Kinect(), seed=3)["z"]
    errors = depth[np.isfinite(depth)] - distance
    assert abs(errors.std() * 1e3 / millimetres - 1) < 0.05
    assert abs(errors.mean()) < 4 * errors.std() / np.sqrt(errors.size) + 5e-5 * distance**2


def test_kinect_depth_comes_in_steps_of_disparity() -> None:
    depth = capture(World((wall(1.5),)), CAMERA, Kinect(), seed=3)["z"].astype(np.float64)
    steps = Kinect().disparity_scale / depth[np.isfinite(depth)]
    assert np.abs(steps - np.rint(steps)).max() < 1e-4


def test_the_projector_throws_a_shadow_to_the_left_of_what_is_near() -> None:
    view = render(box_before_wall(), CAMERA)
    quiet = Kinect(disparity_noise=0, jitter=0, mixed=0, edge_dropout=0, dropout=0)
    holes = np.isnan(expose(view, PINHOLE, quiet)["z"])
    row = holes[60]
    near = np.flatnonzero(view.body_index[60] == 1)
    depth = view.depth[60, near[0]]
    width = PINHOLE.fx * quiet.baseline * (1 / depth - 1 / 1.6)
    assert row[near[0] - 3 : near[0]].all()
    assert abs(row.sum() - width) <= 1
    assert not row[near[0] :].any()


@pytest.mark.parametrize("noise", NOISES)
def test_readings_at_an_edge_lie_between_both_surfaces(noise: Noise) -> None:
    depth = expose(render(box_before_wall(), CAMERA), PINHOLE, noise, seed=5)["z"]
    between = (depth > 0.95) & (depth < 1.5)
    assert 3 < between.sum() < 150
    assert np.nanmin(depth) > 0.8
    assert np.nanmax(depth) < 1.7


@pytest.mark.parametrize("noise", NOISES)
def test_the_seed_decides_every_byte(noise: Noise) -> None:
    view = render(box_before_wall(), CAMERA)
    once, again, other = (expose(view, PINHOLE, noise, seed) for seed in (1, 1, 2))
    assert once.tobytes() == again.tobytes()
    assert once.tobytes() != other.tobytes()


@pytest.mark.parametrize("noise", NOISES)
def test_glass_sends_back_its_share(noise: Noise) -> None:
    cloud = capture(World((wall(1.2, reflects=0.1),)), CAMERA, noise, seed=1)
    returned = np.isfinite(cloud["z"][:, 30:]).mean()
    assert 0.08 < returned < 0.12
    with pytest.raises(GeometryError, match="share from 0 to 1"):
        wall(1.0, reflects=1.5)


@pytest.mark.parametrize("noise", NOISES)
def test_what_is_too_far_reads_as_a_hole(noise: Noise) -> None:
    assert np.isnan(capture(World((wall(9.0),)), CAMERA, noise)["z"]).all()


def test_time_of_flight_noise_grows_with_range() -> None:
    for distance in (0.8, 1.5, 3.0):
        depth = capture(World((wall(distance),)), CAMERA, TimeOfFlight(), seed=3)["z"][50:70, 70:90]
        expected = np.hypot(0.0004, 0.0012 * distance**2)
        assert abs((depth - distance).std() / expected - 1) < 0.12
