"""PCD files of real sensors, and the same files through Open3D's reader."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from zsight_core import open3d_module
from zsight_core.ellipse import ellipse
from zsight_core.files import pcd
from zsight_core.points import Points, colours, xyz

if TYPE_CHECKING:
    from pathlib import Path

ENCODINGS: tuple[pcd.Encoding, ...] = ("ascii", "binary", "binary_compressed")
PLAIN = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("rgb", "<f4")])
LABELLED = np.dtype([("label", "<u4"), *PLAIN.descr])

# file: shape, fields, encoding, finite points
RECORDINGS: dict[str, tuple[tuple[int, int], np.dtype[Any], str]] = {
    "mosd_learn/learn0.pcd": ((480, 640), LABELLED, "binary_compressed"),
    "mosd_learn/learn42.pcd": ((480, 640), LABELLED, "binary_compressed"),
    "pcl/milk_cartoon_all_small_clorox.pcd": ((480, 640), PLAIN, "binary_compressed"),
    "pcl/milk.pcd": ((1, 12575), PLAIN, "binary_compressed"),
    "pcl/table_scene_mug_stereo_textured.pcd": ((480, 640), PLAIN, "binary_compressed"),
    "gpd/krylon.pcd": ((1, 4467), PLAIN, "ascii"),
    "ros_industrial/table.pcd": ((1, 23239), PLAIN, "binary_compressed"),
    "moveit/drinks_can.pcd": ((480, 640), PLAIN, "binary"),
}


@pytest.fixture(scope="module")
def open3d() -> Any:
    try:
        return open3d_module.load()
    except ImportError as error:
        pytest.skip(f"no Open3D to compare with: {error}")


def read_by_open3d(open3d: Any, path: Path) -> tuple[Any, Any]:
    cloud = open3d.t.io.read_point_cloud(str(path), remove_nan_points=False, remove_infinite_points=False)
    return cloud.point["positions"].numpy(), cloud.point["colors"].numpy()


@pytest.mark.parametrize("name", RECORDINGS)
def test_recordings_have_the_shape_and_fields_of_their_headers(shared_data: Path, name: str) -> None:
    shape, dtype, encoding = RECORDINGS[name]
    file = pcd.read(shared_data / name)
    assert (file.points.shape, file.points.dtype, file.encoding) == (shape, dtype, encoding)
    distance = np.linalg.norm(xyz(file.points).astype(float), axis=-1)
    assert 0.01 < np.nanmedian(distance) < 3


@pytest.mark.parametrize("name", RECORDINGS)
def test_recordings_read_as_open3d_reads_them(shared_data: Path, name: str, open3d: Any) -> None:
    points = pcd.read(shared_data / name).points
    positions, rgb = read_by_open3d(open3d, shared_data / name)
    np.testing.assert_array_equal(xyz(points).reshape(-1, 3), positions)
    np.testing.assert_array_equal(colours(points).reshape(-1, 3), rgb)


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize("alpha", [0, 255])
def test_open3d_reads_what_we_write(open3d: Any, encoding: pcd.Encoding, alpha: int, tmp_path: Path) -> None:
    points = ellipse()
    rng = np.random.default_rng(alpha)
    bits = rng.integers(0, 1 << 24, points.shape, dtype=np.uint32) | np.uint32(alpha << 24)
    points["rgb"] = bits.view(np.float32)
    points["x"][0, ::7] = np.nan
    pcd.write(tmp_path / "a.pcd", points, encoding=encoding)
    positions, rgb = read_by_open3d(open3d, tmp_path / "a.pcd")
    np.testing.assert_array_equal(positions, xyz(points)[0])
    np.testing.assert_array_equal(rgb, colours(points)[0])


def test_the_stereo_clouds_viewpoint_is_not_the_identity(shared_data: Path) -> None:
    assert pcd.read(shared_data / "pcl/table_scene_mug_stereo_textured.pcd").viewpoint == (0, 0, 0, 0, 1, 0, 0)


def test_the_old_ascii_file_holds_a_spray_can(shared_data: Path) -> None:
    points = pcd.read(shared_data / "gpd/krylon.pcd").points
    assert np.isfinite(xyz(points)).all()
    assert 0.100 < float(np.ptp(points["z"])) < 0.110
    first = np.array([-0.002724, -0.019454, -0.054271], np.float32)
    np.testing.assert_array_equal(xyz(points)[0, 0], first)


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize("name", ["mosd_learn/learn0.pcd", "pcl/table_scene_mug_stereo_textured.pcd"])
def test_recordings_come_back_from_every_encoding(
    shared_data: Path, name: str, encoding: pcd.Encoding, tmp_path: Path
) -> None:
    file = pcd.read(shared_data / name)
    pcd.write(tmp_path / "a.pcd", file.points, viewpoint=file.viewpoint, encoding=encoding)
    back = pcd.read(tmp_path / "a.pcd")
    assert (back.viewpoint, back.encoding) == (file.viewpoint, encoding)
    assert_equal(back.points, file.points)


def assert_equal(got: Points, expected: Points) -> None:
    assert got.dtype == expected.dtype
    np.testing.assert_array_equal(xyz(got), xyz(expected))
    for name in set(expected.dtype.names or ()) - set("xyz"):
        assert got[name].tobytes() == expected[name].tobytes()
