"""Does the depth image look as if the solid were there? Render, compare pixel by pixel, and count."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from zsight_core.jit import njit
from zsight_core.render import draw, face_planes, moved_planes, place, product, region_of
from zsight_core.search.contour import MOST, scan

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["Evidence", "compare", "look", "warm_up"]

IN_FRONT = 0.015
"""Metres by which something must be nearer to count as another thing in front."""


FEWEST = 12
"""Pixels below which nothing is promised."""

OUTLINE = 0.7
"""Weight of the outline in a promise."""

UNTOLD = 0.5
"""Share of a pose's pixels that are hidden or not measured by which its promise is not held against it."""

OFF, MATCH, THROUGH, PROUD, HIDDEN, UNKNOWN, BEYOND = 0, 1, 2, 3, 4, 5, 6
"""States of a pixel: not of the solid, and as in Evidence, numbered as there."""


class Evidence(NamedTuple):
    """Pixels and outline samples by what they say; plain floats so that compiled code can make one."""

    pixels: float
    """Image pixels that the solid would cover, those beyond the image's border included."""
    match: float
    """Measured where the solid's surface is; like the next two counted off the outline and scaled to all pixels."""
    through: float
    """Measured farther: the camera looks through the solid, which is against it."""
    proud: float
    """Measured a little nearer than the surface, too little for a thing in front."""
    hidden: float
    """Measured nearer: something else is in front."""
    unknown: float
    """Not measured, inside the image."""
    beyond: float
    """Beyond the image's border."""
    edge: float
    """Outline samples with a measured edge near by, or where the surface ends and nothing is measured beyond."""
    goes_on: float
    """Outline samples where the measured surface goes on outside, which is against this size."""
    nothing: float
    """Outline samples with no such surface."""
    edge_hidden: float
    """Outline samples that something nearer hides or that were not measured."""
    sunk: float
    """Metres; how far the measured surface is behind the solid's, averaged over patches, noise taken off."""
    raised: float
    """Metres; how far it is before the solid's, likewise; something that touches the solid in front does that too."""
    offset: float
    """Pixels; root mean square distance between drawn and measured outline."""
    worst_side: float
    """Largest share, over the eight ways an outline may face, of samples that say no: one side of it is not there."""
    shift: float
    """Metres; how far the middle one of the patches is before or behind: the surface is elsewhere as a whole."""
    bias: float
    """Pixels; how far the measured outline is outside of the drawn one on average: what stands there is larger."""

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


@njit(cache=True, nogil=True, error_model="numpy")
def compare(
    depth: NDArray[np.float32],
    pinhole: tuple[float, float, float, float],
    vertices: NDArray[np.float64],
    faces: NDArray[np.int32],
    edges: NDArray[np.int32],
    T_optical_supports: NDArray[np.float64],
    supports: NDArray[np.int64],
    T_support_models: NDArray[np.float64],
    bases: NDArray[np.float64],
    noise: float,
    most: int,
    tolerance: float,
) -> NDArray[np.float64]:
    """Evidence for a solid at some poses.

    Args:
        depth: (H, W) metres, 0 where not measured.
        pinhole: fx, fy, cx, cy.
        vertices: (V, 3) of the solid, model frame, metres.
        faces: (F, 3).
        edges: (E, 4).
        T_optical_supports: (S, 4, 4).
        supports: (N,) the surface of each pose.
        T_support_models: (N, 4, 4).
        bases: (N,) height of the solid's foot over the surface, metres.
        noise: standard deviation of 1 / z, 1/m.
        most: pixels of the raster.
        tolerance: metres in depth, besides three standard deviations of noise, that count as a match.

    Returns:
        (N, 17) the numbers of Evidence.
    """
    counts, planes = np.empty((len(bases), 17)), face_planes(vertices, faces)
    for i in range(len(bases)):
        T_optical_support = T_optical_supports[supports[i]]
        T = product(T_optical_support, T_support_models[i])
        seen = _pixels(depth, pinhole, vertices, faces, planes, T, noise, most, tolerance, counts[i])
        ground = _ground(T_optical_support, bases[i])
        _outline(depth, pinhole, faces, edges, seen, ground, noise, MOST, counts[i])
    return counts


@njit(cache=True, nogil=True, error_model="numpy")
def look(
    depth: NDArray[np.float32],
    pinhole: tuple[float, float, float, float],
    vertices: NDArray[np.float64],
    faces: NDArray[np.int32],
    edges: NDArray[np.int32],
    T_optical_supports: NDArray[np.float64],
    supports: NDArray[np.int64],
    T_support_models: NDArray[np.float64],
    bases: NDArray[np.float64],
    noise: float,
    most: int,
    outline: int,
    tolerance: float,
    least: float,
) -> NDArray[np.float64]:
    """How much some poses promise: matches less contradictions, and an outline that is there.

    Arguments are those of ``compare``, samples of the outline, about, and what a pose must promise at least.

    Returns:
        (N, 2) promise and matching pixels of each pose; -inf where it promises less than the least.
    """
    promises = np.full((len(bases), 2), -np.inf)
    counts, planes = np.empty(17), face_planes(vertices, faces)
    for i in range(len(bases)):
        T_optical_support = T_optical_supports[supports[i]]
        T = product(T_optical_support, T_support_models[i])
        seen = _pixels(depth, pinhole, vertices, faces, planes, T, noise, most, tolerance, counts)
        match, through = counts[1], counts[2]
        told = counts[0] - UNTOLD * (counts[4] + counts[5] + counts[6])
        promise = (match - 2 * through) / max(told, 1.0)
        if match < FEWEST or match <= through or promise + OUTLINE <= least:
            continue
        ground = _ground(T_optical_support, bases[i])
        _outline(depth, pinhole, faces, edges, seen, ground, noise, outline, counts)
        promise += OUTLINE * counts[7] / max(counts[7] + counts[8] + counts[9], 1.0)
        if promise > least:
            promises[i, 0], promises[i, 1] = promise, match
    return promises


@njit(cache=True, nogil=True, error_model="numpy")
def _ground(T_optical_support: NDArray[np.float64], base: float) -> NDArray[np.float64]:
    """Normal and offset (4,) of the surface that a solid stands on."""
    ground = np.empty(4)
    ground[:3] = T_optical_support[:3, 2]
    ground[3] = (T_optical_support[:3, 2] * T_optical_support[:3, 3]).sum() + base
    return ground


@njit(cache=True, nogil=True, error_model="numpy")
def _pixels(  # noqa: C901  one compiled loop over pixels; splitting it would pass a dozen numbers around
    depth: NDArray[np.float32],
    pinhole: tuple[float, float, float, float],
    vertices: NDArray[np.float64],
    faces: NDArray[np.int32],
    model_planes: NDArray[np.float64],
    T_optical_model: NDArray[np.float64],
    noise: float,
    most: int,
    tolerance: float,
    counts: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], tuple[int, int, int, int, int]]:
    """Write what pixels say into the numbers of Evidence (17,).

    Returns:
        Vertices and planes in the optical frame, the drawn inverse depth and its region.
    """
    counts[:] = 0.0
    placed = place(T_optical_model, vertices)
    region = region_of(placed, pinhole, most)
    planes = moved_planes(T_optical_model, model_planes)
    if region[2] == 0:
        return placed, planes, np.zeros((0, 0)), region
    w, face = draw(placed, faces, planes, pinhole, region)
    u0, v0, columns, rows, step = region
    states, hides = _states(depth, w, face, region, noise, tolerance)
    if hides:
        _spread_what_hides(states)
    block = max(3, (max(rows, columns) + 7) // 8)
    blocks = np.zeros((rows // block + 1, columns // block + 1, 3))
    inner = 0
    for r in range(rows):
        v = v0 + r * step
        for k in range(columns):
            if states[r, k] == OFF:
                continue
            u = u0 + k * step
            counts[0] += 1
            if states[r, k] in (BEYOND, UNKNOWN, HIDDEN):
                counts[states[r, k]] += 1
            if states[r, k] in (BEYOND, UNKNOWN):
                continue
            inside = 0 < r < rows - 1 and 0 < k < columns - 1
            if inside:
                inside = face[r - 1, k] >= 0 and face[r + 1, k] >= 0 and face[r, k - 1] >= 0 and face[r, k + 1] >= 0
            if not inside:
                continue
            inner += 1
            if states[r, k] == HIDDEN:
                continue
            counts[states[r, k]] += 1
            z = 1.0 / w[r, k]
            residual = 1.0 / depth[v, u] - w[r, k]
            if abs(residual) < 3.0 * noise + IN_FRONT * w[r, k] * w[r, k]:
                j, i = r // block, k // block
                blocks[j, i, 0] += 1
                blocks[j, i, 1] += residual * z * z
                blocks[j, i, 2] += residual * residual * z * z * z * z
    scale = counts[0] / max(inner, 1)
    seen = (counts[0] - counts[4] - counts[5] - counts[6]) / max(counts[0], 1.0)
    if inner > 0:
        for k in range(1, 4):
            counts[k] *= scale
        total = counts[1] + counts[2] + counts[3]
        if total > seen * counts[0] > 0:  # pixels near the outline are more often hidden
            for k in range(1, 4):
                counts[k] *= seen * counts[0] / total
    behind, before, number = 0.0, 0.0, 0.0
    for r in range(blocks.shape[0]):
        for k in range(blocks.shape[1]):
            n = blocks[r, k, 0]
            if n >= 4:
                mean = blocks[r, k, 1] / n
                variance = max(0.0, blocks[r, k, 2] / n - mean * mean) * n / (n - 1)
                square = max(0.0, n * (mean * mean - variance / n))
                if mean < 0:
                    behind += square
                else:
                    before += square
                number += n
    counts[15] = _middle(blocks.reshape(-1, 3)) if number > 0 else IN_FRONT
    counts[11] = np.sqrt(behind / number) if number > 0 else IN_FRONT
    counts[12] = np.sqrt(before / number) if number > 0 else IN_FRONT
    for k in range(7):
        counts[k] *= step * step
    return placed, planes, w, region


@njit(cache=True, nogil=True, error_model="numpy")
def _outline(
    depth: NDArray[np.float32],
    pinhole: tuple[float, float, float, float],
    faces: NDArray[np.int32],
    edges: NDArray[np.int32],
    seen: tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], tuple[int, int, int, int, int]],
    ground: NDArray[np.float64],
    noise: float,
    most: int,
    counts: NDArray[np.float64],
) -> None:
    """Write what the outline says into the numbers of Evidence (17,)."""
    placed, planes, w, region = seen
    if region[2] == 0:
        return
    samples = scan(depth, pinhole, placed, faces, edges, planes, w, region, ground, noise, 4, most)
    off, out, measured = 0.0, 0.0, 0
    sides = np.zeros((8, 2))
    for s in range(len(samples)):
        state = int(samples[s, 0])
        side = int(np.floor(np.arctan2(samples[s, 3], samples[s, 2]) * 4 / np.pi + 4.5)) % 8
        sides[side, 0] += 1 if state in (0, 1, 4, 5) else 0
        sides[side, 1] += 1 if state in (1, 4) else 0
        if state in (0, 5):
            counts[7] += 1
        if state == 0:
            measured += 1
            off += samples[s, 1] ** 2
            out += samples[s, 1]
        elif state == 1:
            counts[8] += 1
        elif state == 4:
            counts[9] += 1
        elif state != 5:
            counts[10] += 1
    counts[13] = np.sqrt(off / max(measured, 1))
    for k in range(8):
        if sides[k, 0] >= 4:
            counts[14] = max(counts[14], (sides[k, 1] + 0.5) / (sides[k, 0] + 1))
    counts[16] = out / max(measured, 1)


@njit(cache=True, nogil=True, error_model="numpy")
def _states(
    depth: NDArray[np.float32],
    w: NDArray[np.float64],
    face: NDArray[np.int32],
    region: tuple[int, int, int, int, int],
    noise: float,
    tolerance: float,
) -> tuple[NDArray[np.int8], bool]:
    """State of each pixel of the raster (rows, columns), and whether there is any that hides others."""
    u0, v0, columns, rows, step = region
    height, width = depth.shape
    state, hides = np.zeros((rows, columns), np.int8), False
    for r in range(rows):
        v = v0 + r * step
        for k in range(columns):
            if face[r, k] < 0:
                continue
            u = u0 + k * step
            if not (0 <= u < width and 0 <= v < height):
                state[r, k] = BEYOND
                continue
            if depth[v, u] <= 0:
                state[r, k] = UNKNOWN
                continue
            residual = 1.0 / depth[v, u] - w[r, k]
            gate = 3.0 * noise + tolerance * w[r, k] * w[r, k]
            if abs(residual) <= gate:
                state[r, k] = MATCH
            elif residual < 0:
                state[r, k] = THROUGH
            elif residual > gate + IN_FRONT * w[r, k] * w[r, k]:
                state[r, k], hides = HIDDEN, True
            else:
                state[r, k] = PROUD
    return state, hides


@njit(cache=True, nogil=True, error_model="numpy")
def _spread_what_hides(state: NDArray[np.int8]) -> None:
    """What is a little nearer and hangs together with what is much nearer is of the same thing in front; in place."""
    rows, columns = state.shape
    for sweep in range(4):
        for i in range(rows):
            r = i if sweep % 2 == 0 else rows - 1 - i
            for j in range(columns):
                k = j if sweep % 2 == 0 else columns - 1 - j
                if state[r, k] != PROUD:
                    continue
                for way in range(4):
                    a, b = r + (1, -1, 0, 0)[way], k + (0, 0, 1, -1)[way]
                    if 0 <= a < rows and 0 <= b < columns and state[a, b] == HIDDEN:
                        state[r, k] = HIDDEN
                        break


@njit(cache=True, nogil=True, error_model="numpy")
def _middle(blocks: NDArray[np.float64]) -> float:
    """Absolute median of the blocks' mean residuals, weighted by pixels; blocks (N, 3): pixels, sum, squares."""
    means, weights, total = np.empty(len(blocks)), np.empty(len(blocks)), 0.0
    count = 0
    for k in range(len(blocks)):
        if blocks[k, 0] >= 4:
            means[count], weights[count] = blocks[k, 1] / blocks[k, 0], blocks[k, 0]
            total += blocks[k, 0]
            count += 1
    order = np.argsort(means[:count])
    left = total / 2
    for k in order:
        left -= weights[k]
        if left <= 0:
            return float(abs(means[k]))
    return 0.0


def warm_up() -> None:
    """Compile the kernels (or load them from their cache)."""
    vertices = np.array([[0.0, 0.0, 1.0], [0.1, 0.0, 1.0], [0.0, 0.1, 1.0]])
    solid = vertices, np.array([[0, 2, 1]], np.int32), np.array([[0, 1, 0, -1]], np.int32)
    depth, poses, one = np.ones((100, 100), np.float32), np.eye(4)[np.newaxis], np.zeros(1)
    pinhole = (100.0, 100.0, 50.0, 50.0)
    compare(depth, pinhole, *solid, poses, one.astype(np.int64), poses, one, 1e-3, 10, 0.01)
    look(depth, pinhole, *solid, poses, one.astype(np.int64), poses, one, 1e-3, 10, 10, 0.01, 0.0)
