"""Where finds look: the box around what was drawn, down to the surface that it stands on."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from zsight.viewer.region import feet, region_around
from zsight_core.transform import from_rpy

if TYPE_CHECKING:
    from numpy.typing import NDArray

OUTLINE = np.array([(-0.3, -0.2), (0.3, -0.2), (0.3, 0.2), (-0.3, 0.2)])
TABLE = from_rpy((1.0, 0.5, 0.7), (0, 0, 0.4))
FLOOR = from_rpy((1.0, 0.5, 0.0), (0, 0, 0))
TOP = np.array([(x, y, 0.1) for x in (-0.05, 0.05) for y in (-0.02, 0.02)])


def on(T: NDArray[np.float64]) -> NDArray[np.float64]:
    """The top of a thing, as it stands on the surface at T."""
    return np.asarray(TOP @ T[:3, :3].T + T[:3, 3])


def test_points_go_down_to_the_surface_they_stand_over() -> None:
    below = feet(on(TABLE), [(FLOOR, 10 * OUTLINE), (TABLE, OUTLINE)])
    np.testing.assert_allclose(below, on(TABLE) - np.array([0, 0, 0.1]), atol=1e-12)
    region = region_around(np.concatenate([on(TABLE), below]), 0.02)
    np.testing.assert_allclose((region.low[2], region.high[2]), (0.68, 0.82))


def test_points_beside_the_table_go_down_to_the_floor() -> None:
    aside = on(TABLE) + np.array([0.5, 0, 0])
    np.testing.assert_allclose(feet(aside, [(TABLE, OUTLINE), (FLOOR, 10 * OUTLINE)])[:, 2], 0, atol=1e-12)


def test_a_surface_above_or_beside_or_without_an_outline_counts_for_nothing() -> None:
    over = TABLE.copy()
    over[2, 3] = 1.0
    assert feet(on(TABLE), [(over, OUTLINE), (TABLE, OUTLINE + 2.0), (TABLE, OUTLINE[:2])]).shape == (0, 3)
    assert feet(on(TABLE), []).shape == (0, 3)


def test_feet_follow_a_surface_that_leans() -> None:
    leaning = from_rpy((0.0, 0.0, 1.0), (0.5, 0.2, 0.0))
    heights = (feet(on(leaning), [(leaning, OUTLINE)]) - leaning[:3, 3]) @ leaning[:3, 2]
    np.testing.assert_allclose(heights, 0, atol=1e-12)
