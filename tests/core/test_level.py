"""A level surface tells roll, pitch and height of the camera; a frame of the wrong kind shows."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from zsight_core.errors import GeometryError
from zsight_core.level import T_BODY_OPTICAL, frame_mistake, level_camera
from zsight_core.transform import from_quaternion, from_rpy, inverse

if TYPE_CHECKING:
    from numpy.typing import NDArray


@given(
    st.floats(0.1, 1.4),
    st.floats(-0.5, 0.5),
    st.floats(0.3, 3.0),
    st.floats(-1.0, 1.0),
)
def test_a_camera_is_levelled_by_the_plane_it_sees(pitch: float, roll: float, above: float, surface: float) -> None:
    T_world_camera = from_rpy((0, 0, surface + above), (roll, pitch, 0)) @ T_BODY_OPTICAL
    normal = T_world_camera[2, :3]  # the world's up, seen by the camera
    found = level_camera(normal, -above, surface)
    np.testing.assert_allclose(found[2], T_world_camera[2], atol=1e-9)  # up and height are those of the truth
    np.testing.assert_allclose(found[:3, :3] @ found[:3, :3].T, np.eye(3), atol=1e-9)
    assert found[1, 2] == pytest.approx(0, abs=1e-9)  # it looks along x
    assert found[0, 2] > 0


@given(st.floats(0.1, 1.4), st.floats(-0.5, 0.5), st.floats(-3.1, 3.1), st.floats(-0.2, 0.2), st.floats(-0.2, 0.2))
def test_place_and_yaw_stay_what_they_were(pitch: float, roll: float, yaw: float, error: float, lift: float) -> None:
    T_world_camera = from_rpy((0.4, -0.3, 1.5), (roll, pitch, yaw)) @ T_BODY_OPTICAL
    x, y = T_world_camera[:2, 2]
    tilt = from_rpy((0.4, -0.3, 1.5 + lift), (0, 0, 0)) @ _turned_about((-y, x, 0), error)
    taken_for = tilt @ inverse(from_rpy((0.4, -0.3, 1.5), (0, 0, 0))) @ T_world_camera
    found = level_camera(T_world_camera[2, :3], -1.5, 0.0, taken_for)
    np.testing.assert_allclose(found, T_world_camera, atol=1e-9)


def _turned_about(axis: tuple[float, float, float], angle: float) -> NDArray[np.float64]:
    """A rotation (4, 4)."""
    half = np.array(axis) / np.linalg.norm(axis) * np.sin(angle / 2)
    return from_quaternion((0, 0, 0), (*half, np.cos(angle / 2)))


def test_a_camera_that_looks_straight_down_has_no_forward() -> None:
    with pytest.raises(GeometryError, match="straight down"):
        level_camera(np.array([0.0, 0.0, -1.0]), -1.0)


@given(st.floats(0.0, 1.2), st.floats(-3, 3))
def test_a_right_frame_is_not_blamed_and_a_wrong_one_is_named(pitch: float, yaw: float) -> None:
    T_world_body = from_rpy((0, 0, 1), (0, pitch, yaw))
    T_world_optical = T_world_body @ T_BODY_OPTICAL
    up = np.array([0.0, 0.0, 1.0])
    normal_optical = T_world_optical[:3, :3].T @ up
    normal_body = T_world_body[:3, :3].T @ up
    assert frame_mistake(normal_optical, T_world_optical) == ""
    assert frame_mistake(normal_body, T_world_body) == ""
    assert "cloud is in an optical frame" in frame_mistake(normal_optical, T_world_body)
    assert "cloud is in a body frame" in frame_mistake(normal_body, T_world_optical)


def test_any_other_tilt_is_told_too() -> None:
    T_world_camera = from_rpy((0, 0, 1), (0, 0.8, 0)) @ T_BODY_OPTICAL
    normal = inverse(T_world_camera)[:3, :3] @ np.array([np.sin(0.8), 0, np.cos(0.8)])
    assert "zsight calibrate level" in frame_mistake(normal, T_world_camera)
