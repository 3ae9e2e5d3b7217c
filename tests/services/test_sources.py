"""Where a camera's clouds come from."""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING

import numpy as np
import pytest
from PIL import Image

from zsight.convert import cloud_from_points, matrix_of
from zsight.errors import UsageError
from zsight.sources import open_source, pose_matrix
from zsight_core.errors import FileError
from zsight_core.files import pcd, ply
from zsight_core.points import colours, from_xyz, xyz
from zsight_core.transform import from_quaternion
from zsight_protocol.message import Time

if TYPE_CHECKING:
    from pathlib import Path

    from zsight.sources import Source
    from zsight_core.points import Points

pytestmark = pytest.mark.usefixtures("warm_kernels")

SCENE = """\
name: small
camera:
  frame: eye
  chain:
    - {parent: world, frame: post, position: [0, 0, 1], rpy: [0, 0.5, 0]}
    - {parent: post, frame: eye, orientation: [-0.5, 0.5, -0.5, 0.5]}
  width: 64
  height: 48
  rate: 25
noise: {model: NOISE, seed: 5}
objects:
  - {shape: {surface: {}}, position: [0, 0, 0]}
  - {type: cube, position: [1, 0, 0.025]}
"""


def first(source: Source, count: int = 1) -> list[Points]:
    return list(itertools.islice(source.clouds(), count))


def scene(folder: Path, noise: str) -> str:
    path = folder / "scene.yaml"
    path.write_text(SCENE.replace("NOISE", noise), encoding="utf-8")
    return str(path)


def marked(x: float) -> Points:
    """A cloud that is known by its x."""
    return from_xyz(np.full((1, 3, 3), x), np.full((1, 3, 3), 9))


def test_the_ellipse_is_the_books() -> None:
    source = open_source("ellipse", frame="camera")
    (points,) = first(source)
    assert points.size == 2920
    assert (source.frame_id, source.rate, source.transforms, source.camera_info) == ("camera", 1.0, None, None)
    assert xyz(points)[..., 2].min() == pytest.approx(-1)


def test_a_still_scene_without_noise_stays_the_same(tmp_path: Path) -> None:
    source = open_source(scene(tmp_path, "none"), frame="ignored")
    one, two = first(source, 2)
    assert one.shape == (48, 64)
    assert one.tobytes() == two.tobytes()
    assert (source.frame_id, source.rate) == ("eye", 25.0)


def test_a_scene_says_where_its_camera_is_and_how_it_projects(tmp_path: Path) -> None:
    source = open_source(scene(tmp_path, "none"), frame="ignored")
    assert source.transforms is not None
    assert source.camera_info is not None
    steps = source.transforms.transforms
    assert [(step.header.frame_id, step.child_frame_id) for step in steps] == [("world", "post"), ("post", "eye")]
    T_world_eye = matrix_of(steps[0].transform) @ matrix_of(steps[1].transform)
    seen = xyz(first(source)[0]).reshape(-1, 3) @ T_world_eye[:3, :3].T + T_world_eye[:3, 3]
    assert np.nanmin(seen[:, 2]) == pytest.approx(0, abs=1e-5)
    assert np.nanmax(seen[np.hypot(seen[:, 0] - 1, seen[:, 1]) < 0.04, 2]) == pytest.approx(0.05, abs=1e-5)
    info = source.camera_info
    assert (info.width, info.height, info.header.frame_id) == (64, 48, "eye")
    assert info.k[0] == pytest.approx(32 / np.tan(1.047 / 2))
    assert (info.k[2], info.k[5]) == (31.5, 23.5)


def test_noise_goes_on_from_its_seed(tmp_path: Path) -> None:
    name = scene(tmp_path, "kinect")
    one, two = first(open_source(name, frame=""), 2)
    assert one.tobytes() != two.tobytes()
    assert first(open_source(name, frame=""))[0].tobytes() == one.tobytes()
    assert first(open_source(name, frame="", seed=6))[0].tobytes() == two.tobytes()


@pytest.mark.parametrize("suffix", [".pcd", ".ply"])
def test_a_file_is_published_as_it_is(tmp_path: Path, suffix: str) -> None:
    points = from_xyz(np.arange(9.0).reshape(1, 3, 3), np.arange(9).reshape(1, 3, 3))
    path = tmp_path / f"cloud{suffix}"
    if suffix == ".pcd":
        pcd.write(path, points)
    else:
        ply.write(path, points)
    (back,) = open_source(str(path), frame="camera").clouds()
    np.testing.assert_array_equal(xyz(back), xyz(points))
    np.testing.assert_array_equal(colours(back), colours(points))


def test_a_folder_is_published_in_natural_order_past_what_cannot_be_read(tmp_path: Path) -> None:
    for number in (10, 9, 1):
        pcd.write(tmp_path / f"cloud{number}.pcd", marked(number))
    (tmp_path / "cloud0.pcd").write_bytes(b"VERSION 0.7\nFIELDS x\n")
    (tmp_path / "cloud5.ply").write_bytes(b"")
    (tmp_path / "notes.txt").write_text("no cloud")
    clouds = open_source(str(tmp_path), frame="camera").clouds()
    order: list[float | str] = []
    while True:
        try:
            points = next(clouds, None)
        except FileError as error:
            order.append(error.path.rpartition("/")[2])
            continue
        if points is None:
            break
        order.append(float(points["x"][0, 0]))
    assert order == ["cloud0.pcd", 1.0, "cloud5.ply", 9.0, 10.0]


def test_a_folder_of_which_nothing_can_be_read_is_refused(tmp_path: Path) -> None:
    (tmp_path / "cloud.pcd").write_bytes(b"")
    with pytest.raises(FileError, match=r"cloud\.pcd"):
        open_source(str(tmp_path), frame="camera")


def test_image_pairs_become_organised_clouds_with_holes(tmp_path: Path) -> None:
    depth = np.full((4, 6), 1000, np.uint16)
    depth[1, 2] = 0
    colour = np.zeros((4, 6, 3), np.uint8)
    colour[..., 0] = 200
    for number in (2, 1):
        Image.fromarray(depth * number).save(tmp_path / f"{number}-depth.png")
        Image.fromarray(colour).save(tmp_path / f"{number}-color.png")
    with pytest.raises(UsageError, match=r"no camera\.toml"):
        open_source(str(tmp_path), frame="camera")
    (tmp_path / "camera.toml").write_text(
        "fx = 5.0\nfy = 5.0\ncx = 2.5\ncy = 1.5\nwidth = 6\nheight = 4\ndepth_scale = 0.001\n"
    )
    source = open_source(str(tmp_path), frame="camera")
    near, far = source.clouds()
    assert near.shape == far.shape == (4, 6)
    assert np.isnan(near["z"][1, 2])
    assert np.nanmax(near["z"]) == 1.0
    assert np.nanmax(far["z"]) == 2.0
    assert near["x"][0, 0] == pytest.approx(-0.5)
    np.testing.assert_array_equal(colours(near)[0, 0], (200, 0, 0))
    assert source.camera_info is not None
    assert source.camera_info.k[:3] == (5.0, 0.0, 2.5)


def test_intrinsics_are_told_only_where_a_cloud_has_them(tmp_path: Path) -> None:
    v, u = np.mgrid[0:48, 0:64]
    z = 1 + 0.002 * u + 0.001 * v
    fitting = from_xyz(np.stack([(u - 30) * z / 60, (v - 20) * z / 60, z], axis=-1))
    pcd.write(tmp_path / "pinhole.pcd", fitting)
    info = open_source(str(tmp_path / "pinhole.pcd"), frame="camera").camera_info
    assert info is not None
    assert (info.k[0], info.k[2], info.k[4], info.k[5]) == pytest.approx((60, 30, 60, 20), rel=1e-3)
    pcd.write(tmp_path / "other.pcd", from_xyz(np.random.default_rng(1).normal(size=(48, 64, 3))))
    assert open_source(str(tmp_path / "other.pcd"), frame="camera").camera_info is None
    pcd.write(tmp_path / "row.pcd", marked(1))
    assert open_source(str(tmp_path / "row.pcd"), frame="camera").camera_info is None


# Where the camera is.


def test_a_pose_is_published_as_a_transform(tmp_path: Path) -> None:
    pcd.write(tmp_path / "cloud.pcd", marked(1))
    pose = "1 2 3 0 0 0.6 0.8"
    source = open_source(str(tmp_path / "cloud.pcd"), frame="camera", pose=pose, world_frame="map")
    assert source.transforms is not None
    (step,) = source.transforms.transforms
    assert (step.header.frame_id, step.child_frame_id) == ("map", "camera")
    np.testing.assert_allclose(matrix_of(step.transform), from_quaternion((1, 2, 3), (0, 0, 0.6, 0.8)))


def test_a_files_viewpoint_is_taken_where_asked_for(tmp_path: Path) -> None:
    path = tmp_path / "cloud.pcd"
    pcd.write(path, marked(1), viewpoint=(1, 2, 3, 0.8, 0, 0, 0.6))
    assert open_source(str(path), frame="camera").transforms is None
    source = open_source(str(path), frame="camera", pose="viewpoint")
    assert source.transforms is not None
    expected = from_quaternion((1, 2, 3), (0, 0, 0.6, 0.8))
    np.testing.assert_allclose(matrix_of(source.transforms.transforms[0].transform), expected, atol=1e-7)


@pytest.mark.parametrize("text", ["", "1 2 3", "1 2 3 0 0 0 0", "1 2 3 a b c d", "nan 0 0 0 0 0 1", "viewpoint"])
def test_a_pose_that_is_none_is_refused(text: str) -> None:
    with pytest.raises(UsageError, match="expected seven numbers"):
        pose_matrix(text)


@pytest.mark.parametrize(
    ("name", "words"), [("absent.pcd", "absent"), ("boook", "no scene"), ("absent.yaml", "absent")]
)
def test_what_is_not_there_is_named(tmp_path: Path, name: str, words: str) -> None:
    with pytest.raises((UsageError, FileError), match=words):
        open_source(str(tmp_path / name) if "." in name else name, frame="camera")


def test_an_empty_folder_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="holds nothing to publish; expected"):
        open_source(str(tmp_path), frame="camera")


def test_one_file_is_read_once_and_stays_in_bytes(tmp_path: Path) -> None:
    points = from_xyz(np.arange(60.0).reshape(4, 5, 3))
    pcd.write(tmp_path / "one.pcd", points)
    source = open_source(str(tmp_path / "one.pcd"), frame="eye")
    first, second = next(source.clouds()), next(source.clouds())
    assert first is second
    assert isinstance(cloud_from_points(first, Time(), "eye").data, bytes)
    np.testing.assert_array_equal(xyz(first), xyz(points))
