from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from PIL import Image

from zsight_core.errors import FileError, GeometryError
from zsight_core.model import Box, ObjectModel, Shape, Sphere, Surface
from zsight_core.picture import Drawing, Eye, Legend, Outline, Triad, draw, eye_around, own_eye, save_png
from zsight_core.pinhole import Pinhole
from zsight_core.points import from_xyz
from zsight_core.simulation.camera import capture
from zsight_core.simulation.kinect import Kinect
from zsight_core.simulation.world import Body, Camera, World
from zsight_core.transform import from_rpy, transform_xyz

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from zsight_core.points import Points

SIZE = (320, 240)
GREEN = (0, 200, 0)


def body(shape: Shape, place: tuple[float, float, float], colour: tuple[int, int, int]) -> Body:
    return Body("body", ObjectModel("body", shape, colour), from_rpy(place, (0, 0, 0)))


def cloud(noise: Kinect | None = None) -> Points:
    """A green ball before a red wall, 160 x 120."""
    world = World((body(Surface(), (0, 0, 1.2), (200, 0, 0)), body(Sphere(0.2), (0.1, 0, 1.0), GREEN)))
    return capture(world, Camera(Pinhole(160, 120, 140.0, 140.0, 79.5, 59.5), np.eye(4)), noise, seed=2)


def is_green(image: NDArray[np.uint8]) -> NDArray[np.bool_]:
    return np.asarray((image[..., 1] > 60) & (image[..., 0] < 60) & (image[..., 2] < 60))


def drawn(image: NDArray[np.uint8], plain: NDArray[np.uint8]) -> NDArray[np.bool_]:
    return np.asarray((image != plain).any(axis=-1))


def test_its_own_camera_sees_the_cloud_where_it_was_seen() -> None:
    image = draw(cloud(), size=SIZE)
    assert image.shape == (240, 320, 3)
    assert image.dtype == np.uint8
    rows, columns = np.nonzero(is_green(image))
    scale = 320 / 160
    assert abs(columns.mean() - (79.5 + 140 * 0.1 / 1.0 + 0.5) * scale) < 2
    assert abs(rows.mean() - 60 * scale) < 2


def wall() -> Points:
    """A red wall that leans away, 160 x 120."""
    leaning = Body("wall", ObjectModel("wall", Surface(), (250, 0, 0)), from_rpy((0, 0, 1.2), (0.6, 0.3, 0)))
    return capture(World((leaning,)), Camera(Pinhole(160, 120, 140.0, 140.0, 79.5, 59.5), np.eye(4)))


def test_a_surface_has_no_holes() -> None:
    image = draw(wall(), size=SIZE)
    assert (image[4:-4, 4:-4, 2] == 0).all()  # the background has blue, the wall has none


def test_single_lost_points_are_bridged() -> None:
    holed = wall()
    for name in "xyz":
        holed[name][5:-5:4, 5:-5:4] = np.nan
    image = draw(holed, size=SIZE)
    assert (image[4:-4, 4:-4, 2] == 0).all()  # the background has blue, the wall has none


def test_the_order_of_loose_points_does_not_matter() -> None:
    loose = cloud(Kinect()).reshape(1, -1)
    shuffled = np.ascontiguousarray(loose[:, np.random.default_rng(1).permutation(loose.shape[1])])
    eye = Eye(np.eye(4), 1.0)
    one, other = draw(loose, eye=eye, size=SIZE), draw(shuffled, eye=eye, size=SIZE)
    assert (drawn(one, other)).mean() < 0.02  # discs at exactly the same depth, and a spacing sampled elsewhere


def test_moving_eye_and_points_together_changes_nothing() -> None:
    points = cloud().reshape(1, -1)
    T = from_rpy((0.5, -1.0, 2.0), (0.3, -0.6, 1.1))
    xyz = np.stack([points[axis] for axis in "xyz"], axis=-1)
    moved = points.copy()
    for axis, values in zip("xyz", np.moveaxis(transform_xyz(T, xyz), -1, 0), strict=True):
        moved[axis] = values
    before = draw(points, eye=Eye(np.eye(4), 1.0), size=SIZE)
    after = draw(moved, eye=Eye(T, 1.0), size=SIZE)
    assert drawn(before, after).mean() < 0.02


def test_a_near_point_hides_a_far_one() -> None:
    points = from_xyz([[0, 0, 2.0], [0, 0, 1.0]], [[200, 0, 0], GREEN])
    for order in ([0, 1], [1, 0]):
        image = draw(np.ascontiguousarray(points[:, order]), eye=Eye(np.eye(4), 0.5), size=SIZE)
        assert is_green(image)[118:122, 158:162].any()
        assert not (image[..., 0] > 100).any()


def test_an_eye_around_a_target_has_it_in_the_middle_and_up_upward() -> None:
    target, up = np.array([0.2, 0.1, 1.4]), np.array([0.0, -0.9, -0.4])
    for azimuth in (0.0, 1.0, 3.0):
        eye = eye_around(target, up, 0.7, azimuth, 0.5)
        T_eye_points = np.linalg.inv(eye.T_points_eye)
        assert np.allclose(T_eye_points[:3, :3] @ target + T_eye_points[:3, 3], [0, 0, 0.7])
        right, down, forward = T_eye_points[:3, :3] @ up / np.linalg.norm(up)
        assert abs(right) < 1e-12
        assert down < 0
        assert np.isclose(-forward, np.sin(0.5))
        assert np.isclose(np.linalg.det(eye.T_points_eye), 1)
    with pytest.raises(GeometryError, match="direction"):
        eye_around(target, (0, 0, 0), 1.0)


def test_looking_straight_along_up_works() -> None:
    eye = eye_around((0, 0, 1), (0, 0, 1), 0.5, elevation=np.pi / 2)
    assert np.isfinite(eye.T_points_eye).all()


def test_an_outline_lies_on_the_edges_of_its_box() -> None:
    points, eye = cloud(), Eye(np.eye(4), 2 * np.arctan(160 / 280))
    plain = draw(points, eye=eye, size=SIZE)
    box = Outline(Box((0.2, 0.1, 0.1)), from_rpy((-0.1, 0.1, 1.0), (0, 0, 0)), (0, 255, 255), dashed=False)
    changed = drawn(draw(points, [box], eye, SIZE), plain)
    rows, columns = np.nonzero(changed)
    near, focal = 0.95, 280.0
    assert abs(columns.min() - (159.5 + focal * -0.2 / near)) < 3
    assert abs(columns.max() - (159.5 + focal * 0.0 / near)) < 6  # the far right edge reaches a little farther
    assert abs(rows.max() - (119.5 + focal * 0.15 / near)) < 3


def test_each_axis_of_a_triad_has_its_colour() -> None:
    points = cloud()
    tilted = from_rpy((0, 0, 0.8), (0.5, 0.5, 0))
    image = draw(points, [Triad(tilted, 0.1)], size=SIZE).astype(int)
    plain = draw(points, size=SIZE).astype(int)
    new = np.abs(image - plain).sum(axis=-1) > 60
    red, green, blue = (image[..., k] for k in range(3))
    assert (new & (red > 1.8 * green) & (red > 1.8 * blue)).sum() > 20
    assert (new & (green > 1.5 * red) & (green > 1.5 * blue)).sum() > 20
    assert (new & (blue > 1.5 * red) & (blue > 1.3 * green)).sum() > 20


def test_labels_do_not_cover_each_other() -> None:
    points = cloud()
    eye = own_eye(points, SIZE)
    place = from_rpy((0, 0, 1.0), (0, 0, 0))
    ball = Sphere(0.05)
    one = draw(points, [Outline(ball, place, label="first")], eye, SIZE)
    both = draw(points, [Outline(ball, place, label="first"), Outline(ball, place, label="second one")], eye, SIZE)
    bare = draw(points, [Outline(ball, place)], eye, SIZE)
    first, second = drawn(one, bare), drawn(both, one)
    assert (first & second).sum() < 0.1 * first.sum()


def test_a_legend_stands_in_the_lower_left_corner() -> None:
    points = cloud()
    plain = draw(points, size=SIZE)
    changed = drawn(draw(points, [Legend(("found\t1 2 3", "a line"), "title")], size=SIZE), plain)
    rows, columns = np.nonzero(changed)
    assert rows.min() > 120
    assert columns.max() < 160
    assert changed.sum() > 1000


def test_what_is_behind_the_eye_is_left_out() -> None:
    points = cloud()
    behind = from_rpy((0, 0, -1), (0, 0, 0))
    drawings: list[Drawing] = [Outline(Box((0.1, 0.1, 0.1)), behind, label="box"), Triad(behind, 0.1, "frame")]
    assert np.array_equal(draw(points, drawings, size=SIZE), draw(points, size=SIZE))


@pytest.mark.parametrize("shape", [(1, 0), (1, 1), (4, 4)])
def test_a_cloud_of_nothing_is_an_empty_picture(shape: tuple[int, int]) -> None:
    empty = from_xyz(np.full((*shape, 3), np.nan))
    image = draw(empty, size=SIZE)
    assert (image == image[:, :1]).all()


def test_colour_by_depth_where_there_is_no_rgb() -> None:
    slope = from_xyz(np.column_stack([np.linspace(-0.3, 0.3, 50), np.zeros(50), np.linspace(1, 2, 50)]))
    image = draw(slope, eye=Eye(np.eye(4), 1.0), size=SIZE)
    left, right = image[:, :160].reshape(-1, 3).max(axis=0), image[:, 160:].reshape(-1, 3).max(axis=0)
    assert right[0] > left[0] + 50  # yellow is far, violet near


def test_a_saved_picture_comes_back(tmp_path: Path) -> None:
    image = draw(cloud(), size=SIZE)
    save_png(tmp_path / "picture.png", image)
    assert np.array_equal(np.asarray(Image.open(tmp_path / "picture.png")), image)
    with pytest.raises(FileError):
        save_png(tmp_path / "picture.png", image, overwrite=False)
    assert [path.name for path in tmp_path.iterdir()] == ["picture.png"]


def test_a_tiny_picture_is_refused() -> None:
    with pytest.raises(GeometryError, match="at least 16"):
        draw(cloud(), size=(0, 10))
