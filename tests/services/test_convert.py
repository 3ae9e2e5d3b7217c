"""Messages become arrays and come back the same."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst
from tests.protocol.legal_messages import clouds, quaternions

from zsight.convert import cloud_from_points, matrix_of, points_of, pose_of, stamped
from zsight.errors import UsageError
from zsight_core.points import XYZ, XYZRGB, from_xyz, xyz
from zsight_core.transform import angle_between, from_rpy
from zsight_protocol.codec import decode, encode
from zsight_protocol.geometry import Point, Pose, Quaternion
from zsight_protocol.message import Header, Time
from zsight_protocol.point_cloud import Datatype, PointCloud2

STAMP = Time(sec=1, nanosec=2)
NUMBERS = ("i1", "u1", "<i2", "<u2", "<i4", "<u4", "<f4", "<f8")


@st.composite
def point_types(draw: st.DrawFn) -> np.dtype[np.void]:
    """Records of named numbers and rows of numbers, with gaps between them, in any order."""
    names = draw(st.lists(st.text("abcxyz_", min_size=1, max_size=4), min_size=1, max_size=5, unique=True))
    formats: list[Any] = []
    offsets: list[int] = []
    end = 0
    for _ in names:
        number, count = draw(st.sampled_from(NUMBERS)), draw(st.integers(1, 4))
        formats.append(number if count == 1 else (number, count))
        offsets.append(end + draw(st.integers(0, 3)))
        end = offsets[-1] + np.dtype(number).itemsize * count
    size = end + draw(st.integers(0, 5))
    order = draw(st.permutations(range(len(names))))
    return np.dtype(
        {
            "names": [names[i] for i in order],
            "formats": [formats[i] for i in order],
            "offsets": [offsets[i] for i in order],
            "itemsize": size,
        }
    )


@given(st.data(), point_types(), st.integers(1, 3), st.integers(1, 4))
def test_points_come_back(data: st.DataObject, dtype: np.dtype[np.void], height: int, width: int) -> None:
    size = height * width * dtype.itemsize
    raw = data.draw(st.binary(min_size=size, max_size=size))
    points = np.frombuffer(raw, dtype).reshape(height, width)
    back = points_of(decode(PointCloud2, encode(cloud_from_points(points, STAMP, "camera"))))
    assert back.shape == points.shape
    assert back.dtype.names == points.dtype.names
    for name in dtype.names or ():
        assert back[name].tobytes() == points[name].tobytes()


@given(clouds())
def test_clouds_come_back(cloud: PointCloud2) -> None:
    points = points_of(cloud)
    assert points.shape == (cloud.height, cloud.width)
    back = cloud_from_points(points, cloud.header.stamp, cloud.header.frame_id)
    assert (back.height, back.width, back.point_step, bytes(back.data)) == (
        cloud.height, cloud.width, cloud.point_step, bytes(cloud.data),
    )  # fmt: skip
    assert sorted(back.fields, key=lambda f: f.offset) == sorted(cloud.fields, key=lambda f: f.offset)


@given(npst.arrays(np.float32, (3, 4, 3), elements=st.floats(-10, 10, width=32) | st.just(np.nan)))
def test_a_cloud_is_dense_where_nothing_is_missing(xyz: np.ndarray) -> None:
    cloud = cloud_from_points(from_xyz(xyz), STAMP, "camera")
    assert cloud.is_dense is not np.isnan(xyz).any()


def test_nothing_is_copied() -> None:
    points = from_xyz(np.ones((2, 3, 3)), np.full((2, 3, 3), 7))
    cloud = cloud_from_points(points, STAMP, "camera")
    assert np.shares_memory(np.frombuffer(cloud.data, np.uint8), points)
    assert np.shares_memory(points_of(cloud), points)


def test_points_that_fill_bytes_travel_as_those_bytes() -> None:
    whole = from_xyz(np.arange(60.0).reshape(4, 5, 3)).tobytes()
    points = np.frombuffer(whole, XYZ).reshape(4, 5)
    assert cloud_from_points(points, STAMP, "camera").data is whole
    for part in (points[1:], points[::-1], points[:, ::2], points[:, ::-1]):
        back = points_of(decode(PointCloud2, encode(cloud_from_points(part, STAMP, "camera"))))
        np.testing.assert_array_equal(xyz(back), xyz(part))


def test_who_knows_that_a_cloud_is_dense_says_so() -> None:
    points = from_xyz(np.ones((2, 3, 3)))
    assert [cloud_from_points(points, STAMP, "camera", is_dense=said).is_dense for said in (None, True, False)] == [
        True, True, False,
    ]  # fmt: skip


def test_a_frame_is_that_of_its_own_cloud() -> None:
    points = from_xyz(np.ones((2, 3, 3)))
    for frame in ("left", "right", "left"):
        cloud = cloud_from_points(points, STAMP, frame)
        assert cloud.header == Header(stamp=STAMP, frame_id=frame)
        assert decode(PointCloud2, encode(cloud)) == cloud
    with pytest.raises(ValueError, match="frame_id"):
        cloud_from_points(points, STAMP, "x" * 257)


def test_of_a_part_of_a_cloud_only_its_numbers_are_sent() -> None:
    points = from_xyz(np.arange(60.0).reshape(4, 5, 3))
    part = points[1:3, ::2]
    back = points_of(cloud_from_points(part, STAMP, "camera"))
    np.testing.assert_array_equal(xyz(back), xyz(part))
    gaps = np.frombuffer(back, np.uint8).reshape(-1, 16)[:, 12:]
    assert not gaps.any(), "what was in memory before is nobody's business"


def test_fields_are_those_of_ros() -> None:
    cloud = cloud_from_points(np.zeros((1, 2), XYZRGB), STAMP, "camera")
    assert [(f.name, f.offset, f.datatype, f.count) for f in cloud.fields] == [
        ("x", 0, Datatype.FLOAT32, 1), ("y", 4, Datatype.FLOAT32, 1),
        ("z", 8, Datatype.FLOAT32, 1), ("rgb", 12, Datatype.FLOAT32, 1),
    ]  # fmt: skip
    assert (cloud.point_step, cloud.row_step) == (16, 32)
    assert (cloud.header.stamp, cloud.header.frame_id) == (STAMP, "camera")


def test_no_points_are_refused() -> None:
    with pytest.raises(UsageError, match="no points"):
        cloud_from_points(np.zeros((1, 0), XYZRGB), STAMP, "camera")


@pytest.mark.parametrize("number", [">f4", "<i8", "<f2", "?", "S3", "<c8"])
def test_numbers_that_ros_does_not_know_are_refused(number: str) -> None:
    with pytest.raises(UsageError, match=r"field x is .+PointCloud2 knows int8, .+float64"):
        cloud_from_points(np.zeros((1, 2), [("x", number)]), STAMP, "camera")


ANGLES = st.floats(-np.pi, np.pi)
PLACES = st.floats(-100, 100)


@given(st.tuples(PLACES, PLACES, PLACES), st.tuples(ANGLES, ANGLES, ANGLES))
def test_matrices_come_back_from_poses_and_transforms(place: tuple[float, ...], rpy: tuple[float, ...]) -> None:
    T = from_rpy(place, rpy)
    for back in (matrix_of(pose_of(T)), matrix_of(stamped(T, "parent", "child", STAMP).transform)):
        np.testing.assert_allclose(back, T, atol=1e-9)


@given(st.tuples(PLACES, PLACES, PLACES), quaternions())
def test_poses_come_back_from_matrices(place: tuple[float, float, float], turn: Quaternion) -> None:
    pose = Pose(position=Point(x=place[0], y=place[1], z=place[2]), orientation=turn)
    T = matrix_of(pose)
    assert pose_of(T).position == pose.position
    assert angle_between(matrix_of(pose_of(T)), T) < 1e-7


def test_a_stamped_transform_names_its_frames() -> None:
    message = stamped(np.eye(4), "base_link", "kinect", STAMP)
    assert (message.header.frame_id, message.child_frame_id, message.header.stamp) == ("base_link", "kinect", STAMP)
