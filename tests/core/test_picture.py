"""Pictures show what is where: pixels at known places, nothing where nothing is."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from PIL import Image

from zsight_core.errors import FileError
from zsight_core.model import Box, Cylinder, Mesh, Sphere
from zsight_core.picture import Eye, Legend, Outline, Triad, draw, eye_around, own_eye, save_png
from zsight_core.pinhole import Pinhole
from zsight_core.points import from_xyz

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

SIZE = (160, 120)


def wall(distance: float = 1.0, colour: tuple[int, int, int] = (200, 40, 40)) -> NDArray[np.void]:
    """An organised cloud of a wall across the view, seen by a camera of 80 x 60 pixels."""
    v, u = np.mgrid[0:60, 0:80]
    xyz = np.stack([(u - 39.5) / 80, (v - 29.5) / 80, np.ones((60, 80))], axis=-1) * distance
    return from_xyz(xyz, np.broadcast_to(np.array(colour, np.uint8), xyz.shape))


def test_an_organised_cloud_fills_its_picture_without_holes() -> None:
    image = draw(wall(), size=SIZE)
    assert image.shape == (120, 160, 3)
    assert image.dtype == np.uint8
    inside = image[10:-10, 10:-10].astype(int)
    assert (inside[..., 0] > inside[..., 1] + 60).all()  # red everywhere


def test_an_unorganised_cloud_becomes_discs_where_its_points_are() -> None:
    eye = Eye(np.eye(4), field_of_view=0.8)
    image = draw(from_xyz([[0.0, 0.0, 1.0]], [[255, 0, 0]]), eye=eye, size=SIZE).astype(int)
    red = np.argwhere(image[..., 0] > image[..., 1] + 100)
    assert len(red) > 0
    np.testing.assert_allclose(red.mean(axis=0), [59.5, 79.5], atol=1.0)


def test_holes_and_clouds_of_nothing_are_background() -> None:
    cloud = wall()
    for axis in "xyz":
        cloud[axis] = np.nan
    empty = draw(cloud, size=SIZE)
    np.testing.assert_array_equal(empty, draw(from_xyz(np.full((1, 3), np.nan)), size=SIZE))


def test_the_nearer_of_two_walls_is_seen() -> None:
    both = np.concatenate([wall(1.0, (255, 0, 0)).reshape(1, -1), wall(2.0, (0, 0, 255)).reshape(1, -1)], axis=1)
    image = draw(both, eye=own_eye(wall(), SIZE), size=SIZE).astype(int)
    middle = image[40:80, 60:100]
    assert (middle[..., 0] > middle[..., 2]).mean() > 0.95


@pytest.mark.parametrize(
    "shape",
    [
        Box((0.2, 0.1, 0.1)),
        Cylinder(0.1, 0.2),
        Sphere(0.2),
        Mesh(np.eye(4, 3) * 0.2, np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]], dtype=np.int32)),
    ],
)
def test_an_outline_is_drawn_around_its_place(shape: Box | Cylinder | Sphere | Mesh) -> None:
    T = np.eye(4)
    T[:3, 3] = (0.0, 0.0, 0.8)
    plain = draw(wall(), size=SIZE).astype(int)
    drawn = draw(wall(), [Outline(shape, T, label="thing")], size=SIZE).astype(int)
    changed = np.argwhere(np.abs(drawn - plain).sum(axis=2) > 30)
    assert len(changed) > 20
    middle = changed.mean(axis=0)
    assert abs(middle[0] - 60) < 40
    assert abs(middle[1] - 80) < 40


def test_a_triad_points_where_its_axes_do() -> None:
    T = np.eye(4)
    T[:3, 3] = (0.0, 0.0, 0.9)
    image = draw(wall(colour=(128, 128, 128)), [Triad(T, length=0.2)], size=(320, 240)).astype(int)
    red = np.argwhere((image[..., 0] > image[..., 1] + 60) & (image[..., 0] > image[..., 2] + 60))
    green = np.argwhere((image[..., 1] > image[..., 0] + 40) & (image[..., 1] > image[..., 2] + 40))
    assert red[:, 1].mean() > 160  # x to the right
    assert abs(red[:, 0].mean() - 120) < 15
    assert green[:, 0].mean() > 120  # y downwards, in an optical frame
    assert abs(green[:, 1].mean() - 160) < 15


def test_a_legend_stands_in_the_lower_left_corner() -> None:
    plain = draw(wall(), size=SIZE).astype(int)
    drawn = draw(wall(), [Legend(("found\tyes",), title="find")], size=SIZE).astype(int)
    changed = np.argwhere(np.abs(drawn - plain).sum(axis=2) > 30)
    assert changed[:, 0].mean() > 60
    assert changed[:, 1].mean() < 80


def test_what_is_behind_the_eye_is_left_out() -> None:
    T = np.eye(4)
    T[:3, 3] = (0.0, 0.0, -1.0)
    plain = draw(wall(), size=SIZE)
    np.testing.assert_array_equal(plain, draw(wall(), [Outline(Sphere(0.1), T), Triad(T)], size=SIZE))


def test_the_own_eye_has_the_cameras_field_of_view() -> None:
    pinhole = Pinhole(80, 60, 80.0, 80.0, 39.5, 29.5)
    eye = own_eye(wall(), size=(800, 600))
    assert eye.field_of_view == pytest.approx(2 * np.arctan(pinhole.width / pinhole.fx / 2), rel=0.03)


def test_an_eye_around_looks_at_its_target() -> None:
    eye = eye_around((0.1, 0.2, 1.0), up=(0, -1, 0), distance=0.5, azimuth=0.3, elevation=0.6)
    seen = np.linalg.inv(eye.T_points_eye) @ np.array([0.1, 0.2, 1.0, 1.0])
    np.testing.assert_allclose(seen[:3], [0, 0, 0.5], atol=1e-12)


def test_a_png_reads_back_and_an_impossible_one_is_told(tmp_path: Path) -> None:
    image = draw(wall(), size=SIZE)
    save_png(tmp_path / "a.png", image)
    with Image.open(tmp_path / "a.png") as read:
        np.testing.assert_array_equal(np.asarray(read), image)
    with pytest.raises(FileError):
        save_png(tmp_path / "missing" / "a.png", image)
    assert [path.name for path in tmp_path.iterdir()] == ["a.png"]
