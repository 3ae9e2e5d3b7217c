"""What every kernel keeps to, whatever cloud it is given: a right result or an error that says what is wrong."""

from __future__ import annotations

from contextlib import suppress
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from tests.core.clouds import LAYOUTS, coordinates, in_layout, random_cloud

from zsight_core.above_plane import points_above
from zsight_core.clusters import clusters_above, euclidean_clusters, image_clusters
from zsight_core.connected import connected_to
from zsight_core.depth_image import from_points, to_points
from zsight_core.errors import CoreError, PointsError
from zsight_core.filters import box, finite_mask, matching_colour, pass_through, remove_nan
from zsight_core.image_normals import image_normals
from zsight_core.multi_plane import planes_of_image
from zsight_core.normals import normals
from zsight_core.outliers import remove_radius_outliers, remove_statistical_outliers
from zsight_core.pack_fields import concatenate, select_fields, to_packed
from zsight_core.pinhole import Pinhole
from zsight_core.plane import fit_robust, heights, inliers, plane_through, ransac_plane, select
from zsight_core.points import from_xyz
from zsight_core.rigid import transform_points
from zsight_core.statistics import average_colour, bounding_box, centroid, count_finite
from zsight_core.table_height import fit_slab, table_height
from zsight_core.transform import from_rpy
from zsight_core.voxel_grid import voxel_grid

if TYPE_CHECKING:
    from collections.abc import Callable

    from zsight_core.points import Points

PLANE = plane_through([0.1, -0.2, -1], [0, 0, 1])
T = from_rpy([0.3, -0.2, 0.5], [0.2, -0.4, 1.1])
LENS = Pinhole(40, 24, 30.0, 30.0, 19.5, 11.5, (0.1, -0.05, 0.001, 0.002, 0.0))


def every(points: Points) -> np.ndarray[Any, np.dtype[np.bool_]]:
    return np.ones(points.shape, np.bool_)


KERNELS: dict[str, Callable[[Points], Any]] = {
    "voxel grid": lambda p: voxel_grid(p, 0.1),
    "box": lambda p: box(p, [-0.5, -0.5, 0.6], [0.5, 0.5, 1.2]),
    "pass through": lambda p: pass_through(p, "z", 0.6, 1.2),
    "remove NaN": remove_nan,
    "finite mask": finite_mask,
    "matching colour": lambda p: matching_colour(p, (128, 128, 128), 90),
    "transform": lambda p: transform_points(p, T),
    "bounding box": bounding_box,
    "centroid": centroid,
    "count": count_finite,
    "average colour": average_colour,
    "robust plane": lambda p: fit_robust(p).plane.coefficients(),
    "RANSAC plane": lambda p: ransac_plane(p, 0.05).plane.coefficients(),
    "plane inliers": lambda p: inliers(p, PLANE, 0.1),
    "plane selection": lambda p: select(p, PLANE, 0.1),
    "points above": lambda p: points_above(p, PLANE, 0.05, 0.5, every(p)),
    "table height": lambda p: table_height(p, np.eye(4), 0.5, 1.5),
    "slab fit": lambda p: fit_slab(p, np.eye(4), 0.6, 1.2).centroid,
    "clusters": lambda p: euclidean_clusters(p, 0.1, 3),
    "clusters above": lambda p: clusters_above(p, PLANE, 0.05, 0.5, 0.1, 3),
    "image clusters": lambda p: image_clusters(p, every(p), 0.5),
    "connected": lambda p: connected_to(p, every(p), every(p), 0.1),
    "normals": lambda p: normals(p, 0.2),
    "image normals": lambda p: image_normals(p, 5),
    "planes of an image": lambda p: planes_of_image(p, 50).labels,
    "radius outliers": lambda p: remove_radius_outliers(p, 0.2, 3),
    "statistical outliers": lambda p: remove_statistical_outliers(p, 5, 1.0),
    "depth image": lambda p: from_points(p, LENS),
    "concatenate": lambda p: concatenate([p, p]),
    "select fields": lambda p: select_fields(p, ["z", "x", "y"]),
    "packed": to_packed,
}


def strange_clouds() -> dict[str, Points]:
    """Clouds that nobody sends on purpose."""
    cloud = random_cloud(3)
    rng = np.random.default_rng(0)
    colour = np.zeros((24, 40, 3), np.uint8)
    bytes_ = bytearray(b"\0" + cloud.tobytes())
    wild = random_cloud(4)
    wild["x"][rng.random(wild.shape) < 0.1] = np.float32(1e30)
    wild["z"][rng.random(wild.shape) < 0.1] = -np.inf
    return {
        "empty": from_xyz(np.empty((0, 3)), np.empty((0, 3))),
        "no rows": cloud[:0],
        "no columns": cloud[:, :0],
        "one point": cloud[5:6, 7:8],
        "two points": cloud[5:6, 7:9],
        "one row": cloud[:1],
        "one column": cloud[:, :1],
        "all holes": random_cloud(holes=1.0),
        "infinities": from_xyz(np.full((24, 40, 3), np.inf), colour),
        "wild": wild,
        "huge": from_xyz(np.full((24, 40, 3), 3e38), colour),
        "far away": transform_points(cloud, from_rpy([1e6, -2e6, 3e6], [0, 0, 0])),
        "one place": from_xyz(np.full((24, 40, 3), 0.7), colour),
        "a line": from_xyz(np.linspace([0, 0, 1], [1, 1, 1], 960).reshape(24, 40, 3), colour),
        "every other column": np.repeat(cloud, 2, axis=1)[:, ::2],
        "upside down": cloud[::-1],
        "mirrored": cloud[:, ::-1],
        "turned": np.ascontiguousarray(cloud.T).T,
        "read only": np.frombuffer(cloud.tobytes(), cloud.dtype).reshape(cloud.shape),
        "off by a byte": np.frombuffer(bytes_, cloud.dtype, offset=1).reshape(cloud.shape),
    }


STRANGE = strange_clouds()
VIEWS = ("every other column", "upside down", "mirrored", "turned", "read only", "off by a byte")


@pytest.mark.parametrize("cloud", STRANGE)
@pytest.mark.parametrize("kernel", KERNELS)
def test_a_result_or_a_clear_error(kernel: str, cloud: str) -> None:
    before = STRANGE[cloud].tobytes()
    with suppress(CoreError):
        KERNELS[kernel](STRANGE[cloud])
    assert STRANGE[cloud].tobytes() == before, "the input was written to"


def agree(found: Any, expected: Any, rounding: float = 0.0) -> None:
    """Coordinates of clouds, or anything else, are equal; padding and further fields may differ."""
    one, other = np.asarray(found), np.asarray(expected)
    assert one.shape == other.shape
    if one.dtype.names:
        one, other = coordinates(one), coordinates(other)
    assert_allclose(one, other, rtol=0, atol=rounding)


ROUNDED = {"transform": 1e-6}
"""Metres by which a result may differ between layouts: products are contracted in one loop and not in the other."""


@pytest.mark.parametrize("cloud", VIEWS)
@pytest.mark.parametrize("kernel", KERNELS)
def test_the_memory_that_a_cloud_lies_in_does_not_matter(kernel: str, cloud: str) -> None:
    copy = np.array(STRANGE[cloud], order="C", copy=True)
    agree(KERNELS[kernel](STRANGE[cloud]), KERNELS[kernel](copy), ROUNDED.get(kernel, 0.0))


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("kernel", [name for name in KERNELS if name not in ("concatenate", "packed")])
def test_the_order_of_fields_does_not_matter(kernel: str, layout: str) -> None:
    cloud = random_cloud(5)
    agree(KERNELS[kernel](in_layout(cloud, layout)), KERNELS[kernel](cloud), ROUNDED.get(kernel, 0.0))


KEPT = ["box", "pass through", "remove NaN", "plane selection", "radius outliers", "statistical outliers"]


@pytest.mark.parametrize("kernel", KEPT)
def test_a_filter_keeps_the_same_points_in_any_order(kernel: str) -> None:
    cloud = random_cloud(6)
    shuffled = cloud.reshape(1, -1)[:, np.random.default_rng(0).permutation(cloud.size)]
    before, after = (coordinates(KERNELS[kernel](points)) for points in (cloud, shuffled))
    assert 0 < len(before) < cloud.size
    assert_array_equal(np.unique(before, axis=0), np.unique(after, axis=0))


@pytest.mark.parametrize("kernel", ["clusters", "radius outliers", "statistical outliers", "remove NaN"])
def test_a_moved_cloud_is_filtered_alike(kernel: str) -> None:
    """But for points within rounding of a threshold, of which this cloud has none."""
    cloud = random_cloud(7)
    found, expected = KERNELS[kernel](transform_points(cloud, T)), KERNELS[kernel](cloud)
    agree(found, transform_points(expected, T) if expected.dtype.names else expected, 1e-5)


@pytest.mark.parametrize("kernel", ["voxel grid", "bounding box", "centroid"])
def test_duplicates_do_not_count(kernel: str) -> None:
    cloud = random_cloud(8)
    agree(KERNELS[kernel](np.concatenate([cloud, cloud])), KERNELS[kernel](cloud), 1e-6)


LARGE: dict[str, Callable[[Points, Any], Any]] = {
    "voxel grid": lambda p, out: voxel_grid(p, 0.1, out),
    "box": lambda p, out: box(p, [-0.5, -0.5, 0.6], [0.5, 0.5, 1.2], out),
    "pass through": lambda p, out: pass_through(p, "z", 0.6, 1.2, out),
    "remove NaN": remove_nan,
    "matching colour": lambda p, out: matching_colour(p, (128, 128, 128), 90, out),
    "plane selection": lambda p, out: select(p, PLANE, 0.1, out),
    "points above": lambda p, out: points_above(p, PLANE, 0.05, 0.5, None, out),
    "radius outliers": lambda p, out: remove_radius_outliers(p, 0.2, 3, out),
    "statistical outliers": lambda p, out: remove_statistical_outliers(p, 5, 1.0, out),
    "concatenate": lambda p, out: concatenate([p[:9], p[9:]], out),
}
"""What writes at most as many points as the cloud has."""

EXACT: dict[str, Callable[[Points, Any], Any]] = {
    "transform": lambda p, out: transform_points(p, T, out),
    "select fields": lambda p, out: select_fields(p, ["z", "x"], out),
    "plane heights": lambda p, out: heights(p, PLANE, out),
    "plane inliers": lambda p, out: inliers(p, PLANE, 0.1, out),
    "normals": lambda p, out: normals(p, 0.2, out),
    "image normals": lambda p, out: image_normals(p, 5, out=out),
    "depth image": lambda p, out: from_points(p, LENS, out=out),
    "depth image in units": lambda p, out: from_points(p, LENS, depth_scale=0.001, out=out),
    "points of a depth image": lambda p, out: to_points(np.nan_to_num(p["z"]), LENS, out=out),
}
"""What writes a result of known shape."""


@pytest.mark.parametrize("kernel", [*LARGE, *EXACT])
def test_room_that_is_given_gets_the_result(kernel: str) -> None:
    cloud = random_cloud(9)
    call = (LARGE | EXACT)[kernel]
    expected = call(cloud, None)
    room = np.zeros_like(expected) if kernel in EXACT else np.zeros_like(cloud)
    found = call(cloud, room)
    assert np.shares_memory(found, room)
    assert found.tobytes() == expected.tobytes()


@pytest.mark.parametrize("kernel", [*LARGE, *EXACT])
def test_room_that_does_not_fit_is_refused(kernel: str) -> None:
    cloud = random_cloud(9)
    with pytest.raises(PointsError, match="output"):
        (LARGE | EXACT)[kernel](cloud, np.zeros((1, 1), np.uint8))
