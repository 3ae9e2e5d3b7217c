"""Turns that leave a shape as it is, on shapes whose symmetry is known."""

from __future__ import annotations

import numpy as np
import pytest

from zsight_core.model import Box, Cylinder, Mesh, Shape, Sphere, Surface
from zsight_core.solid import solid_of
from zsight_core.symmetry import symmetries_of


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
