"""Clouds by suffix, and the clouds of a folder."""

from __future__ import annotations

import subprocess
import sys
from typing import TYPE_CHECKING

import numpy as np
import pytest

from zsight_core.ellipse import ellipse
from zsight_core.errors import FileError
from zsight_core.files import cloud_file, pcd, ply

if TYPE_CHECKING:
    from pathlib import Path


@pytest.mark.parametrize("name", ["a.pcd", "a.PCD", "a.ply", "a.Ply"])
def test_the_suffix_decides(tmp_path: Path, name: str) -> None:
    if name.lower().endswith("pcd"):
        pcd.write(tmp_path / name, ellipse())
    else:
        ply.write(tmp_path / name, ellipse())
    cloud = cloud_file.read(tmp_path / name)
    assert cloud.viewpoint == (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)
    assert cloud.points.tobytes() == ellipse().tobytes()


def test_the_viewpoint_of_a_pcd_is_kept(tmp_path: Path) -> None:
    pcd.write(tmp_path / "a.pcd", ellipse(), viewpoint=(1, 2, 3, 0, 1, 0, 0))
    assert cloud_file.read(tmp_path / "a.pcd").viewpoint == (1, 2, 3, 0, 1, 0, 0)


@pytest.mark.parametrize("name", ["a.las", "a", ".pcd", "a.pcd.gz"])
def test_another_suffix_is_a_clear_error(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_bytes(b"")
    with pytest.raises(FileError, match=r"suffix.*\.pcd and \.ply"):
        cloud_file.read(tmp_path / name)


def test_double_coordinates_become_single_and_the_rest_stays(tmp_path: Path) -> None:
    points = np.array(
        [[(0.1, 1e300, np.nan, 0.1, 3)]], [("x", "<f8"), ("y", "<f8"), ("z", "<f8"), ("t", "<f8"), ("n", "u1")]
    )
    pcd.write(tmp_path / "a.pcd", points)
    got = cloud_file.read(tmp_path / "a.pcd").points
    assert got.dtype == np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("t", "<f8"), ("n", "u1")])
    np.testing.assert_array_equal(got["x"], np.float32(0.1))
    np.testing.assert_array_equal(got["y"], np.float32(np.inf))
    np.testing.assert_array_equal(got["t"], points["t"])


@pytest.mark.parametrize("fields", [[("x", "<f4"), ("y", "<f4")], [("x", "<f4", (3,)), ("y", "<f4"), ("z", "<f4")]])
def test_a_cloud_without_coordinates_is_a_clear_error(tmp_path: Path, fields: list[tuple[str, str]]) -> None:
    pcd.write(tmp_path / "a.pcd", np.zeros((1, 3), fields))
    with pytest.raises(FileError, match="expected x, y and z"):
        cloud_file.read(tmp_path / "a.pcd")


def test_a_folder_is_listed_in_natural_order(tmp_path: Path) -> None:
    names = ["frame10.pcd", "frame2.ply", "frame1.pcd", "Frame3.pcd", "frame002.pcd", "2.pcd", "b.txt", ".hidden.pcd"]
    for name in names:
        (tmp_path / name).write_bytes(b"")
    (tmp_path / "folder.pcd").mkdir()
    listed = [path.name for path in cloud_file.list_clouds(tmp_path)]
    assert listed == ["2.pcd", "frame1.pcd", "frame002.pcd", "frame2.ply", "Frame3.pcd", "frame10.pcd"]


def test_a_folder_that_is_not_there_is_a_clear_error(tmp_path: Path) -> None:
    with pytest.raises(FileError, match="cannot be listed"):
        cloud_file.list_clouds(tmp_path / "nowhere")


def test_binary_files_take_no_numba(tmp_path: Path) -> None:
    code = (
        "import sys; sys.modules['numba'] = None\n"
        "from zsight_core.files import cloud_file, pcd, ply\n"
        "from zsight_core.ellipse import ellipse\n"
        f"folder = {str(tmp_path)!r}\n"
        "pcd.write(f'{folder}/a.pcd', ellipse()); ply.write(f'{folder}/a.ply', ellipse())\n"
        "print(*(cloud_file.read(path).points.size for path in cloud_file.list_clouds(folder)))"
    )
    answer = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    assert answer.stdout.split() == ["2920", "2920"]
