"""Does the depth image look as if the solid were there? Render, compare pixel by pixel, and count."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numba import njit

from zsight_core.contour import scan
from zsight_core.render import draw, face_planes, place, region_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["Evidence", "compare", "warm_up"]


class Evidence(NamedTuple):
    """Pixels and outline samples by what they say; plain floats so that compiled code can make one."""

    pixels: float
    """Image pixels that the solid would cover, those beyond the image's border included."""
    match: float
    """Measured where the solid's surface is."""
    through: float
    """Measured farther: the camera looks through the solid, which is against it."""
    hidden: float
    """Measured nearer: something else is in front."""
    unknown: float
    """Not measured, inside the image."""
    beyond: float
    """Beyond the image's border."""
    edge: float
    """Outline samples with a measured edge near by."""
    goes_on: float
    """Outline samples where the measured surface goes on outside, which is against this size."""
    nothing: float
    """Outline samples with no such surface."""
    edge_hidden: float
    """Outline samples that something nearer hides or that were not measured."""
    rms: float
    """Root mean square of 1 / z residuals over match, in units of the noise."""

    @property
    def visible(self) -> float:
        """Share of the solid's own image that is seen."""
        return self.match / max(self.pixels, 1.0)

    @property
    def agreement(self) -> float:
        """Share of pixels that say yes among those that say yes or no."""
        return self.match / max(self.match + self.through, 1.0)

    @property
    def outline(self) -> float:
        """Share of outline samples that say yes among those that say yes or no."""
        return self.edge / max(self.edge + self.goes_on + self.nothing, 1.0)

    @property
    def outlined(self) -> float:
        """Share of the outline that was seen at all."""
        told = self.edge + self.goes_on + self.nothing
        return told / max(told + self.edge_hidden, 1.0)


def compare(
    depth: NDArray[np.float32],
    pinhole: tuple[float, float, float, float],
    vertices: NDArray[np.float64],
    faces: NDArray[np.int32],
    edges: NDArray[np.int32],
    T_optical_support: NDArray[np.float64],
    T_support_model: NDArray[np.float64],
    base: float,
    noise: float,
    *,
    most: int = 4000,
    tolerance: float = 0.004,
) -> Evidence:
    """Evidence for a solid at a pose.

    Args:
        depth: (H, W) metres, 0 where not measured.
        pinhole: fx, fy, cx, cy.
        vertices: (V, 3) of the solid, model frame, metres.
        faces: (F, 3).
        edges: (E, 4).
        T_optical_support: (4, 4).
        T_support_model: (4, 4).
        base: height of the solid's foot over the surface, metres.
        noise: standard deviation of 1 / z, 1/m.
        most: pixels of the raster.
        tolerance: metres in depth, besides 3.5 standard deviations of noise, that count as a match.
    """
    T = T_optical_support @ T_support_model
    counts = _count(depth, pinhole, vertices, faces, edges, T, T_optical_support, base, noise, most, tolerance)
    return Evidence(*(float(c) for c in counts))


@njit(cache=True, nogil=True)
def _count(  # noqa: C901  one compiled loop over pixels; splitting it would pass a dozen numbers around
    depth: NDArray[np.float32],
    pinhole: tuple[float, float, float, float],
    vertices: NDArray[np.float64],
    faces: NDArray[np.int32],
    edges: NDArray[np.int32],
    T_optical_model: NDArray[np.float64],
    T_optical_support: NDArray[np.float64],
    base: float,
    noise: float,
    most: int,
    tolerance: float,
) -> NDArray[np.float64]:
    """The numbers of Evidence (11,)."""
    counts = np.zeros(11)
    height, width = depth.shape
    placed = place(T_optical_model, vertices)
    region = region_of(placed, pinhole, most)
    if region[2] == 0:
        return counts
    planes = face_planes(placed, faces)
    w, face = draw(placed, faces, planes, pinhole, region)
    u0, v0, columns, rows, step = region
    squares = 0.0
    for r in range(rows):
        v = v0 + r * step
        for k in range(columns):
            if face[r, k] < 0:
                continue
            u = u0 + k * step
            counts[0] += 1
            if not (0 <= u < width and 0 <= v < height):
                counts[5] += 1
                continue
            if depth[v, u] <= 0:
                counts[4] += 1
                continue
            residual = 1.0 / depth[v, u] - w[r, k]
            gate = 3.5 * noise + tolerance * w[r, k] * w[r, k]
            if abs(residual) <= gate:
                counts[1] += 1
                squares += residual * residual
            elif residual < 0:
                counts[2] += 1
            else:
                counts[3] += 1
    ground = np.empty(4)
    ground[:3] = T_optical_support[:3, 2]
    ground[3] = (T_optical_support[:3, 2] * T_optical_support[:3, 3]).sum() + base
    samples = scan(depth, pinhole, placed, faces, edges, planes, w, region, ground, noise, 4)
    for s in range(len(samples)):
        state = int(samples[s, 0])
        if state == 0:
            counts[6] += 1
        elif state == 1:
            counts[7] += 1
        elif state == 4:
            counts[8] += 1
        else:
            counts[9] += 1
    counts[10] = np.sqrt(squares / max(counts[1], 1.0)) / noise
    for k in range(6):
        counts[k] *= step * step
    return counts


def warm_up() -> None:
    """Compile the kernels (or load them from their cache)."""
    vertices = np.array([[0.0, 0.0, 1.0], [0.1, 0.0, 1.0], [0.0, 0.1, 1.0]])
    faces = np.array([[0, 2, 1]], np.int32)
    edges = np.array([[0, 1, 0, -1]], np.int32)
    depth = np.ones((100, 100), np.float32)
    compare(depth, (100.0, 100.0, 50.0, 50.0), vertices, faces, edges, np.eye(4), np.eye(4), 0.0, 1e-3)
