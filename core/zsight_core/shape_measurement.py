"""Measure what stands somewhere: which shape it has, how large it is and where it is, from one view.

A box, an upright and a lying cylinder and a ball are fitted in turn, each by rendering it and comparing it with the
depth image: pixels of the segment that the shape leaves out cost as much as pixels of the shape that the camera looks
through. The one that costs least is chosen.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from zsight_core.clues import clues_of
from zsight_core.errors import GeometryError
from zsight_core.model import Box, Cylinder, Shape, Sphere
from zsight_core.render import draw, face_planes, place
from zsight_core.solid import solid_of
from zsight_core.transform import inverse

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from zsight_core.scene import Scene, Segment
    from zsight_core.solid import Solid

__all__ = ["SHAPES", "Measurement", "measure_shape"]

FORM = 0.0015
"""Metres by which a real thing is off its ideal shape."""

OUTLIER = 3.0
"""Standard deviations from which a pixel speaks against a shape, and beyond which it does so no further."""

RASTER = 8000
"""Pixels that are compared at most."""

MARGIN = 8
"""Pixels around a segment that are looked at: what is too large covers them."""

HIDDEN_FOOT = 0.03
"""Metres above the surface from which a segment must be seen downward to be taken to stand on it."""

SMALLEST = 0.005
"""Metres; no dimension is taken for less."""

ENOUGH = 25
"""Pixels of a face that must be seen for it to tell anything."""


@dataclass(frozen=True, eq=False)
class Measurement:
    """A shape that was fitted to a segment."""

    shape: Shape
    T_camera_model: NDArray[np.float64]
    """(4, 4) its pose in the cloud's frame."""
    explained: float
    """Share of the pixels of shape and segment together that agree, 0..1."""
    misfit: float
    """Metres, root mean square distance in depth of those pixels."""
    explained_by: dict[str, float]
    """The same share for each shape that was tried."""


class _Family(NamedTuple):
    """A kind of shape with its parameters: x, y, yaw / 10 and dimensions, metres."""

    solid: Solid
    """Of unit size."""
    scale: Callable[[NDArray[np.float64]], NDArray[np.float64]]
    """Dimensions to edges (3,)."""
    R: NDArray[np.float64]
    """(3, 3) how it stands, before it is turned about the normal."""
    shape: Callable[[NDArray[np.float64]], Shape]
    """Dimensions to shape."""
    guess: Callable[[_Footprint], list[float]]
    turns: bool


class _Footprint(NamedTuple):
    """A segment as its surface sees it."""

    middle: NDArray[np.float64]
    """(2,) of the smallest rectangle around, metres in the support's frame."""
    yaw: float
    """Of its longer side, radians."""
    sides: tuple[float, float]
    """Metres, the longer one first."""
    tall: float
    """Metres above the surface."""


_LYING = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])

_FAMILIES = {
    "box": _Family(
        solid_of(Box((1.0, 1.0, 1.0))),
        lambda d: d,
        np.eye(3),
        lambda d: Box((float(d[0]), float(d[1]), float(d[2]))),
        lambda f: [*f.sides, f.tall],
        turns=True,
    ),
    "cylinder": _Family(
        solid_of(Cylinder(1.0, 1.0)),
        lambda d: np.array([d[0], d[0], d[1]]),
        np.eye(3),
        lambda d: Cylinder(float(d[0]), float(d[1])),
        lambda f: [max(f.sides), f.tall],
        turns=False,
    ),
    "lying cylinder": _Family(
        solid_of(Cylinder(1.0, 1.0)),
        lambda d: np.array([d[0], d[0], d[1]]),
        _LYING,
        lambda d: Cylinder(float(d[0]), float(d[1])),
        lambda f: [f.tall, max(f.sides)],
        turns=True,
    ),
    "sphere": _Family(
        solid_of(Sphere(1.0)),
        lambda d: np.array([d[0], d[0], d[0]]),
        np.eye(3),
        lambda d: Sphere(float(d[0])),
        lambda f: [f.tall],
        turns=False,
    ),
}

SHAPES = tuple(_FAMILIES)
"""Names of the shapes that are tried."""


def measure_shape(scene: Scene, segment: Segment, only: str = "") -> Measurement:
    """The shape, size and place of a segment that stands on its support surface.

    Args:
        scene: what the scene stage made of a cloud.
        segment: one of its segments.
        only: the shape that it is known to have, one of SHAPES; empty: the one that fits best.

    Raises:
        GeometryError: its foot is hidden or it stands on something else, or the view does not show all dimensions.
    """
    if segment.low > HIDDEN_FOOT:
        raise GeometryError(
            f"the lowest part seen of the segment is {segment.low * 1e3:.0f} mm above the surface; expected to see its"
            " foot: put it on the surface by itself, with nothing in front"
        )
    target = _Target(scene, segment)
    footprint = _footprint_of(scene, segment, target)
    fits = {name: _fit(family, target, footprint) for name, family in _FAMILIES.items() if only in ("", name)}
    best = min(fits, key=lambda name: fits[name][0])
    family, parameters = _FAMILIES[best], fits[best][1]
    if best == "box":
        _require_sides(family, target, parameters)
    T_support_model, _ = _placed(family, parameters)
    agreements = {name: target.agreement(_FAMILIES[name], fit[1]) for name, fit in fits.items()}
    return Measurement(
        family.shape(parameters[3:]),
        scene.supports[segment.support].T_camera_support @ T_support_model,
        agreements[best],
        target.misfit(family, parameters),
        agreements,
    )


class _Target:
    """The depth image around a segment."""

    def __init__(self, scene: Scene, segment: Segment) -> None:
        view = scene.view
        self.pinhole = view.pinhole
        self.T_optical_support = inverse(view.T_cloud_optical) @ scene.supports[segment.support].T_camera_support
        inside = scene.pixel_labels == segment.label
        rows, columns = np.flatnonzero(inside.any(axis=1)), np.flatnonzero(inside.any(axis=0))
        v0, u0 = max(int(rows[0]) - MARGIN, 0), max(int(columns[0]) - MARGIN, 0)
        v1, u1 = int(rows[-1]) + MARGIN, int(columns[-1]) + MARGIN
        step = max(1, int(np.ceil(np.sqrt((v1 - v0) * (u1 - u0) / RASTER))))
        self.inside = inside[v0:v1:step, u0:u1:step]
        depth = view.depth[v0:v1:step, u0:u1:step].astype(np.float64)
        self.region = (u0, v0, self.inside.shape[1], self.inside.shape[0], step)
        self.measured = depth > 0
        self.w = np.where(self.measured, 1 / np.where(self.measured, depth, 1.0), 0.0)
        self.sigma = np.hypot(scene.noise, FORM * np.maximum(self.w, 0.1) ** 2)
        z = np.where(self.measured, depth, np.nan)[self.inside]
        v, u = np.nonzero(self.inside)
        fx, fy, cx, cy = self.pinhole
        rays = np.column_stack([(u0 + step * u - cx) / fx, (v0 + step * v - cy) / fy, np.ones(len(u))])
        T = inverse(self.T_optical_support)
        self.points: NDArray[np.float64] = (rays * z[:, np.newaxis]) @ T[:3, :3].T + T[:3, 3]

    def drawn(self, family: _Family, parameters: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
        """Inverse depth of the shape and the face seen, as the target's raster."""
        T_support_model, scale = _placed(family, parameters)
        vertices = place(self.T_optical_support @ T_support_model, family.solid.vertices * scale)
        faces = family.solid.faces
        return draw(vertices, faces, face_planes(vertices, faces), self.pinhole, self.region)

    def cost(self, family: _Family, parameters: NDArray[np.float64]) -> float:
        """Share of the pixels of shape and segment that disagree, those a little off in part."""
        if parameters[3:].min() < SMALLEST:
            return 1.0 + SMALLEST - float(parameters[3:].min())
        off, counted = self._off(family, parameters)
        return float((np.minimum(off, 1.0) ** 2)[counted].mean()) if counted.any() else 1.0

    def agreement(self, family: _Family, parameters: NDArray[np.float64]) -> float:
        """Share of the pixels of shape and segment that agree."""
        off, counted = self._off(family, parameters)
        return float((off < 1.0)[counted].mean()) if counted.any() else 0.0

    def _off(self, family: _Family, parameters: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        """How far each pixel is off over what is an outlier, and the pixels that count: nothing nearer hides them."""
        w, _ = self.drawn(family, parameters)
        solid = w > 0
        off = np.abs(self.w - w) / (OUTLIER * self.sigma)
        off[~solid] = 1.0
        hidden = solid & ~self.inside & (self.w - w > OUTLIER * self.sigma)
        return off, (solid | self.inside) & self.measured & ~hidden

    def misfit(self, family: _Family, parameters: NDArray[np.float64]) -> float:
        """Root mean square distance in depth of the pixels that agree, metres."""
        w, _ = self.drawn(family, parameters)
        agree = self.inside & (w > 0) & (np.abs(self.w - w) < OUTLIER * self.sigma)
        if not agree.any():
            return float("inf")
        return float(np.sqrt(np.mean(((self.w - w)[agree] / (self.w * np.maximum(w, 1e-9))[agree]) ** 2)))


def _placed(family: _Family, parameters: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """T_support_model (4, 4), and what the unit solid is scaled by (3,)."""
    scale = family.scale(parameters[3:])
    c, s = np.cos(10 * parameters[2]), np.sin(10 * parameters[2])
    T = np.eye(4)
    T[:3, :3] = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ family.R
    T[:3, 3] = parameters[0], parameters[1], float(np.abs(family.R @ scale)[2]) / 2
    return T, scale


def _fit(family: _Family, target: _Target, footprint: _Footprint) -> tuple[float, NDArray[np.float64]]:
    """Least cost and the parameters that have it (Nelder and Mead 1965, started again where it stopped)."""
    from scipy.optimize import minimize

    parameters = np.array([*footprint.middle, footprint.yaw / 10, *family.guess(footprint)])
    free = np.array([True, True, family.turns] + [True] * (len(parameters) - 3))
    cost = np.inf
    for spread in (0.008, 0.003):

        def of(values: NDArray[np.float64], start: NDArray[np.float64] = parameters) -> float:
            trial = start.copy()
            trial[free] = values
            return target.cost(family, trial)

        start = parameters[free]
        simplex = np.vstack([start, start + spread * np.eye(len(start))])
        found = minimize(
            of,
            start,
            method="Nelder-Mead",
            options={"initial_simplex": simplex, "xatol": 5e-5, "fatol": 1e-5, "maxfev": 250},
        )
        parameters[free] = found.x
        cost = float(found.fun)
    return cost, parameters


def _footprint_of(scene: Scene, segment: Segment, target: _Target) -> _Footprint:
    """The smallest rectangle around a segment seen from above, and how tall it is."""
    xy = target.points[:, :2]
    best = (np.inf, 0.0, np.zeros(2), (0.0, 0.0))
    for yaw in np.arange(45) * np.pi / 90:
        R = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
        low, high = np.quantile(xy @ R, [0.005, 0.995], axis=0)
        area = float(np.prod(high - low))
        if area < best[0]:
            best = (area, float(yaw), R @ (low + high) / 2, (float(high[0] - low[0]), float(high[1] - low[1])))
    tops = [layer for layer in clues_of(scene).layers if layer.segment == segment.label]
    top = max(tops, key=lambda layer: len(layer.points), default=None)
    tall = top.height if top is not None else float(np.quantile(target.points[:, 2], 0.985))
    _, yaw, middle, (along, across) = best
    if along < across:
        return _Footprint(middle, yaw + np.pi / 2, (across, along), tall)
    return _Footprint(middle, yaw, (along, across), tall)


def _require_sides(family: _Family, target: _Target, parameters: NDArray[np.float64]) -> None:
    """That enough faces of a box are seen to tell all its dimensions: its top, or two of its sides."""
    _, face = target.drawn(family, parameters)
    axis = np.abs(family.solid.vertices[family.solid.faces]).min(axis=1) > 0.49
    flat = np.ptp(family.solid.vertices[family.solid.faces], axis=1) < 1e-9
    seen = [int((flat[face[face >= 0], a] & axis[face[face >= 0], a]).sum()) * target.region[4] ** 2 for a in range(3)]
    if seen[2] < ENOUGH and min(seen[:2]) < ENOUGH:
        raise GeometryError(
            "only one side of the box is seen, so its depth cannot be measured: turn it until two sides show, or look"
            " at it from higher up"
        )
