"""Two solids share room as far as one is inside the other, whichever is named first."""

from __future__ import annotations

import numpy as np
import pytest

from zsight_core.model import Box, Cylinder, Sphere
from zsight_core.overlap import hull_area, shared
from zsight_core.solid import solid_of
from zsight_core.transform import from_rpy

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


def test_area_is_that_of_the_sides() -> None:
    assert hull_area(BLOCK) == pytest.approx(4 * 0.04 * 0.2 + 2 * 0.04**2)
