"""A simulated depth camera: a world in, an organised coloured cloud out."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from zsight_core.jit import njit
from zsight_core.pinhole import Pinhole
from zsight_core.points import XYZRGB, Points
from zsight_core.simulation import kinect, raycast, time_of_flight
from zsight_core.simulation.raycast import DepthView, render
from zsight_core.simulation.world import Camera, World

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["Noise", "capture", "expose", "warm_up"]


class Noise(Protocol):
    """What makes a measured depth image of an ideal one: Kinect, TimeOfFlight or your own."""

    def measure(self, view: DepthView, pinhole: Pinhole, generator: np.random.Generator) -> NDArray[np.float64]:
        """Depth (H, W) float64, metres along z; NaN where nothing is reported; drawn from the generator alone."""
        ...


def capture(world: World, camera: Camera, noise: Noise | None = None, seed: int = 0) -> Points:
    """One cloud of the world.

    Args:
        world: bodies.
        camera: image size, intrinsics and place.
        noise: sensor model; None: exact to the float32 of the cloud.
        seed: decides all noise; the same arguments give the same bytes.

    Returns:
        Points (H, W), dtype XYZRGB, in the camera's optical frame; coordinates NaN where nothing was measured.
    """
    return expose(render(world, camera), camera.pinhole, noise, seed)


def expose(view: DepthView, pinhole: Pinhole, noise: Noise | None = None, seed: int = 0) -> Points:
    """One cloud of a view that was rendered before, as of a world that stands still; see ``capture``."""
    depth = view.depth if noise is None else noise.measure(view, pinhole, np.random.default_rng(seed))
    points = np.empty(depth.shape, dtype=XYZRGB)
    coordinates = points.view(np.float32).reshape(*depth.shape, 4)
    intrinsics = (pinhole.fx, pinhole.fy, pinhole.cx, pinhole.cy)
    _fill(depth, view.colour, intrinsics, coordinates, coordinates.view(np.uint32))
    return points


def warm_up() -> None:
    """Compile the kernels that a simulated camera runs, or load them from the cache."""
    raycast.warm_up()
    kinect.warm_up()
    time_of_flight.warm_up()
    capture(World(()), Camera(Pinhole(8, 8, 8.0, 8.0, 3.5, 3.5), np.eye(4)))


@njit(cache=True, nogil=True)
def _fill(depth: Any, colour: Any, intrinsics: tuple[float, float, float, float], coordinates: Any, bits: Any) -> None:
    """Write x, y, z and packed colour of each pixel; ``coordinates`` and ``bits`` share their memory."""
    fx, fy, cx, cy = intrinsics
    height, width = depth.shape
    for v in range(height):
        y = (v - cy) / fy
        for u in range(width):
            z = depth[v, u]
            coordinates[v, u, 0] = (u - cx) / fx * z
            coordinates[v, u, 1] = y * z
            coordinates[v, u, 2] = z
            red, green, blue = colour[v, u, 0], colour[v, u, 1], colour[v, u, 2]
            bits[v, u, 3] = (np.uint32(red) << np.uint32(16)) | (np.uint32(green) << np.uint32(8)) | np.uint32(blue)
