"""Pairs of colour and depth images."""

from __future__ import annotations

import struct
import zlib
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from PIL import Image

from zsight_core.errors import FileError
from zsight_core.files import rgbd
from zsight_core.files.depth_camera import DepthCamera
from zsight_core.pinhole import Pinhole
from zsight_core.points import Points, colours, xyz

if TYPE_CHECKING:
    from pathlib import Path

CAMERA = DepthCamera(Pinhole(8, 6, 7.0, 7.0, 3.5, 2.5), 0.0001)
YCB = DepthCamera(Pinhole(640, 480, 1066.778, 1067.487, 312.9869, 241.3109), 0.0001)


def save(path: Path, pixels: Any) -> Path:
    path.parent.mkdir(exist_ok=True)
    Image.fromarray(np.asarray(pixels)).save(path)
    return path


def images(seed: int = 0) -> tuple[Any, Any]:
    rng = np.random.default_rng(seed)
    depth = rng.integers(0, 65536, (6, 8), dtype=np.uint16)
    depth[0] = 0
    return rng.integers(0, 256, (6, 8, 3), dtype=np.uint8), depth


def test_a_pair_is_an_organised_cloud_with_holes(tmp_path: Path) -> None:
    rgb, depth = images()
    points = rgbd.read(save(tmp_path / "a.png", rgb), save(tmp_path / "b.png", depth), CAMERA)
    assert points.shape == (6, 8)
    np.testing.assert_array_equal(colours(points), rgb)
    np.testing.assert_array_equal(np.isnan(points["z"]), depth == 0)
    measured = depth > 0
    np.testing.assert_allclose(points["z"][measured], depth[measured] * 0.0001, rtol=1e-6)
    u = np.broadcast_to(np.arange(8), (6, 8))[measured]
    np.testing.assert_allclose(points["x"][measured] * 7 / points["z"][measured] + 3.5, u, atol=1e-5)


@pytest.mark.parametrize("mode", ["RGBA", "L", "P"])
def test_other_kinds_of_colour_image_are_converted(tmp_path: Path, mode: str) -> None:
    rgb, depth = images()
    Image.fromarray(rgb).convert(mode).save(tmp_path / "a.png")
    points = rgbd.read(tmp_path / "a.png", save(tmp_path / "b.png", depth), CAMERA)
    np.testing.assert_array_equal(colours(points), np.asarray(Image.open(tmp_path / "a.png").convert("RGB")))


def test_sizes_that_differ_are_refused(tmp_path: Path) -> None:
    rgb, depth = images()
    colour, distance = save(tmp_path / "a.png", rgb), save(tmp_path / "b.png", depth)
    small = save(tmp_path / "c.png", rgb[:4])
    with pytest.raises(FileError, match="8 x 4 pixels; its depth image"):
        rgbd.read(small, distance, CAMERA)
    with pytest.raises(FileError, match="8 x 6 pixels; the camera has 640 x 480"):
        rgbd.read(colour, distance, YCB)


def test_images_of_the_wrong_kind_are_refused(tmp_path: Path) -> None:
    rgb, depth = images()
    colour, distance = save(tmp_path / "a.png", rgb), save(tmp_path / "b.png", depth)
    with pytest.raises(FileError, match="expected a 16-bit grey image"):
        rgbd.read(colour, colour, CAMERA)
    with pytest.raises(FileError, match="8 bits a channel"):
        rgbd.read(distance, distance, CAMERA)


def chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def lying_png(width: int, height: int) -> bytes:
    header = struct.pack(">IIBBBBB", width, height, 16, 0, 0, 0, 0)
    data = chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(bytes(100))) + chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + data


@pytest.mark.parametrize(
    ("data", "complaint"),
    [
        (b"", "cannot be read as an image"),
        (b"GIF89a" + bytes(100), "cannot be read as an image"),
        (lying_png(5000, 5000), "cannot hold"),
        (lying_png(2**31 - 1, 2**31 - 1), "too large"),
        (lying_png(20, 20), "cannot be read as an image"),
    ],
)
def test_damaged_images_are_refused(tmp_path: Path, data: bytes, complaint: str) -> None:
    rgb, _ = images()
    (tmp_path / "bad.png").write_bytes(data)
    with pytest.raises(FileError, match=complaint):
        rgbd.read(save(tmp_path / "a.png", rgb), tmp_path / "bad.png", CAMERA)
    with pytest.raises(FileError, match="No such file"):
        rgbd.read(tmp_path / "a.png", tmp_path / "nowhere.png", CAMERA)


def test_every_place_to_cut_an_image_is_noticed(tmp_path: Path) -> None:
    rgb, depth = images()
    colour, whole = save(tmp_path / "a.png", rgb), save(tmp_path / "b.png", depth).read_bytes()
    points = rgbd.read(colour, tmp_path / "b.png", CAMERA)
    needed = whole.index(b"IEND") - 24  # behind these come checksums, which Pillow does not miss
    for size in range(len(whole)):
        (tmp_path / "cut.png").write_bytes(whole[:size])
        if size < needed:
            with pytest.raises(FileError):
                rgbd.read(colour, tmp_path / "cut.png", CAMERA)
        else:
            assert_same_or_refused(colour, tmp_path / "cut.png", points)


def assert_same_or_refused(colour: Path, depth: Path, points: Points) -> None:
    try:
        got = rgbd.read(colour, depth, CAMERA)
    except FileError:
        return
    assert got.tobytes() == points.tobytes()


def test_pairs_are_found_in_both_layouts_and_natural_order(tmp_path: Path) -> None:
    for name in ["10-color.png", "10-depth.png", "2-color.jpg", "2-depth.png", "3-color.png", "4-depth.png"]:
        (tmp_path / name).touch()
    for name in ["rgb/7.png", "depth/7.png", "rgb/8.png", "depth/9.png"]:
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    pairs = rgbd.list_pairs(tmp_path)
    assert [pair.name for pair in pairs] == ["2", "7", "10"]
    assert [pair.colour.name for pair in pairs] == ["2-color.jpg", "7.png", "10-color.png"]
    assert [pair.depth for pair in pairs] == [
        tmp_path / "2-depth.png",
        tmp_path / "depth/7.png",
        tmp_path / "10-depth.png",
    ]


def test_a_folder_without_pairs_has_none_and_one_that_is_not_there_is_an_error(tmp_path: Path) -> None:
    assert rgbd.list_pairs(tmp_path) == []
    with pytest.raises(FileError, match="cannot be listed"):
        rgbd.list_pairs(tmp_path / "nowhere")


def test_recorded_pairs_show_a_table_at_arms_length(shared_data: Path) -> None:
    pairs = rgbd.list_pairs(shared_data / "posecnn_ycbv")
    assert [pair.name for pair in pairs] == ["000001", "000002"]
    for pair in pairs:
        points = rgbd.read(pair.colour, pair.depth, YCB)
        assert points.shape == (480, 640)
        assert 0.6 < float(np.isfinite(points["z"]).mean()) < 0.9
        assert 0.8 < float(np.nanmedian(points["z"])) < 1.2
        assert float(np.nanmax(np.abs(xyz(points)[..., :2]))) < 2
