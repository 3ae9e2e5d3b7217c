"""Depth noise of a time-of-flight camera: a second kind of sensor, unlike the Kinect in every respect."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from zsight_core.jit import njit
from zsight_core.simulation.depth_edge import JUMP, depth_around

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from zsight_core.pinhole import Pinhole
    from zsight_core.simulation.raycast import DepthView

__all__ = ["TimeOfFlight", "warm_up"]


@dataclass(frozen=True)
class TimeOfFlight:
    """Gaussian noise along the ray that grows where little light returns, and flying pixels at edges.

    Method: the spread goes with one over the amplitude of the returned light (Lange and Seitz, Solid-state
    time-of-flight range camera, 2001), here range squared over the cosine of incidence. No rounding, no shadow, no
    jitter; a pixel on an edge collects light of both surfaces and reads a distance between them.

    Attributes:
        noise_at_one_metre: standard deviation along the ray of a wall met head-on at one metre, metres.
        floor: standard deviation that remains however bright the return is, metres.
        flying: share of pixels at a depth edge that read something between both surfaces.
        dropout: share of all pixels that read nothing.
        grazing: cosine of incidence below which nothing comes back.
        minimum_range: nearest range, metres.
        maximum_range: farthest range, metres.
    """

    noise_at_one_metre: float = 0.0012
    floor: float = 0.0004
    flying: float = 0.6
    dropout: float = 0.001
    grazing: float = 0.08
    minimum_range: float = 0.25
    maximum_range: float = 5.0

    def measure(self, view: DepthView, pinhole: Pinhole, generator: np.random.Generator) -> NDArray[np.float64]:
        """Depth (H, W) float64 as this sensor would report it, metres; NaN where it reports nothing."""
        shape = view.depth.shape
        normals = generator.standard_normal(shape, dtype=np.float32)
        uniforms = generator.random((2, *shape), dtype=np.float32)
        least, greatest = depth_around(view.depth)
        measured = np.full(shape, np.nan)
        intrinsics = (pinhole.fx, pinhole.fy, pinhole.cx, pinhole.cy)
        shares = (self.flying, self.dropout, self.grazing)
        scales = (self.noise_at_one_metre, self.floor, self.minimum_range, self.maximum_range)
        _measure(
            view.depth,
            view.body_index,
            view.normal,
            view.reflects,
            least,
            greatest,
            normals,
            uniforms,
            intrinsics,
            shares,
            scales,
            measured,
        )
        return measured


def warm_up() -> None:
    """Compile the kernels of this module, or load them from the cache, on a view of nothing."""
    from zsight_core.pinhole import Pinhole
    from zsight_core.simulation.raycast import render
    from zsight_core.simulation.world import Camera, World

    pinhole = Pinhole(8, 8, 8.0, 8.0, 3.5, 3.5)
    TimeOfFlight().measure(render(World(()), Camera(pinhole, np.eye(4))), pinhole, np.random.default_rng(0))


@njit(cache=True, nogil=True)
def _measure(
    depth: Any,
    body_index: Any,
    normal: Any,
    reflects: Any,
    least: Any,
    greatest: Any,
    normals: Any,
    uniforms: Any,
    intrinsics: tuple[float, float, float, float],
    shares: tuple[float, float, float],
    scales: tuple[float, float, float, float],
    measured: Any,
) -> None:
    flying, dropout, grazing = shares
    noise_at_one_metre, floor, minimum_range, maximum_range = scales
    fx, fy, cx, cy = intrinsics
    height, width = depth.shape
    for v in range(height):
        y = (v - cy) / fy
        for u in range(width):
            index = body_index[v, u]
            fate = uniforms[0, v, u]
            if index < 0 or fate < dropout + (1 - reflects[index]):
                continue
            x = (u - cx) / fx
            stretch = np.sqrt(x * x + y * y + 1)
            facing = -(normal[v, u, 0] * x + normal[v, u, 1] * y + normal[v, u, 2]) / stretch
            if facing < grazing:
                continue
            z = depth[v, u]
            near, far = least[v, u], greatest[v, u]
            if far - near > JUMP * near and fate > 1 - flying:
                z = near + uniforms[1, v, u] * (far - near)
            along = z * stretch
            along += normals[v, u] * np.sqrt(floor**2 + (noise_at_one_metre * along**2 / facing) ** 2)
            if minimum_range <= along <= maximum_range:
                measured[v, u] = along / stretch
