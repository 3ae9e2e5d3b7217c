"""Where the outline of a solid falls in the image, and where the measured depth image has its edge there.

Along each edge between a face that is seen and one that is not, samples look across the outline for the last pixel
that is of the solid's face and the first that is farther away (edge search along normals as in RAPID: Harris, Tracking
with rigid models, 1992).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from zsight_core.jit import njit

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["CONTINUES", "EDGE", "ENDS", "HIDDEN", "MOST", "NOTHING", "SPACING", "UNKNOWN", "scan", "warm_up"]

EDGE, CONTINUES, HIDDEN, UNKNOWN, NOTHING, ENDS = 0, 1, 2, 3, 4, 5
"""States of a sample: edge found; the surface goes on outside; something nearer; not measured; nothing there; the
surface ends near by and nothing is measured beyond, as at the edges of real things."""

SPACING = 2.0
"""Pixels between samples along an outline."""

MOST = 400
"""Samples at most."""

SLACK = 0.002
"""Metres in depth, besides two and a half standard deviations of noise, that are still the same surface."""

BLUR = 5.0
"""Pixels over which a sensor's matching window carries depth across an image."""

STEEPEST = 2.0
"""Slope of depth beyond which a face is seen so edge-on that it is not followed outside of its outline."""


@njit(cache=True, nogil=True, error_model="numpy")
def scan(  # noqa: C901  one compiled loop over pixels; splitting it would pass a dozen numbers around
    depth: NDArray[np.float32],
    pinhole: tuple[float, float, float, float],
    vertices: NDArray[np.float64],
    faces: NDArray[np.int32],
    edges: NDArray[np.int32],
    planes: NDArray[np.float64],
    w: NDArray[np.float64],
    region: tuple[int, int, int, int, int],
    ground: NDArray[np.float64],
    noise: float,
    reach: int,
    most: int,
) -> NDArray[np.float64]:
    """Samples (S, 8): state, offset and direction x y outward, length of outline (pixels), and point x y z (m).

    Args:
        depth: (H, W) metres, 0 where not measured.
        pinhole: fx, fy, cx, cy.
        vertices: (V, 3) of the solid, optical frame.
        faces: (F, 3) of the solid.
        edges: (E, 4) of the solid.
        planes: (F, 4) of its faces.
        w: drawn inverse depth.
        region: of w.
        ground: (4,) normal and offset of the surface that the solid stands on; edges on it have no contrast.
        noise: standard deviation of 1 / z, 1/m.
        reach: pixels to look to each side.
        most: samples at most, up to MOST.
    """
    fx, fy, cx, cy = pinhole
    height, width = depth.shape
    samples = np.empty((MOST, 8))
    count = 0
    scale = 1.0 / region[4]
    seen = np.empty(len(planes) + 1, np.bool_)
    for f in range(len(planes)):
        seen[f] = planes[f, 3] < -1e-9
    seen[-1] = False  # beyond an open border
    outline, ends = np.empty(len(edges), np.int32), np.empty((len(edges), 5))
    bends = 0
    length_all = 0.0
    for e in range(len(edges)):
        if seen[edges[e, 2]] != seen[edges[e, 3]]:
            a, b = edges[e, 0], edges[e, 1]
            ua, va = fx * vertices[a, 0] / vertices[a, 2], fy * vertices[a, 1] / vertices[a, 2]
            ub, vb = fx * vertices[b, 0] / vertices[b, 2], fy * vertices[b, 1] / vertices[b, 2]
            length = np.sqrt((ub - ua) * (ub - ua) + (vb - va) * (vb - va))
            ends[bends, 0], ends[bends, 1], ends[bends, 2], ends[bends, 3] = ua + cx, va + cy, ub + cx, vb + cy
            ends[bends, 4] = length
            outline[bends] = e
            bends += 1
            length_all += length
    spacing = max(SPACING, length_all * 8 / (7 * most))
    carry = spacing / 2
    for i in range(bends):
        e = outline[i]
        a, b = edges[e, 0], edges[e, 1]
        on_ground = 0
        for k in (a, b):
            h = ground[0] * vertices[k, 0] + ground[1] * vertices[k, 1] + ground[2] * vertices[k, 2] - ground[3]
            if h < 0.006:
                on_ground += 1
        if on_ground == 2:
            continue
        ua, va, ub, vb, length = ends[i, 0], ends[i, 1], ends[i, 2], ends[i, 3], ends[i, 4]
        if length < 1e-6:
            continue
        if carry >= length:
            carry -= length
            continue
        f = edges[e, 2] if seen[edges[e, 2]] else edges[e, 3]
        d = planes[f, 3]
        A, B, C = planes[f, 0] / d, planes[f, 1] / d, planes[f, 2] / d
        mx, my = (vb - va) / length, -(ub - ua) / length
        third = faces[f, 0] + faces[f, 1] + faces[f, 2] - a - b
        ut, vt = fx * vertices[third, 0] / vertices[third, 2] + cx, fy * vertices[third, 1] / vertices[third, 2] + cy
        if (ut - ua) * mx + (vt - va) * my > 0:
            mx, my = -mx, -my
        per_u, per_v = A / fx, B / fy
        zero = C - per_u * cx - per_v * cy
        ground_u, ground_v = ground[0] / fx, ground[1] / fy
        at = carry
        while at < length and count < MOST:
            t = at / length
            at += spacing
            us, vs = ua + (ub - ua) * t, va + (vb - va) * t
            we = per_u * us + per_v * vs + zero
            if we <= 0 or _drawn(w, region, scale, us + 2.0 * mx, vs + 2.0 * my) > 0:
                continue  # the solid itself is behind this edge
            inside = _drawn(w, region, scale, us - 1.5 * mx, vs - 1.5 * my)
            if inside > we * 1.03:
                continue  # the solid hides this edge
            tolerance = 2.5 * noise + SLACK * we * we
            # what would be seen outside if nothing stood there: no edge can be seen against a near background
            facing = ground_u * (us + reach * mx - cx) + ground_v * (vs + reach * my - cy) + ground[2]
            slope = per_u * mx + per_v * my  # of 1 / z along the outward direction, a pixel
            slope = min(max(slope, -STEEPEST * we / fx), STEEPEST * we / fx)
            if ground[3] != 0 and facing / ground[3] > we + reach * slope - 1.5 * tolerance:
                continue
            # on a curved side the sensor blurs: pixels at the outline read what is some pixels inside
            blurred = max(we, _drawn(w, region, scale, us - BLUR * mx, vs - BLUR * my))
            last_on, first_off, seen_near, seen_far, unknown, gap = -99.0, 99.0, 0, 0, 0, 0
            for k in range(-reach, reach + 1):
                u, v = int(np.floor(us + k * mx + 0.5)), int(np.floor(vs + k * my + 0.5))
                if not (0 <= u < width and 0 <= v < height) or depth[v, u] <= 0:
                    unknown += 1
                    gap += 1
                    continue
                place = (u - us) * mx + (v - vs) * my
                expected = _drawn(w, region, scale, u, v) if place < 0 else 0.0
                if expected == 0.0:
                    expected = we + place * slope
                off = 1.0 / depth[v, u] - expected
                if -tolerance <= off <= tolerance + max(0.0, blurred - expected):
                    if first_off == 99.0 or place < first_off:
                        last_on = max(last_on, place)
                    gap = 0
                elif off > 0:
                    seen_near += 1
                    if last_on > -99.0 and first_off == 99.0:
                        break
                else:
                    seen_far += 1
                    if last_on > -99.0:
                        first_off = min(first_off, place)
                        break
            state, offset = 3, 0.0
            if last_on == -99.0:
                state = 4 if seen_far > seen_near and seen_far > unknown else (2 if seen_near > 0 else 3)
            elif first_off < 99.0 and first_off - last_on < 4.5:
                state, offset = 0, (last_on + first_off) / 2
            elif seen_near > 0 and first_off == 99.0:
                state = 2
            elif last_on > reach - 1.6:
                state = 1
            elif gap >= 3 and abs(last_on) < 3.5:
                state = 5
            z = 1.0 / we
            samples[count, 0], samples[count, 1] = state, offset
            samples[count, 2], samples[count, 3], samples[count, 4] = mx, my, spacing
            samples[count, 5], samples[count, 6], samples[count, 7] = (us - cx) / fx * z, (vs - cy) / fy * z, z
            count += 1
        carry = at - length if at >= length else spacing / 2
    return samples[:count]


def warm_up() -> None:
    """Compile the kernels (or load them from their cache)."""
    vertices = np.array([[0.0, 0.0, 1.0], [0.1, 0.0, 1.0], [0.0, 0.1, 1.0]])
    faces = np.array([[0, 2, 1]], np.int32)
    edges = np.array([[0, 1, 0, -1]], np.int32)
    planes = np.array([[0.0, 0.0, -1.0, -1.0]])
    region = (50, 50, 10, 10, 1)
    depth = np.ones((100, 100), np.float32)
    scan(
        depth,
        (100.0, 100.0, 50.0, 50.0),
        vertices,
        faces,
        edges,
        planes,
        np.zeros((10, 10)),
        region,
        np.zeros(4),
        1e-3,
        4,
        MOST,
    )


@njit(cache=True, nogil=True, error_model="numpy")
def _drawn(w: NDArray[np.float64], region: tuple[int, int, int, int, int], scale: float, u: float, v: float) -> float:
    """Inverse depth drawn nearest to an image place, 0 outside; scale is one over the region's step."""
    k, r = int(np.floor((u - region[0]) * scale + 0.5)), int(np.floor((v - region[1]) * scale + 0.5))
    if 0 <= k < region[2] and 0 <= r < region[3]:
        return float(w[r, k])
    return 0.0
