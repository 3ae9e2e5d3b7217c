from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from zsight_core.errors import GeometryError
from zsight_core.model import Box, Cylinder, Mesh, ObjectModel, Shape, Sphere, Surface
from zsight_core.pinhole import Pinhole
from zsight_core.simulation.raycast import DepthView, render
from zsight_core.simulation.world import Body, Camera, World
from zsight_core.transform import from_rpy, inverse, transform_xyz

if TYPE_CHECKING:
    from numpy.typing import NDArray

PINHOLE = Pinhole(96, 72, 90.0, 91.0, 47.2, 35.6)
CAMERA = Camera(PINHOLE, from_rpy((0.1, -0.2, 0.05), (0.2, -0.1, 0.3)))
BOX = Box((0.3, 0.2, 0.4))


def body(shape: Shape, T_world_model: NDArray[np.float64]) -> Body:
    return Body("body", ObjectModel("body", shape), T_world_model)


def ahead(distance: float, rpy: tuple[float, float, float]) -> NDArray[np.float64]:
    """A place in front of the camera, turned."""
    return np.asarray(CAMERA.T_world_camera @ from_rpy((0.03, -0.02, distance), rpy))


def hits_in_model(view: DepthView, T_world_model: NDArray[np.float64], index: int = 0) -> NDArray[np.float64]:
    rays = np.concatenate([PINHOLE.rays(), np.ones((*view.depth.shape, 1))], axis=-1)
    seen = view.body_index == index
    T_model_camera = inverse(T_world_model) @ CAMERA.T_world_camera
    return np.asarray(transform_xyz(T_model_camera, (rays * view.depth[..., None])[seen]))


def distance_to_surface(shape: Shape, xyz: NDArray[np.float64]) -> NDArray[np.float64]:
    """Absolute distance of points that are known to be near the surface, by the textbook."""
    match shape:
        case Box(size):
            return np.asarray(np.abs((np.abs(xyz) - np.array(size) / 2).max(axis=1)))
        case Cylinder(diameter, height):
            side = np.hypot(xyz[:, 0], xyz[:, 1]) - diameter / 2
            return np.abs(np.maximum(side, np.abs(xyz[:, 2]) - height / 2))
        case Sphere(diameter):
            return np.asarray(np.abs(np.linalg.norm(xyz, axis=1) - diameter / 2))
        case _:
            return np.abs(xyz[:, 2])


def cuboid_mesh(size: tuple[float, float, float]) -> Mesh:
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * np.array(size) / 2
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = [triangle for a, b, c, d in quads for triangle in ((a, b, c), (a, c, d))]
    return Mesh(corners, np.array(faces, dtype=np.int32))


@pytest.mark.parametrize("shape", [BOX, Cylinder(0.3, 0.4), Sphere(0.4), Surface()])
@pytest.mark.parametrize("rpy", [(0.3, 0.4, 0.5), (2.0, -1.0, 0.1), (0.0, 0.0, 0.0)])
def test_every_ray_ends_on_the_surface(shape: Shape, rpy: tuple[float, float, float]) -> None:
    T_world_model = ahead(1.1, rpy)
    view = render(World((body(shape, T_world_model),)), CAMERA)
    hits = hits_in_model(view, T_world_model)
    assert len(hits) > 300
    assert distance_to_surface(shape, hits).max() < 1e-12


@pytest.mark.parametrize("shape", [BOX, Cylinder(0.3, 0.4), Sphere(0.4)])
def test_the_near_side_is_seen_and_normals_face_the_eye(shape: Shape) -> None:
    view = render(World((body(shape, ahead(1.1, (0.3, 0.4, 0.5))),)), CAMERA)
    seen = view.body_index == 0
    rays = np.concatenate([PINHOLE.rays(), np.ones((*view.depth.shape, 1))], axis=-1)
    assert ((view.normal * rays).sum(axis=-1)[seen] < 1e-6).all()
    assert np.allclose(np.linalg.norm(view.normal[seen], axis=1), 1, atol=1e-6)


@pytest.mark.parametrize("rpy", [(0.3, 0.4, 0.5), (0.0, 0.0, 0.0)])
def test_a_mesh_of_a_cuboid_is_the_cuboid_without_cracks(rpy: tuple[float, float, float]) -> None:
    T_world_model = ahead(0.9, rpy)
    exact = render(World((body(BOX, T_world_model),)), CAMERA)
    mesh = render(World((body(cuboid_mesh(BOX.size), T_world_model),)), CAMERA)
    assert np.array_equal(exact.body_index, mesh.body_index)
    assert np.allclose(exact.depth, mesh.depth, rtol=0, atol=1e-12, equal_nan=True)
    assert np.allclose(exact.normal, mesh.normal, atol=1e-6)


def test_a_mesh_around_the_eye_is_seen_from_inside() -> None:
    T_world_model = ahead(0.05, (0.3, 0.4, 0.5))
    exact = render(World((body(Box((2, 2, 2)), T_world_model),)), CAMERA)
    mesh = render(World((body(cuboid_mesh((2, 2, 2)), T_world_model),)), CAMERA)
    assert (exact.body_index == 0).all()
    assert np.allclose(exact.depth, mesh.depth, rtol=0, atol=1e-12)


def test_the_nearest_body_hides_the_others_whatever_their_order() -> None:
    near, far = body(Sphere(0.2), ahead(0.8, (0, 0, 0))), body(Surface(), ahead(1.5, (0.2, 0.1, 0)))
    one, other = render(World((near, far)), CAMERA), render(World((far, near)), CAMERA)
    assert np.array_equal(one.depth, other.depth)
    assert np.array_equal(one.body_index == 0, other.body_index == 1)
    assert (one.body_index == 0).any()
    assert (one.body_index == 1).any()


def test_moving_world_and_camera_together_changes_nothing() -> None:
    T = from_rpy((3, -2, 1), (0.5, 1.0, -2.0))
    here = ahead(1.0, (0.3, 0.4, 0.5))
    before = render(World((body(BOX, here),)), CAMERA)
    after = render(World((body(BOX, T @ here),)), Camera(PINHOLE, T @ CAMERA.T_world_camera))
    assert np.array_equal(before.body_index, after.body_index)
    assert np.allclose(before.depth, after.depth, rtol=0, atol=1e-12, equal_nan=True)


def test_what_is_behind_the_eye_is_not_seen() -> None:
    shapes: tuple[Shape, ...] = (BOX, Cylinder(0.3, 0.4), Sphere(0.4), cuboid_mesh(BOX.size))
    view = render(World(tuple(body(shape, ahead(-1.0, (0.3, 0.4, 0.5))) for shape in shapes)), CAMERA)
    assert (view.body_index == -1).all()
    assert np.isnan(view.depth).all()


def test_an_empty_world_is_all_holes() -> None:
    view = render(World(()), CAMERA)
    assert np.isnan(view.depth).all()
    assert view.colour.max() == 0


def test_a_scaled_place_is_refused() -> None:
    with pytest.raises(GeometryError, match="no rigid transform"):
        body(BOX, 2 * np.eye(4))
    with pytest.raises(GeometryError, match="no rigid transform"):
        body(BOX, np.diag([1.0, 1.0, -1.0, 1.0]))
    with pytest.raises(GeometryError, match="distortion"):
        Camera(Pinhole(8, 8, 8.0, 8.0, 3.5, 3.5, (0.1, 0.0, 0.0, 0.0, 0.0)), np.eye(4))
