"""Clouds as depth images: back within one unit, the second time exactly; what is no depth camera's is not touched."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from zsight_core import depth_code, depth_image
from zsight_core.pinhole import Pinhole
from zsight_core.points import Points, colours, from_xyz, has_colour, xyz

CAMERA = Pinhole(24, 18, 20.0, 21.0, 11.5, 8.5)


def seen(seed: int, *, far: float = 3.0, colour: bool = True) -> Points:
    rng = np.random.default_rng(seed)
    depth = rng.uniform(0.3, far, (18, 24)).astype(np.float32)
    depth[rng.random((18, 24)) < 0.2] = np.nan
    rgb = rng.integers(0, 256, (18, 24, 3), dtype=np.uint8) if colour else None
    return depth_image.to_points(depth, CAMERA, colour=rgb)


@given(seed=st.integers(0, 1000), far=st.sampled_from([1.0, 6.0, 15.0]), colour=st.booleans())
def test_a_cloud_comes_back_within_a_unit_and_the_second_time_exactly(seed: int, far: float, colour: bool) -> None:
    points = seen(seed, far=far, colour=colour)
    coded = depth_code.code(points, CAMERA)
    assert coded is not None
    depth, rgb, scale = coded
    assert scale == depth_code.SCALES[far > 6.5]
    back = depth_code.decode(depth, rgb, CAMERA, scale)
    np.testing.assert_array_equal(np.isnan(xyz(back)), np.isnan(xyz(points)))
    assert np.nanmax(np.abs(xyz(back) - xyz(points))) <= scale * 1.001
    assert has_colour(back) is colour
    if colour:
        np.testing.assert_array_equal(colours(back), colours(points))
    again = depth_code.code(back, CAMERA)
    assert again is not None
    np.testing.assert_array_equal(again[0], depth)
    assert depth_code.decode(again[0], again[1], CAMERA, again[2]).tobytes() == back.tobytes()


def test_what_would_not_come_back_is_not_coded() -> None:
    points = seen(1)
    assert depth_code.code(points.reshape(1, -1), CAMERA) is None
    assert depth_code.code(points, Pinhole(24, 18, 20.5, 21.0, 11.5, 8.5)) is None
    moved = points.copy()
    moved["x"] += np.float32(0.1)
    assert depth_code.code(moved, CAMERA) is None
    assert depth_code.code(seen(1, far=40.0), CAMERA) is None
    odd = points.copy()
    odd["x"][0, 0], odd["z"][0, 0] = 1.0, np.nan
    assert depth_code.code(odd, CAMERA) is None
    alpha = points.copy()
    alpha["rgb"].view(np.uint32)[0, 0] |= np.uint32(0x40000000)
    assert depth_code.code(alpha, CAMERA) is None


@pytest.mark.parametrize("shape", [(3, 4), (18, 24)])
def test_more_fields_are_not_coded(shape: tuple[int, int]) -> None:
    assert depth_code.code(np.zeros(shape, [("x", "<f4"), ("intensity", "<f4")]), CAMERA) is None
    assert depth_code.code(from_xyz(np.zeros((*shape, 3))), CAMERA) is None
