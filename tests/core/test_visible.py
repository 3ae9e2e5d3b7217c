"""What an eye sees of a cloud within a rectangle."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from zsight_core.transform import from_rpy, inverse
from zsight_core.visible import Lens, Rectangle, visible

if TYPE_CHECKING:
    from numpy.typing import NDArray

WHOLE = Rectangle(0, 0, 1, 1)
TANGENTS = (0.6, 0.4)


def sheet(z: float, half: float, spacing: float) -> NDArray[np.float64]:
    """A square across the optical axis, (N, 3)."""
    ticks = np.arange(-half, half + spacing / 2, spacing)
    x, y = np.meshgrid(ticks, ticks)
    return np.stack([x.ravel(), y.ravel(), np.full(x.size, z)], axis=1)


PANEL, WALL = sheet(1.0, 0.1, 0.005), sheet(1.5, 0.3, 0.01)
HIDDEN = np.abs(WALL[:, :2] / 1.5).max(axis=1) <= 0.1  # rays to these cross the panel
SCENE = np.concatenate([PANEL, WALL])


def seen(points: NDArray[np.float64], T_eye: NDArray[np.float64], part: Rectangle = WHOLE) -> NDArray[np.bool_]:
    return visible(points, Lens(T_eye, *TANGENTS), part, 0.01)


def test_what_stands_behind_is_left_out_and_the_rest_is_not() -> None:
    mask = seen(SCENE, np.eye(4))
    assert mask[: len(PANEL)].all()
    wall = mask[len(PANEL) :]
    assert not wall[HIDDEN].any()
    assert wall[~HIDDEN].mean() > 0.9  # what is lost lies within two discs of the panel's rim
    far = np.abs(WALL[:, :2] / 1.5).max(axis=1) > 0.1 + 0.025
    assert wall[far].all()


@pytest.mark.parametrize("rpy", [(0.0, 0.0, 0.3), (0.2, -0.1, 0.0), (-0.1, 0.15, 1.0)])
def test_what_is_seen_moves_with_eye_and_scene(rpy: tuple[float, float, float]) -> None:
    T = from_rpy((0.5, -2.0, 3.0), rpy)
    moved = SCENE @ T[:3, :3].T + T[:3, 3]
    same = seen(moved, inverse(T)) == seen(SCENE, np.eye(4))
    assert same.mean() > 0.98  # rounding decides for points on the border of two cells


def test_only_what_lies_in_the_rectangle() -> None:
    part = Rectangle(0.5, 0.25, 0.75, 0.5)
    mask = seen(WALL, np.eye(4), part)
    across = WALL[:, 0] / 1.5 / TANGENTS[0] / 2 + 0.5
    down = WALL[:, 1] / 1.5 / TANGENTS[1] / 2 + 0.5
    np.testing.assert_array_equal(mask, (across >= 0.5) & (across <= 0.75) & (down >= 0.25) & (down <= 0.5))


def test_a_slanted_floor_does_not_hide_itself() -> None:
    ticks = np.arange(-0.3, 0.3, 0.005)
    x, z = np.meshgrid(ticks, np.arange(1.0, 2.0, 0.005))
    floor = np.stack([x.ravel(), 0.3 + 0.05 * (z.ravel() - 1), z.ravel()], axis=1)  # seen at some 12 degrees
    mask = seen(floor, np.eye(4))
    on_screen = floor[:, 1] / floor[:, 2] < TANGENTS[1]
    assert mask[on_screen].mean() > 0.95


def test_holes_and_what_lies_behind_the_eye_are_never_seen() -> None:
    points = np.array([[np.nan, 0, 1], [0, 0, -1], [0, 0, 1], [5, 0, 1]], dtype=np.float64)
    assert seen(points, np.eye(4)).tolist() == [False, False, True, False]
    assert seen(points[:2], np.eye(4)).tolist() == [False, False]
