from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from tests.core.clouds import LAYOUTS, coordinates, in_layout, random_cloud

from zsight_core.errors import PointsError
from zsight_core.pack_fields import PCL_XYZRGB, concatenate, repack, select_fields, to_packed, to_pcl_layout
from zsight_core.points import XYZ, XYZRGB, from_xyz


@pytest.mark.parametrize("layout", LAYOUTS)
def test_there_and_back_loses_nothing(layout: str) -> None:
    cloud = random_cloud()
    cloud["rgb"].view(np.uint32)[...] |= np.uint32(0xFF000000)  # opaque colours are NaN as floats
    back = to_packed(in_layout(cloud, layout))
    assert back.dtype == XYZRGB
    assert back.tobytes() == cloud.tobytes()


def test_pcl_layout() -> None:
    cloud = random_cloud()
    wide = to_pcl_layout(cloud)
    assert wide.dtype == PCL_XYZRGB
    assert wide.dtype.itemsize == 32
    raw = np.frombuffer(wide.tobytes(), np.uint32).reshape(-1, 8)
    assert_array_equal(raw[:, 4], cloud["rgb"].view(np.uint32).reshape(-1))
    assert_array_equal(raw[:, 5:], 0)
    assert to_packed(from_xyz(np.ones((3, 3)))).dtype == XYZ
    assert to_packed(cloud) is cloud


def test_select_fields_in_the_order_asked_for() -> None:
    cloud = in_layout(random_cloud(), "odd")
    chosen = select_fields(cloud, ["z", "flag", "x"])
    assert chosen.dtype.names == ("z", "flag", "x")
    assert chosen.dtype.itemsize == 9
    assert_array_equal(chosen["z"], cloud["z"])
    with pytest.raises(PointsError, match="no heat"):
        select_fields(cloud, ["x", "heat"])


def test_concatenate_in_the_layout_of_the_first() -> None:
    first, second = random_cloud(1), in_layout(random_cloud(2, 3, 4), "reversed")
    both = concatenate([first, second])
    assert both.shape == (1, first.size + second.size)
    assert_array_equal(coordinates(both), np.concatenate([coordinates(first), coordinates(second)]))
    assert both[:, first.size :]["rgb"].tobytes() == np.ascontiguousarray(second["rgb"]).tobytes()
    assert concatenate([first]).tobytes() == first.tobytes()
    with pytest.raises(PointsError, match="at least one"):
        concatenate([])


def test_missing_fields_are_zero_and_wrong_colours_refused() -> None:
    plain = repack(from_xyz(np.ones((2, 3))), XYZRGB)
    assert_array_equal(plain["rgb"], 0)
    with pytest.raises(PointsError, match="four bytes"):
        repack(random_cloud(), np.dtype([("x", "<f4"), ("rgb", "<f8")]))
