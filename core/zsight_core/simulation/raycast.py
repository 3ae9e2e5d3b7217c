"""Cast one ray a pixel into a world: exact depth, in float64, of the nearest body.

Boxes, cylinders, spheres and planes are met in closed form (Ericson, Real-Time Collision Detection, 2005, chapter 5.3);
a mesh triangle by the signs of the three planes through its edges and the eye, which leaves no crack between
neighbours because both compute the same number for the edge they share.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from zsight_core.jit import njit
from zsight_core.model import Box, Cylinder, Mesh, ObjectModel, Shape, Sphere, Surface, size_of
from zsight_core.transform import inverse

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from zsight_core.pinhole import Pinhole
    from zsight_core.simulation.world import Camera, World

__all__ = ["DepthView", "render", "warm_up"]

PALETTE = (
    (203, 75, 66),
    (70, 120, 180),
    (230, 170, 60),
    (90, 160, 95),
    (145, 105, 170),
    (70, 165, 165),
    (190, 130, 95),
)
SURFACE_COLOUR = (150, 152, 156)
LIGHT_IN_WORLD = np.array([-0.48, 0.36, 0.8])  # from behind the usual camera, which looks along x
AMBIENT, DIFFUSE, HEADLIGHT = 0.35, 0.4, 0.25  # shares of brightness
NEAREST = 1e-6  # metres in front of the lens

BOX, CYLINDER, SPHERE, PLANE = 0, 1, 2, 3


@dataclass(frozen=True, eq=False)
class DepthView:
    """What an ideal camera sees, one ray through the centre of each pixel.

    Attributes:
        depth: (H, W) float64, metres along the optical z axis; NaN where nothing was hit.
        body_index: (H, W) int32, index into ``World.bodies``; -1 where nothing was hit.
        normal: (H, W, 3) float32, unit outward normal of the surface hit, camera frame; zeros where nothing was hit.
        colour: (H, W, 3) uint8, red green blue under diffuse light.
        reflects: (bodies,) float64, share of rays that come back from each body.
    """

    depth: NDArray[np.float64]
    body_index: NDArray[np.int32]
    normal: NDArray[np.float32]
    colour: NDArray[np.uint8]
    reflects: NDArray[np.float64]


def render(world: World, camera: Camera) -> DepthView:
    """See the world through the camera, without noise.

    Args:
        world: bodies; only the side that faces the camera is seen.
        camera: image size, intrinsics and place.
    """
    pinhole = camera.pinhole
    depth = np.full((pinhole.height, pinhole.width), np.inf)
    body_index = np.full(depth.shape, -1, dtype=np.int32)
    normal = np.zeros((*depth.shape, 3), dtype=np.float32)
    intrinsics = (pinhole.fx, pinhole.fy, pinhole.cx, pinhole.cy)
    T_camera_world = inverse(camera.T_world_camera)
    for index, body in enumerate(world.bodies):
        T_camera_model = T_camera_world @ body.T_world_model
        shape = body.model.shape
        if isinstance(shape, Mesh):
            vertices = shape.vertices @ T_camera_model[:3, :3].T + T_camera_model[:3, 3]
            _draw_mesh(vertices, shape.faces, intrinsics, index, depth, body_index, normal)
        else:
            kind, half = _solid(shape)
            bounds = _image_bounds(shape, T_camera_model, pinhole)
            _draw_solid(kind, half, inverse(T_camera_model), bounds, intrinsics, index, depth, body_index, normal)
    light = T_camera_world[:3, :3] @ LIGHT_IN_WORLD
    colour = np.zeros((*depth.shape, 3), dtype=np.uint8)
    _shade(body_index, normal, _body_colours(world), light, intrinsics, colour, depth)
    reflects = np.array([body.reflects for body in world.bodies], dtype=np.float64)
    return DepthView(depth, body_index, normal, colour, reflects)


def warm_up() -> None:
    """Compile the kernels of this module, or load them from the cache, on one body of each kind."""
    from zsight_core.pinhole import Pinhole
    from zsight_core.simulation.world import Body, Camera, World

    tetrahedron = Mesh(np.eye(4, 3), np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]], dtype=np.int32))
    shapes = (Surface(), Box((0.1, 0.1, 0.1)), Cylinder(0.1, 0.1), Sphere(0.1), tetrahedron)
    ahead = np.eye(4)
    ahead[2, 3] = 2.0
    world = World(tuple(Body("warm-up", ObjectModel("warm-up", shape), ahead) for shape in shapes))
    render(world, Camera(Pinhole(8, 8, 8.0, 8.0, 3.5, 3.5), np.eye(4)))


def _solid(shape: Shape) -> tuple[int, NDArray[np.float64]]:
    half = np.array(size_of(shape)) / 2
    match shape:
        case Box():
            return BOX, half
        case Cylinder():
            return CYLINDER, half
        case Sphere():
            return SPHERE, half
        case _:
            return PLANE, half


def _image_bounds(shape: Shape, T_camera_model: NDArray[np.float64], pinhole: Pinhole) -> tuple[int, int, int, int]:
    """First and one past the last column and row that the shape's bounding box can touch."""
    corners = np.stack(np.meshgrid([-1, 1], [-1, 1], [-1, 1]), axis=-1).reshape(8, 3) * np.array(size_of(shape)) / 2
    x, y, z = (corners @ T_camera_model[:3, :3].T + T_camera_model[:3, 3]).T
    if isinstance(shape, Surface) or z.min() <= NEAREST:
        return 0, pinhole.width, 0, pinhole.height
    u, v = pinhole.fx * x / z + pinhole.cx, pinhole.fy * y / z + pinhole.cy
    columns = np.clip([np.floor(u.min()), np.ceil(u.max()) + 1], 0, pinhole.width).astype(int)
    rows = np.clip([np.floor(v.min()), np.ceil(v.max()) + 1], 0, pinhole.height).astype(int)
    return int(columns[0]), int(columns[1]), int(rows[0]), int(rows[1])


def _body_colours(world: World) -> NDArray[np.uint8]:
    """Colours (bodies, 3) uint8: the model's own, else one from the palette by position in the world."""
    chosen = []
    for index, body in enumerate(world.bodies):
        fallback = SURFACE_COLOUR if isinstance(body.model.shape, Surface) else PALETTE[index % len(PALETTE)]
        chosen.append(body.model.colour or fallback)
    return np.array(chosen, dtype=np.uint8).reshape(-1, 3)


@njit(cache=True, nogil=True, inline="always")
def _hit_box(o: Any, d: Any, half: Any) -> tuple[float, float, float, float]:
    """Nearest crossing in front of the eye: ray parameter (inf: none) and outward normal."""
    enter, leave = -np.inf, np.inf
    enter_axis, leave_axis = 0, 0
    for axis in range(3):
        if d[axis] == 0.0:
            if abs(o[axis]) > half[axis]:
                return np.inf, 0.0, 0.0, 0.0
            continue
        near = (-half[axis] - o[axis]) / d[axis]
        far = (half[axis] - o[axis]) / d[axis]
        if near > far:
            near, far = far, near
        if near > enter:
            enter, enter_axis = near, axis
        if far < leave:
            leave, leave_axis = far, axis
    if enter > leave:
        return np.inf, 0.0, 0.0, 0.0
    t, axis = (enter, enter_axis) if enter > NEAREST else (leave, leave_axis)
    if t <= NEAREST:
        return np.inf, 0.0, 0.0, 0.0
    sign = 1.0 if o[axis] + t * d[axis] > 0 else -1.0
    return t, sign * (axis == 0), sign * (axis == 1), sign * (axis == 2)


@njit(cache=True, nogil=True, inline="always")
def _roots(a: float, b: float, c: float) -> tuple[float, float]:
    """Roots of a t^2 + 2 b t + c in rising order, without cancellation; infinite where there are none."""
    discriminant = b * b - a * c
    if discriminant < 0.0 or a == 0.0:
        return np.inf, np.inf
    q = -(b + np.copysign(np.sqrt(discriminant), b))
    first, second = q / a, (c / q if q != 0.0 else q / a)
    if first > second:
        return second, first
    return first, second


@njit(cache=True, nogil=True, inline="always")
def _hit_cylinder(o: Any, d: Any, half: Any) -> tuple[float, float, float, float]:
    radius, half_height = half[0], half[2]
    best, nx, ny, nz = np.inf, 0.0, 0.0, 0.0
    sides = _roots(d[0] * d[0] + d[1] * d[1], o[0] * d[0] + o[1] * d[1], o[0] * o[0] + o[1] * o[1] - radius * radius)
    for t in sides:
        if NEAREST < t < best and abs(o[2] + t * d[2]) <= half_height:
            best, nx, ny, nz = t, (o[0] + t * d[0]) / radius, (o[1] + t * d[1]) / radius, 0.0
    if d[2] != 0.0:
        for cap in (-half_height, half_height):
            t = (cap - o[2]) / d[2]
            x, y = o[0] + t * d[0], o[1] + t * d[1]
            if NEAREST < t < best and x * x + y * y <= radius * radius:
                best, nx, ny, nz = t, 0.0, 0.0, np.copysign(1.0, cap)
    return best, nx, ny, nz


@njit(cache=True, nogil=True, inline="always")
def _hit_sphere(o: Any, d: Any, half: Any) -> tuple[float, float, float, float]:
    radius = half[0]
    a = d[0] * d[0] + d[1] * d[1] + d[2] * d[2]
    b = o[0] * d[0] + o[1] * d[1] + o[2] * d[2]
    c = o[0] * o[0] + o[1] * o[1] + o[2] * o[2] - radius * radius
    first, second = _roots(a, b, c)
    t = first if first > NEAREST else second
    if not NEAREST < t < np.inf:
        return np.inf, 0.0, 0.0, 0.0
    return t, (o[0] + t * d[0]) / radius, (o[1] + t * d[1]) / radius, (o[2] + t * d[2]) / radius


@njit(cache=True, nogil=True, inline="always")
def _hit_plane(o: Any, d: Any) -> tuple[float, float, float, float]:
    t = -o[2] / d[2] if d[2] != 0.0 else np.inf
    if t <= NEAREST:
        return np.inf, 0.0, 0.0, 0.0
    return t, 0.0, 0.0, np.copysign(1.0, o[2])


@njit(cache=True, nogil=True)
def _draw_solid(
    kind: int,
    half: Any,
    T_model_camera: Any,
    bounds: tuple[int, int, int, int],
    intrinsics: tuple[float, float, float, float],
    index: int,
    depth: Any,
    body_index: Any,
    normal: Any,
) -> None:
    """Meet one closed-form body with the rays inside its bounds; rays are (x, y, 1), so their parameter is depth."""
    fx, fy, cx, cy = intrinsics
    R = T_model_camera
    o = (T_model_camera[0, 3], T_model_camera[1, 3], T_model_camera[2, 3])
    for v in range(bounds[2], bounds[3]):
        y = (v - cy) / fy
        for u in range(bounds[0], bounds[1]):
            x = (u - cx) / fx
            d = (
                R[0, 0] * x + R[0, 1] * y + R[0, 2],
                R[1, 0] * x + R[1, 1] * y + R[1, 2],
                R[2, 0] * x + R[2, 1] * y + R[2, 2],
            )
            if kind == BOX:
                t, nx, ny, nz = _hit_box(o, d, half)
            elif kind == CYLINDER:
                t, nx, ny, nz = _hit_cylinder(o, d, half)
            elif kind == SPHERE:
                t, nx, ny, nz = _hit_sphere(o, d, half)
            else:
                t, nx, ny, nz = _hit_plane(o, d)
            if t < depth[v, u]:
                depth[v, u] = t
                body_index[v, u] = index
                for axis in range(3):
                    normal[v, u, axis] = R[0, axis] * nx + R[1, axis] * ny + R[2, axis] * nz


@njit(cache=True, nogil=True, inline="always")
def _cross(a: Any, b: Any) -> tuple[float, float, float]:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@njit(cache=True, nogil=True, inline="always")
def _triangle_bounds(
    a: Any, b: Any, c: Any, intrinsics: tuple[float, float, float, float], height: int, width: int
) -> tuple[int, int, int, int]:
    if min(a[2], b[2], c[2]) <= NEAREST:
        return 0, width, 0, height
    fx, fy, cx, cy = intrinsics
    ua, ub, uc = fx * a[0] / a[2] + cx, fx * b[0] / b[2] + cx, fx * c[0] / c[2] + cx
    va, vb, vc = fy * a[1] / a[2] + cy, fy * b[1] / b[2] + cy, fy * c[1] / c[2] + cy
    first_u = min(max(np.floor(min(ua, ub, uc)), 0.0), float(width))
    last_u = min(max(np.ceil(max(ua, ub, uc)) + 1, 0.0), float(width))
    first_v = min(max(np.floor(min(va, vb, vc)), 0.0), float(height))
    last_v = min(max(np.ceil(max(va, vb, vc)) + 1, 0.0), float(height))
    return int(first_u), int(last_u), int(first_v), int(last_v)


@njit(cache=True, nogil=True)
def _draw_mesh(
    vertices: Any,
    faces: Any,
    intrinsics: tuple[float, float, float, float],
    index: int,
    depth: Any,
    body_index: Any,
    normal: Any,
) -> None:
    """Meet each triangle (vertices in the camera frame) with the rays inside its bounds."""
    fx, fy, cx, cy = intrinsics
    height, width = depth.shape
    for f in range(len(faces)):
        a, b, c = vertices[faces[f, 0]], vertices[faces[f, 1]], vertices[faces[f, 2]]
        edges = (_cross(a, b), _cross(b, c), _cross(c, a))
        n = (
            edges[0][0] + edges[1][0] + edges[2][0],
            edges[0][1] + edges[1][1] + edges[2][1],
            edges[0][2] + edges[1][2] + edges[2][2],
        )
        area = np.sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2])
        height_of_plane = n[0] * a[0] + n[1] * a[1] + n[2] * a[2]
        if area == 0.0 or height_of_plane == 0.0:
            continue
        facing = -1.0 if height_of_plane > 0 else 1.0
        u0, u1, v0, v1 = _triangle_bounds(a, b, c, intrinsics, height, width)
        for v in range(v0, v1):
            y = (v - cy) / fy
            for u in range(u0, u1):
                x = (u - cx) / fx
                ab = edges[0][0] * x + edges[0][1] * y + edges[0][2]
                bc = edges[1][0] * x + edges[1][1] * y + edges[1][2]
                ca = edges[2][0] * x + edges[2][1] * y + edges[2][2]
                if not ((ab >= 0 and bc >= 0 and ca >= 0) or (ab <= 0 and bc <= 0 and ca <= 0)):
                    continue
                slope = n[0] * x + n[1] * y + n[2]
                if slope == 0.0:
                    continue
                t = height_of_plane / slope
                if NEAREST < t < depth[v, u]:
                    depth[v, u] = t
                    body_index[v, u] = index
                    for axis in range(3):
                        normal[v, u, axis] = facing * n[axis] / area


@njit(cache=True, nogil=True)
def _shade(
    body_index: Any,
    normal: Any,
    body_colours: Any,
    light: Any,
    intrinsics: tuple[float, float, float, float],
    colour: Any,
    depth: Any,
) -> None:
    """Fill colour by Lambert's law for a far light and one at the eye; infinite depth of missed rays becomes NaN."""
    fx, fy, cx, cy = intrinsics
    height, width = body_index.shape
    for v in range(height):
        y = (v - cy) / fy
        for u in range(width):
            index = body_index[v, u]
            if index < 0:
                depth[v, u] = np.nan
                continue
            x = (u - cx) / fx
            nx, ny, nz = normal[v, u, 0], normal[v, u, 1], normal[v, u, 2]
            lit = max(nx * light[0] + ny * light[1] + nz * light[2], 0.0)
            facing = -(nx * x + ny * y + nz) / np.sqrt(x * x + y * y + 1)
            brightness = AMBIENT + DIFFUSE * lit + HEADLIGHT * facing
            for channel in range(3):
                colour[v, u, channel] = np.uint8(brightness * body_colours[index, channel])
