from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from tests.core.clouds import LAYOUTS, coordinates, finite, in_layout, random_cloud

from zsight_core.errors import GeometryError, PointsError
from zsight_core.points import colours, from_xyz
from zsight_core.statistics import average_colour, bounding_box, centroid, count_finite


@pytest.mark.parametrize("layout", LAYOUTS)
def test_equal_the_reference(layout: str) -> None:
    cloud = random_cloud()
    rows, points = finite(cloud), in_layout(cloud, layout)
    assert_allclose(centroid(points), rows.astype(np.float64).mean(axis=0), atol=1e-6)
    low, high = bounding_box(points)
    assert_array_equal(low, rows.min(axis=0))
    assert_array_equal(high, rows.max(axis=0))
    assert count_finite(points) == len(rows)
    keep = np.isfinite(coordinates(cloud)).all(axis=1)
    assert_array_equal(average_colour(points), np.round(colours(cloud).reshape(-1, 3)[keep].mean(axis=0)))


@settings(max_examples=60, deadline=None)
@given(
    st.lists(
        st.tuples(*[st.floats(width=32, allow_nan=True, allow_infinity=True, allow_subnormal=False)] * 3), max_size=70
    )
)
def test_bounding_box_of_any_floats(rows: list[tuple[float, float, float]]) -> None:
    xyz = np.array(rows, np.float32).reshape(-1, 3)
    kept = xyz[np.isfinite(xyz).all(axis=1)]
    assert count_finite(xyz) == len(kept)
    if len(kept) == 0:
        with pytest.raises(GeometryError, match="at least one"):
            bounding_box(xyz)
        return
    low, high = bounding_box(xyz)
    assert_array_equal(low, kept.min(axis=0))
    assert_array_equal(high, kept.max(axis=0))


def test_nothing_has_no_centre() -> None:
    cloud = random_cloud(holes=1.0)
    cloud.reshape(-1)["x"] = np.nan
    for ask in (centroid, bounding_box, average_colour):
        with pytest.raises(GeometryError, match="at least one"):
            ask(cloud)
    with pytest.raises(PointsError, match="rgb"):
        average_colour(from_xyz(np.zeros((2, 3))))
