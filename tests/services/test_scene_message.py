"""The message of a scene says what the scene stage found, and its label image comes back."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.core import book_scene as book

from zsight.convert import matrix_of
from zsight.scene_message import image_of, labels_of, scene_of
from zsight_core.model import Box, Cylinder, ObjectModel
from zsight_core.points import xyz
from zsight_core.scene import understand
from zsight_core.simulation.kinect import Kinect
from zsight_protocol.codec import decode, encode
from zsight_protocol.message import Header, Time
from zsight_protocol.scene import LabelImage, Scene

HEADER = Header(stamp=Time(sec=7), frame_id="eye")
CRATE = ObjectModel("crate", Box((0.2, 0.14, 0.05)))
CUP = ObjectModel("cup", Cylinder(0.08, 0.1))
Z = book.TABLE_HEIGHT


@given(seed=st.integers(0, 2**32 - 1), height=st.integers(1, 9), width=st.integers(1, 9))
def test_labels_come_back(seed: int, height: int, width: int) -> None:
    labels = np.random.default_rng(seed).integers(-1, 4, (height, width)).astype(np.int32)
    image = image_of(labels)
    np.testing.assert_array_equal(labels_of(image), labels)
    assert len(image.runs) == 4 * (height + np.count_nonzero(np.diff(labels, axis=1)))


def test_a_cloud_without_rows_has_no_image() -> None:
    flat = book.cloud().reshape(1, -1)
    assert scene_of(understand(flat), HEADER, {}).labels is None


@pytest.mark.parametrize("runs", [b"", bytes(4), b"\0\0\5\0", b"\0\0\4\0\0"])
def test_runs_that_do_not_fill_their_image_are_refused(runs: bytes) -> None:
    with pytest.raises(ValueError, match="expected 2 x 2 = 4"):
        labels_of(LabelImage(height=2, width=2, runs=runs))


def test_the_message_says_what_was_found() -> None:
    T = book.T_WORLD_CAMERA
    points = book.cloud((CRATE, book.at(0.6, -0.3, Z + 0.025)), (CUP, book.at(0.6, 0.0, Z + 0.05)), noise=Kinect())
    scene = understand(points, T_world_camera=T)
    assert len(scene.segments) == 2
    told = decode(Scene, encode(scene_of(scene, HEADER, {2: "crate"}, "finder")))
    assert (told.header, told.finder) == (HEADER, "finder")
    table = told.supports[0]
    assert table.height == pytest.approx(Z, abs=0.001)
    assert (T @ matrix_of(table.pose))[2, 3] == pytest.approx(Z, abs=0.001)
    assert [segment.type for segment in told.segments] == ["crate", ""]
    assert told.labels is not None
    np.testing.assert_array_equal(labels_of(told.labels), scene.labels)
    places = {"crate": (0.6, -0.3, 0.05), "cup": (0.6, 0.0, 0.1)}
    for segment in told.segments:
        x, y, tall = min(places.values(), key=lambda at: abs((T @ matrix_of(segment.pose))[1, 3] - at[1]))
        T_world_box = T @ matrix_of(segment.pose)
        assert T_world_box[:2, 3] == pytest.approx([x, y], abs=0.03)
        assert segment.high == pytest.approx(tall, abs=0.008)
        assert [layer.height for layer in segment.layers] == pytest.approx([tall], abs=0.003)
        T_world_surface = T @ matrix_of(told.supports[segment.support].pose)
        corners = np.array([[*corner, 0.0, 1.0] for corner in segment.layers[0].outline]) @ T_world_surface.T
        assert corners[:, :2].mean(axis=0) == pytest.approx([x, y], abs=0.03)


def test_a_region_without_depth_is_told() -> None:
    points = book.cloud(noise=Kinect())
    T = book.T_WORLD_CAMERA
    world = xyz(points).astype(float) @ T[:3, :3].T + T[:3, 3]
    blind = (np.abs(world - [0.6, -0.3, Z]) < [0.06, 0.04, 0.02]).all(axis=2)
    for axis in "xyz":
        points[axis][blind] = np.nan
    scene = understand(points, T_world_camera=book.T_WORLD_CAMERA)
    (region,) = (hole for hole in scene_of(scene, HEADER, {}).missing if hole.support == 0)
    assert not region.is_shadow
    assert (T @ matrix_of(region.pose))[:3, 3] == pytest.approx([0.6, -0.3, Z], abs=0.01)
    assert region.area == pytest.approx(0.12 * 0.08, rel=0.15)


def test_it_is_small() -> None:
    points = book.cloud((CRATE, book.at(0.6, -0.3, Z + 0.025)), noise=Kinect())
    message = scene_of(understand(points, T_world_camera=book.T_WORLD_CAMERA), HEADER, {})
    assert len(encode(message)) < 0.02 * points.nbytes
