"""Scenes on a table with their exact truth, drawn from a seed: alone, crowded, stacked, cut by the image, and others.

A table stands on a floor and is looked down upon from about 1.1 m; what is on it rests as ``settle`` says. Bodies are
kept apart by the prisms around them, which may touch; that is stricter than need be where a body leaves room under it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np

from zsight_core.errors import ModelError
from zsight_core.model import Box, Cylinder, Mesh, ObjectModel, Shape, Sphere, Surface, size_of
from zsight_core.pinhole import Pinhole
from zsight_core.simulation.raycast import DepthView, render
from zsight_core.simulation.settle import RestingPose, gap, resting_poses, slide_to, stands_on
from zsight_core.simulation.world import Body, Camera, World
from zsight_core.transform import from_quaternion, from_rpy, inverse

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

__all__ = ["LEVELS", "TABLE_HEIGHT", "Level", "Placed", "RandomScene", "draw_scene", "scaled"]

Level = Literal[
    "alone",
    "+3",
    "+7",
    "+11 touching",
    "+16 occluded",
    "stacked",
    "truncated",
    "absent",
    "lookalike",
    "tilted",
    "glass",
    "book",
]
LEVELS: tuple[Level, ...] = get_args(Level)
"""What scenes there are; ``draw_scene`` says what each is."""

TABLE_HEIGHT = 0.7747
"""Metres from the floor to the table's top."""

COUNTS: dict[Level, int] = {
    "alone": 1,
    "+3": 4,
    "+7": 8,
    "+11 touching": 12,
    "+16 occluded": 17,
    "stacked": 7,
    "truncated": 4,
    "absent": 4,
    "lookalike": 4,
    "tilted": 4,
    "glass": 4,
}
CROWDED: tuple[Level, ...] = ("+11 touching", "+16 occluded")
PINHOLE = Pinhole(640, 480, 554.38, 554.38, 319.5, 239.5)
T_BOOK_CAMERA = from_rpy((0.027, 0, 1.810), (0, 1.2, 0)) @ from_quaternion((0, 0, 0), (-0.5, 0.5, -0.5, 0.5))
T_OPTICAL = from_quaternion((0, 0, 0), (-0.5, 0.5, -0.5, 0.5))
BOOK_TYPE = "toy_block"
TABLE = (0.9144, 0.9144, 0.04)
APART = 0.004
"""Metres between things that do not touch, at least."""

TOUCHING = 0.0008
"""Metres up to which things are apart that touch."""

TRIES = 150
HIGHEST_STACK = 0.3
"""Metres above the table that a stack reaches at most."""

LOOKALIKE = (0.85, 1.15)
"""Sizes of a lookalike over those of the type it looks like."""

LARGEST_TILT = np.radians(2.0)
GLASS_REFLECTS = 0.04


@dataclass(frozen=True, eq=False)
class Placed:
    """One object of a scene and where it truly is.

    Attributes:
        model: its type; of a lookalike, with other sizes and the name of the type it looks like and "-like".
        T_world_model: (4, 4) pose.
        base: metres from the table to its lowest point.
        outline: (K, 2) convex outline seen from above, world x and y.
        height: metres from its lowest to its highest point.
        visible: pixels of it that are seen over those that would be seen of it alone by a wider image, 0..1.
        truncated: the image's border cuts it.
        reflects: share of rays that come back, near 0 for glass.
    """

    model: ObjectModel
    T_world_model: NDArray[np.float64]
    base: float
    outline: NDArray[np.float64]
    height: float
    visible: float = 1.0
    truncated: bool = False
    reflects: float = 1.0


@dataclass(frozen=True, eq=False)
class RandomScene:
    """A scene, what an ideal camera sees of it, and the truth.

    Attributes:
        level: what kind of scene it is.
        seed: what it was drawn from.
        world: floor, table and objects, in this order; the objects are the last ``len(objects)`` bodies.
        camera: where the camera truly is.
        T_world_camera: (4, 4) where the camera is said to be; off by up to 2 degrees at level tilted.
        objects: what stands on the table, with its true pose.
        view: the ideal image; ``camera.expose`` makes a cloud of it.
    """

    level: Level
    seed: int
    world: World
    camera: Camera
    T_world_camera: NDArray[np.float64]
    objects: tuple[Placed, ...]
    view: DepthView


def draw_scene(level: Level, seed: int, models: Sequence[ObjectModel]) -> RandomScene:
    """One scene; the same arguments give the same scene, bit for bit.

    Levels: alone: one object; +3, +7: so many more, apart from each other; +11 touching and +16 occluded: most touch,
    the latter seen at a flatter angle; stacked: most stand on others; truncated: one or more are cut by the image's
    border; absent: the first model is in no place (the others are); lookalike: four objects, the first one a type made
    15 % smaller or larger, and no true one of it; tilted: the camera is said to be where it is not, by up to 2 degrees;
    glass: one of four objects hardly reflects; book: the toy block, or else the first model, where
    the book's block lies. Objects for which no room is found in a fair number of tries are left out.

    Args:
        level: what kind of scene.
        seed: decides everything else.
        models: types to draw from; surfaces are passed over.

    Raises:
        ModelError: there is no solid among the models.
    """
    solids = [model for model in models if not isinstance(model.shape, Surface)]
    if not solids:
        raise ModelError("no solid among the models; expected at least one box, cylinder, sphere or mesh")
    generator = np.random.default_rng([seed, LEVELS.index(level)])
    if level == "book":
        return _book(seed, solids)
    camera, focus = _camera(generator, level)
    ground = _Ground(camera, focus, level, *_table_place(generator, level, focus))
    table = _table_at(ground.middle, ground.yaw)
    placed = _place(generator, solids, ground)
    if level == "glass" and placed:
        placed[0] = replace(placed[0], reflects=GLASS_REFLECTS)
    told = camera.T_world_camera if level != "tilted" else _tilted(generator, camera.T_world_camera)
    return _seen(level, seed, [*_floor(), *table], camera, told, placed)


def scaled(shape: Shape, factor: float) -> Shape:
    """The shape with all its lengths multiplied; a surface stays as it is."""
    match shape:
        case Box((x, y, z)):
            return Box((x * factor, y * factor, z * factor))
        case Cylinder(diameter, height):
            return Cylinder(diameter * factor, height * factor)
        case Sphere(diameter):
            return Sphere(diameter * factor)
        case Mesh(vertices, faces):
            return Mesh(vertices * factor, faces)
        case _:
            return shape


def _book(seed: int, solids: list[ObjectModel]) -> RandomScene:
    model = next((solid for solid in solids if solid.name == BOOK_TYPE), solids[0])
    pose = resting_poses(model.shape)[0]
    if isinstance(model.shape, Box):  # as it lies in its own frame
        pose = min(resting_poses(model.shape), key=lambda p: -float(np.trace(p.R)))
    there = _at(model, pose, np.array([0.5, -0.35]), 0.43, 0.0)
    table = _table_at(np.array([0.756, -0.289]), 0.0)
    camera = Camera(PINHOLE, T_BOOK_CAMERA)
    return _seen("book", seed, [*_floor(), *table], camera, T_BOOK_CAMERA, [there])


def _camera(generator: np.random.Generator, level: Level) -> tuple[Camera, NDArray[np.float64]]:
    """A camera that looks along x and down, and the place (2,) on the table that it looks at."""
    pitch = generator.uniform(0.75, 0.95) if level == "+16 occluded" else generator.uniform(1.0, 1.25)
    distance = generator.uniform(1.05, 1.15)
    position = np.array([0.027, 0.0, TABLE_HEIGHT + distance * np.sin(pitch)])
    T = from_rpy(position, (0, pitch, 0)) @ T_OPTICAL
    return Camera(PINHOLE, T), position[:2] + np.array([distance * np.cos(pitch), 0.0])


def _floor() -> list[Body]:
    return [Body("floor", ObjectModel("floor", Surface(), (150, 152, 156)), np.eye(4))]


def _table_place(
    generator: np.random.Generator, level: Level, focus: NDArray[np.float64]
) -> tuple[NDArray[np.float64], float]:
    """Middle (2,) and yaw of the table; things can be cut where it reaches beyond the image to one side."""
    aside = np.array([0.0, generator.choice([-0.35, 0.35])]) if level == "truncated" else np.zeros(2)
    return focus + aside + generator.uniform(-0.06, 0.06, 2), generator.uniform(-0.5, 0.5)


def _table_at(middle: NDArray[np.float64], yaw: float) -> list[Body]:
    parts = (
        ("table_top", TABLE, TABLE_HEIGHT - 0.02, (181, 152, 114)),
        ("table_column", (0.042, 0.042, 0.69), 0.385, (92, 94, 98)),
        ("table_base", (0.56, 0.56, 0.04), 0.02, (92, 94, 98)),
    )
    return [
        Body(name, ObjectModel(name, Box(size), colour), from_rpy((*middle, height), (0, 0, yaw)))
        for name, size, height, colour in parts
    ]


def _tilted(generator: np.random.Generator, T_world_camera: NDArray[np.float64]) -> NDArray[np.float64]:
    """The pose turned about the camera by up to 2 degrees, as by an extrinsic that is not quite right."""
    axis = generator.standard_normal(3)
    half = generator.uniform(0, LARGEST_TILT) / 2
    turn = from_quaternion(np.zeros(3), np.append(axis / np.linalg.norm(axis) * np.sin(half), np.cos(half)))
    told = T_world_camera.copy()
    told[:3, :3] = turn[:3, :3] @ told[:3, :3]
    return told


@dataclass(frozen=True, eq=False)
class _Ground:
    """Where things can be put: what the camera looks at, and the table."""

    camera: Camera
    focus: NDArray[np.float64]
    level: Level
    middle: NDArray[np.float64]
    yaw: float

    @property
    def crowded(self) -> bool:
        return self.level in CROWDED

    @property
    def reach(self) -> float:
        """Metres around the focus within which things are put, in x and y."""
        return 0.2 if self.crowded else 0.3

    def somewhere(self, generator: np.random.Generator) -> NDArray[np.float64]:
        """A random place (2,) in view."""
        place: NDArray[np.float64] = self.focus + generator.uniform(-self.reach, self.reach, 2)
        return place

    def at_the_border(self, generator: np.random.Generator) -> NDArray[np.float64]:
        """A place (2,) on the table that falls within 45 pixels of the image's border on the table's side."""
        pinhole = self.camera.pinhole
        inward, v = generator.uniform(-5, 45), generator.uniform(0.2, 0.8) * pinhole.height
        u = inward if self.middle[1] > self.focus[1] else pinhole.width - 1 - inward
        T = self.camera.T_world_camera
        ray = T[:3, :3] @ [(u - pinhole.cx) / pinhole.fx, (v - pinhole.cy) / pinhole.fy, 1.0]
        place: NDArray[np.float64] = (T[:3, 3] + ray * (TABLE_HEIGHT - T[2, 3]) / ray[2])[:2]
        return place

    def carries(self, outline: NDArray[np.float64]) -> bool:
        """True where all of the outline lies on the table."""
        c, s = np.cos(self.yaw), np.sin(self.yaw)
        there = np.abs((outline - self.middle) @ np.array([[c, -s], [s, c]]))
        return bool((there < np.array(TABLE[:2]) / 2).all())


def _place(generator: np.random.Generator, solids: list[ObjectModel], ground: _Ground) -> list[Placed]:
    """Objects one after the other, each where the room and the level allow."""
    others = solids[1:] if ground.level == "absent" and len(solids) > 1 else solids
    placed: list[Placed] = []
    for number in range(COUNTS[ground.level]):
        model = others[generator.integers(len(others))]
        if ground.level == "lookalike" and number == 0:
            others = [solid for solid in solids if solid is not model] or solids
            factor = LOOKALIKE[generator.integers(len(LOOKALIKE))]
            model = ObjectModel(f"{model.name}-like", scaled(model.shape, factor), model.colour)
        there = _find_room(generator, model, placed, ground)
        if there is not None:
            placed.append(there)
    return placed


def _find_room(
    generator: np.random.Generator, model: ObjectModel, placed: list[Placed], ground: _Ground
) -> Placed | None:
    """The first of a number of random places at which the object penetrates nothing."""
    stacked = ground.level == "stacked"
    carrier = stacked and len(placed) < 2
    carried = stacked and not carrier and generator.random() < 0.8
    cut = ground.level == "truncated" and (not placed or generator.random() < 0.4)
    for _ in range(TRIES):
        pose, yaw = _any_pose(generator, model.shape), generator.uniform(0, 2 * np.pi)
        there: Placed | None
        if carrier and len(pose.top) < 3:
            continue
        if carried:
            there = _on_another(generator, model, pose, yaw, placed)
        elif ground.crowded and placed and generator.random() < 0.8:
            there = _beside_another(generator, model, pose, yaw, placed)
        else:
            xy = ground.at_the_border(generator) if cut else ground.somewhere(generator)
            there = _at(model, pose, xy, yaw, 0.0)
        if there is None or not ground.carries(there.outline) or _in_image(ground.camera, there) == cut:
            continue
        if ground.crowded and np.abs(there.outline - ground.focus).max() > ground.reach + 0.06:
            continue
        if all(_clear(there, other, 0.0 if ground.crowded or carried else APART) for other in placed):
            return there
    return None


def _any_pose(generator: np.random.Generator, shape: Shape) -> RestingPose:
    poses = resting_poses(shape)
    shares = np.array([pose.share for pose in poses])
    return poses[generator.choice(len(poses), p=shares / shares.sum())]


def _at(model: ObjectModel, pose: RestingPose, xy: NDArray[np.float64], yaw: float, base: float) -> Placed:
    """The object resting ``base`` metres above the table, its model's origin at xy."""
    T = from_rpy((xy[0], xy[1], TABLE_HEIGHT + base + pose.below), (0, 0, yaw))
    outline = pose.ground @ T[:2, :2].T + xy
    T[:3, :3] = T[:3, :3] @ pose.R
    return Placed(model, T, base, outline, pose.below + pose.above)


def _on_another(
    generator: np.random.Generator, model: ObjectModel, pose: RestingPose, yaw: float, placed: list[Placed]
) -> Placed | None:
    """The object on the level top of a random other one, its centre of mass well above it."""
    below = placed[generator.integers(len(placed))]
    top = _top_of(below)
    if len(top) < 3 or below.base + below.height + pose.below + pose.above > HIGHEST_STACK:
        return None
    T = from_rpy((0, 0, 0), (0, 0, yaw))
    spread = 0.3 * np.ptp(top, axis=0)
    centre = top.mean(axis=0) + generator.uniform(-0.5, 0.5, 2) * spread
    if not stands_on(top, centre):
        return None
    return _at(model, pose, centre - T[:2, :2] @ pose.centre, yaw, below.base + below.height)


def _top_of(placed: Placed) -> NDArray[np.float64]:
    """Outline (K, 2) of the level top, world x and y; empty where there is none."""
    R = placed.T_world_model[:3, :3]
    pose = min(resting_poses(placed.model.shape), key=lambda p: -float((R.T @ [0, 0, 1]) @ (p.R.T @ [0, 0, 1])))
    turn = R @ pose.R.T
    return pose.top @ turn[:2, :2].T + placed.T_world_model[:2, 3]


def _beside_another(
    generator: np.random.Generator, model: ObjectModel, pose: RestingPose, yaw: float, placed: list[Placed]
) -> Placed:
    """The object slid against a random other one until both (nearly) touch."""
    other = placed[generator.integers(len(placed))]
    angle = generator.uniform(0, 2 * np.pi)
    turn = from_rpy((0, 0, 0), (0, 0, yaw))[:2, :2]
    direction = np.array([np.cos(angle), np.sin(angle)])
    xy = slide_to(pose.ground @ turn.T, other.outline, direction, generator.uniform(0, TOUCHING))
    return _at(model, pose, xy, yaw, 0.0)


def _clear(one: Placed, other: Placed, distance: float) -> bool:
    """True where the prisms around both do not overlap; side by side they are at least the distance apart."""
    if one.base >= other.base + other.height or other.base >= one.base + one.height:
        return True
    return gap(one.outline, other.outline) >= distance


def _in_image(camera: Camera, placed: Placed) -> bool:
    """True where the box around the object lies inside the image."""
    pixels = _corner_pixels(camera, placed)
    last = [camera.pinhole.width - 1, camera.pinhole.height - 1]
    return bool((pixels > 2).all() and (pixels < np.array(last) - 2).all())


def _corner_pixels(camera: Camera, placed: Placed) -> NDArray[np.float64]:
    """Pixels (8, 2) of the corners of the box around the object."""
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    T = inverse(camera.T_world_camera) @ placed.T_world_model
    x, y, z = (signs * np.array(size_of(placed.model.shape)) / 2 @ T[:3, :3].T + T[:3, 3]).T
    pinhole = camera.pinhole
    return np.stack([pinhole.fx * x / z + pinhole.cx, pinhole.fy * y / z + pinhole.cy], axis=1)


def _seen(
    level: Level,
    seed: int,
    furniture: list[Body],
    camera: Camera,
    told: NDArray[np.float64],
    placed: list[Placed],
) -> RandomScene:
    """The scene with what is seen of each object."""
    bodies = [Body(thing.model.name, thing.model, thing.T_world_model, thing.reflects) for thing in placed]
    world = World((*furniture, *bodies))
    view = render(world, camera)
    seen = np.bincount(view.body_index[view.body_index >= 0], minlength=len(world.bodies))[len(furniture) :]
    objects = []
    for thing, body, pixels in zip(placed, bodies, seen, strict=True):
        alone, inside = _alone(body, thing, camera)
        objects.append(replace(thing, visible=float(pixels) / max(alone, 1), truncated=inside < alone))
    return RandomScene(level, seed, world, camera, told, tuple(objects), view)


def _alone(body: Body, placed: Placed, camera: Camera) -> tuple[int, int]:
    """Pixels of the object alone, in an image that is wide enough for all of it, and how many lie in the real one."""
    p, pixels = camera.pinhole, _corner_pixels(camera, placed)
    u0, v0 = np.floor(pixels.min(axis=0)).astype(int) - 1
    u1, v1 = np.ceil(pixels.max(axis=0)).astype(int) + 2
    window = Pinhole(int(u1 - u0), int(v1 - v0), p.fx, p.fy, p.cx - int(u0), p.cy - int(v0))
    hit = render(World((body,)), Camera(window, camera.T_world_camera)).body_index == 0
    inside = hit[max(-v0, 0) : max(p.height - v0, 0), max(-u0, 0) : max(p.width - u0, 0)]
    return int(hit.sum()), int(inside.sum())
