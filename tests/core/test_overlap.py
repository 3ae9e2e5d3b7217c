"""Two solids share room as far as one is inside the other, whichever is named first."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial import ConvexHull

from zsight_core.model import Box, Cylinder, Mesh, Shape, Sphere
from zsight_core.search.overlap import _hull, hull_area, shared
from zsight_core.solid import solid_of
from zsight_core.transform import from_rpy

Faces = np.ndarray[Any, np.dtype[np.int32]]
Corners = np.ndarray[Any, np.dtype[np.float64]]

BLOCK = solid_of(Box((0.04, 0.2, 0.04)))
BALL = solid_of(Sphere(0.06))


def test_at_one_place_all_is_shared() -> None:
    T = from_rpy((0.3, -0.2, 1.0), (0.1, 0.2, 0.3))
    assert shared(BLOCK, T, BLOCK, T) == 1.0


@pytest.mark.parametrize("along", [0.05, 0.1, 0.15])
def test_share_falls_as_one_slides_along_the_other(along: float) -> None:
    share = shared(BLOCK, np.eye(4), BLOCK, from_rpy((0, along, 0), (0, 0, 0)))
    assert share == pytest.approx(1 - along / 0.2, abs=0.1)


def test_side_by_side_nothing_is_shared() -> None:
    assert shared(BLOCK, np.eye(4), BLOCK, from_rpy((0.0401, 0, 0), (0, 0, 0))) == 0.0
    assert shared(BLOCK, np.eye(4), BALL, from_rpy((1.0, 0, 0), (0, 0, 0))) == 0.0


def test_what_is_all_inside_of_a_larger_one_is_shared_either_way() -> None:
    can = solid_of(Cylinder(0.1, 0.2))
    assert shared(BALL, np.eye(4), can, np.eye(4)) == 1.0
    assert shared(can, np.eye(4), BALL, np.eye(4)) == 1.0


@pytest.mark.parametrize("shape", [Box((0.04, 0.2, 0.04)), Cylinder(0.066, 0.122), Sphere(0.07)])
@pytest.mark.parametrize("coarse", [False, True])
def test_a_convex_solid_is_its_own_hull(shape: Shape, coarse: bool) -> None:
    solid = solid_of(shape, coarse=coarse)
    hull = ConvexHull(solid.vertices)
    assert hull_area(solid) == pytest.approx(hull.area)
    assert_allclose(_hull(solid).sides, np.unique(hull.equations.round(9), axis=0), atol=1e-9)


def test_a_hollow_has_the_hull_of_its_rim() -> None:
    solid = solid_of(Box((0.2, 0.2, 0.2)))
    dented = Mesh(
        np.concatenate([solid.vertices, [[0.0, 0.0, 0.05]]]), _with_its_top_at(solid.faces, solid.vertices, 8)
    )
    assert hull_area(solid_of(dented)) == pytest.approx(6 * 0.2**2)


def _with_its_top_at(faces: Faces, vertices: Corners, place: int) -> Faces:
    """The faces, those on top replaced by four that meet in one more vertex."""
    top = (vertices[faces][..., 2] > 0).all(axis=1)
    edges = {(a, b) for face in faces[top].tolist() for a, b in zip(face, face[1:] + face[:1], strict=True)}
    around = [(a, b, place) for a, b in edges if (b, a) not in edges]
    return np.concatenate([faces[~top], np.array(around, np.int32)])


def test_area_is_that_of_the_sides() -> None:
    assert hull_area(BLOCK) == pytest.approx(4 * 0.04 * 0.2 + 2 * 0.04**2)
