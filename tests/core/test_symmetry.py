"""Turns that leave a shape as it is, on shapes whose symmetry is known."""

from __future__ import annotations

import numpy as np
import pytest

from zsight_core.model import Box, Cylinder, Mesh, Shape, Sphere, Surface
from zsight_core.search.symmetry import least_turned, symmetries_of
from zsight_core.solid import solid_of
from zsight_core.transform import from_rpy


def orders(shape: Shape) -> dict[int, int]:
    """Order of the symmetry about each axis that has one."""
    return {int(np.argmax(turn.axis)): turn.order for turn in symmetries_of(shape)}


def as_mesh(shape: Shape) -> Mesh:
    solid = solid_of(shape)
    return Mesh(solid.vertices, solid.faces)


@pytest.mark.parametrize(
    ("shape", "expected"),
    [
        (Box((0.1, 0.2, 0.3)), {0: 2, 1: 2, 2: 2}),
        (Box((0.1, 0.2, 0.1)), {0: 2, 1: 4, 2: 2}),
        (Box((0.1, 0.1, 0.1)), {0: 4, 1: 4, 2: 4}),
        (Cylinder(0.06, 0.12), {0: 2, 1: 2, 2: 0}),
        (Sphere(0.1), {0: 0, 1: 0, 2: 0}),
    ],
)
def test_a_shape_and_its_mesh_have_the_same_symmetries(shape: Shape, expected: dict[int, int]) -> None:
    assert orders(shape) == expected
    assert orders(as_mesh(shape)) == expected


def test_a_surface_and_a_lopsided_mesh_have_none() -> None:
    corner = np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.07, 0], [0, 0, 0.04]], float)
    tetrahedron = Mesh(corner, np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], np.int32))
    assert symmetries_of(tetrahedron) == ()
    assert symmetries_of(Surface()) == ()


def test_a_difference_of_some_percent_counts() -> None:
    almost = Box((0.1, 0.12, 0.15))
    assert orders(as_mesh(almost))[2] == 2


BLOCK = Box((0.035, 0.2, 0.035))


@pytest.mark.parametrize("others", [(0, 0, np.pi), (np.pi, 0, 0), (0, np.pi / 2, 0), (0, np.pi, np.pi)])
def test_of_all_poses_that_look_alike_one_is_told(others: tuple[float, float, float]) -> None:
    R = from_rpy((0, 0, 0), (0, 0, 0.43))[:3, :3]
    alike = R @ from_rpy((0, 0, 0), others)[:3, :3]
    assert alike @ least_turned(alike, BLOCK) == pytest.approx(R, abs=1e-9)


def test_an_upright_can_has_no_yaw_and_a_lying_one_lies_as_it_does() -> None:
    can, ball = Cylinder(0.066, 0.122), Sphere(0.1)
    upright = from_rpy((0, 0, 0), (0, 0, 2.0))[:3, :3]
    assert upright @ least_turned(upright, can) == pytest.approx(np.eye(3), abs=1e-9)
    lying = from_rpy((0, 0, 0), (np.pi / 2, 0, 0.3))[:3, :3]
    told = lying @ least_turned(lying, can)
    assert abs(told[:, 2] @ lying[:, 2]) == pytest.approx(1)
    assert np.trace(told) >= np.trace(lying)
    assert upright @ least_turned(upright, ball) == pytest.approx(np.eye(3), abs=1e-9)


def test_what_has_a_front_stays_as_it_is() -> None:
    R = from_rpy((0, 0, 0), (0, 0, 3.0))[:3, :3]
    assert (least_turned(R, as_mesh(BLOCK)) == np.eye(3)).all()
