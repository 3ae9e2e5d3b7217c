"""Triangles of shapes, their z-buffer, their stable poses: laws that hold for every solid."""

from __future__ import annotations

import numpy as np
import pytest

from zsight_core.errors import ModelError
from zsight_core.model import Box, Cylinder, Mesh, Shape, Sphere, Surface
from zsight_core.render import draw, face_planes, place, region_of
from zsight_core.search.recognise.box import stable_poses as box_poses
from zsight_core.search.recognise.mesh import stable_poses as mesh_poses
from zsight_core.solid import Solid, solid_of

SHAPES: tuple[tuple[Shape, float], ...] = (
    (Box((0.035, 0.2, 0.05)), 0.035 * 0.2 * 0.05),
    (Cylinder(0.066, 0.122), np.pi * 0.033**2 * 0.122),
    (Sphere(0.07), np.pi * 0.07**3 / 6),
)
PINHOLE = (550.0, 550.0, 320.0, 240.0)


def volume_of(solid: Solid) -> float:
    a, b, c = (solid.vertices[solid.faces[:, k]] for k in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)


@pytest.mark.parametrize(("shape", "volume"), SHAPES)
def test_solids_are_closed_and_have_the_volume_of_the_shape(shape: Shape, volume: float) -> None:
    solid = solid_of(shape)
    assert (solid.edges[:, 3] >= 0).all()
    assert len(solid.vertices) - len(solid.edges) + len(solid.faces) == 2  # Euler
    assert volume_of(solid) == pytest.approx(volume, rel=0.01)


def test_mesh_turned_inside_out_is_turned_back_and_centred() -> None:
    box = solid_of(Box((0.1, 0.2, 0.3)))
    solid = solid_of(Mesh(box.vertices + np.array([1.0, 2.0, 3.0]), np.ascontiguousarray(box.faces[:, ::-1])))
    assert volume_of(solid) == pytest.approx(0.006)
    assert solid.vertices.min(axis=0) == pytest.approx([-0.05, -0.1, -0.15])


def test_surface_is_no_solid() -> None:
    with pytest.raises(ModelError, match="not a solid"):
        solid_of(Surface())


@pytest.mark.parametrize("shape", [shape for shape, _ in SHAPES])
def test_drawn_depth_is_that_of_the_nearest_face(shape: Shape) -> None:
    solid = solid_of(shape)
    T = np.eye(4)
    T[:3, :3] = np.array([[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0], [0.48, 0.64, 0.6]])
    T[:3, 3] = 0.05, -0.02, 1.1
    placed = place(T, solid.vertices)
    planes = face_planes(placed, solid.faces)
    region = region_of(placed, PINHOLE, 1_000_000)
    w, face = draw(placed, solid.faces, planes, PINHOLE, region)
    u0, v0, _, _, step = region
    assert step == 1
    assert (face >= 0).sum() > 500
    for row, column in np.argwhere(face >= 0)[::97]:
        ray = np.array([(u0 + column - 320.0) / 550.0, (v0 + row - 240.0) / 550.0, 1.0])
        n, d = planes[face[row, column], :3], planes[face[row, column], 3]
        assert 1 / w[row, column] == pytest.approx(d / (n @ ray), rel=1e-9)
        inside = np.linalg.inv(T) @ np.append(ray / w[row, column], 1.0)
        assert np.abs(inside[:3]).max() < np.ptp(solid.vertices, axis=0).max() / 2 + 1e-6


def test_what_lies_behind_the_camera_is_not_drawn() -> None:
    T = np.eye(4)
    T[2, 3] = -1.0
    assert region_of(place(T, solid_of(Box((0.1, 0.1, 0.1))).vertices), PINHOLE, 100)[2] == 0


def test_box_poses_put_each_different_side_down_once() -> None:
    assert len(box_poses((0.1, 0.2, 0.3))) == 3
    assert len(box_poses((0.035, 0.2, 0.035))) == 2
    assert len(box_poses((0.05, 0.05, 0.05))) == 1
    for R, tall in box_poses((0.1, 0.2, 0.3)):
        assert np.linalg.det(R) == pytest.approx(1.0)
        assert np.abs(R[2]) @ [0.1, 0.2, 0.3] == pytest.approx(tall)


def test_mesh_poses_of_a_box_are_its_six_sides() -> None:
    box = solid_of(Box((0.1, 0.2, 0.3)))
    poses = mesh_poses(Mesh(box.vertices, box.faces))
    assert len(poses) == 6
    assert poses[0][0] == pytest.approx(np.eye(3))
    assert sorted(round(tall, 6) for _, tall in poses) == [0.1, 0.1, 0.2, 0.2, 0.3, 0.3]


def test_a_pyramid_does_not_stand_on_its_tip() -> None:
    corners = np.array([[1, 1, 0], [-1, 1, 0], [-1, -1, 0], [1, -1, 0], [0, 0, 3]]) * 0.05
    faces = np.array([[0, 2, 1], [0, 3, 2], [0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]], dtype=np.int32)
    poses = mesh_poses(Mesh(corners, faces))
    for R, tall in poses:
        down = (corners @ R.T)[:, 2]
        assert (down < down.min() + 1e-6).sum() >= 3
        assert tall == pytest.approx(np.ptp(down))
