"""Clouds for the tests of kernels, in several memory layouts."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from zsight_core.pack_fields import PCL_XYZRGB, repack
from zsight_core.points import XYZRGB, from_xyz

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from zsight_core.points import Points

LAYOUTS: dict[str, np.dtype[Any]] = {
    "packed": XYZRGB,
    "pcl": PCL_XYZRGB,
    "reversed": np.dtype([("rgb", "<f4"), ("z", "<f4"), ("y", "<f4"), ("x", "<f4")]),
    "rgba": np.dtype([("label", "<u4"), ("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("rgba", "<u4")]),
    "odd": np.dtype([("flag", "u1"), ("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("rgb", "<f4")]),
    "big-endian": np.dtype([("x", ">f4"), ("y", ">f4"), ("z", ">f4"), ("rgb", ">f4")]),
    "double": np.dtype([("x", "<f8"), ("y", "<f8"), ("z", "<f8"), ("rgb", "<u4")]),
}


def random_cloud(seed: int = 0, height: int = 24, width: int = 40, holes: float = 0.2) -> Points:
    """An organised cloud in 2 m x 2 m x 1 m with random colours and holes (some of them infinite)."""
    rng = np.random.default_rng(seed)
    xyz = rng.uniform([-1, -1, 0.5], [1, 1, 1.5], (height, width, 3)).astype(np.float32)
    xyz[rng.random((height, width)) < holes] = np.nan
    xyz.reshape(-1, 3)[:2] = [[np.inf, 0, 1], [0, -np.inf, 1]]
    return from_xyz(xyz, rng.integers(0, 256, (height, width, 3), dtype=np.uint8))


def in_layout(points: Points, layout: str) -> Points:
    """The same cloud in one of `LAYOUTS`."""
    return repack(points, LAYOUTS[layout])


def coordinates(points: Points) -> NDArray[np.float32]:
    """(N, 3) float32, holes included."""
    return np.stack([points[axis].astype(np.float32) for axis in "xyz"], axis=-1).reshape(-1, 3)


def finite(points: Points) -> NDArray[np.float32]:
    """(N, 3) float32 without holes."""
    rows = coordinates(points)
    return rows[np.isfinite(rows).all(axis=1)]


def assert_same_points(found: Points, expected: Points) -> None:
    """Equal bit for bit in every field; padding may differ."""
    assert found.dtype == expected.dtype
    for name in expected.dtype.names or ():
        assert found[name].tobytes() == expected[name].tobytes(), f"field {name} differs"
