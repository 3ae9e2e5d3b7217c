"""Fit a pose to the depth image by Gauss-Newton: what is seen of the surface, and where the outline falls.

A solid on a surface has four degrees of freedom: x, y and height over the surface, and yaw; the surface holds the other
two. Residuals are inverse depths of pixels inside (the camera's noise is the same everywhere in 1 / z) and distances
from drawn to measured outline in the image. A fifth unknown, how far the measured outline lies outside of the true one
all around, takes up the sensor's bias at edges, which so cancels between opposite sides.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from zsight_core.jit import njit
from zsight_core.render import draw, face_planes, moved_planes, place, product, region_of
from zsight_core.search.contour import MOST, SPACING, scan

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["EDGE_NOISE", "fit", "warm_up"]

EDGE_NOISE = 0.7
"""Pixels; standard deviation of one outline sample."""

EDGE_BIAS = 0.7
"""Pixels; how far off all outline samples together may be."""


@njit(cache=True, nogil=True, error_model="numpy")
def fit(
    depth: NDArray[np.float32],
    pinhole: tuple[float, float, float, float],
    vertices: NDArray[np.float64],
    faces: NDArray[np.int32],
    edges: NDArray[np.int32],
    T_optical_supports: NDArray[np.float64],
    supports: NDArray[np.int64],
    T_support_models: NDArray[np.float64],
    bases: NDArray[np.float64],
    loose: NDArray[np.float64],
    noise: float,
    steps: int,
    most: int,
    outline: int,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Improve some poses on surfaces, each by itself.

    Args:
        depth: (H, W) metres, 0 where not measured.
        pinhole: fx, fy, cx, cy.
        vertices: (V, 3) of the solid, model frame, metres.
        faces: (F, 3).
        edges: (E, 4).
        T_optical_supports: (S, 4, 4).
        supports: (N,) the surface of each pose.
        T_support_models: (N, 4, 4) first guesses, within about 10 mm and 10 degrees.
        bases: (N,) height of the solid's foot over the surface, metres.
        loose: (N, 4) standard deviations within which x, y, height (m) and yaw (rad) may leave the guess; the surface
            itself is a measurement of height, a symmetric shape has no yaw.
        noise: standard deviation of 1 / z, 1/m.
        steps: most iterations.
        most: pixels of the raster.
        outline: samples of the outline, about.

    Returns:
        T_support_models (N, 4, 4), and the information matrices (N, 4, 4) of x, y, height, yaw (edge bias
        marginalised).
    """
    fitted, information = np.empty((len(bases), 4, 4)), np.empty((len(bases), 4, 4))
    planes = face_planes(vertices, faces)
    for i in range(len(bases)):
        frame, guess = T_optical_supports[supports[i]], T_support_models[i]
        fitted[i], information[i] = _fit(
            depth,
            pinhole,
            vertices,
            faces,
            edges,
            planes,
            frame,
            guess,
            bases[i],
            loose[i],
            noise,
            steps,
            most,
            outline,
        )
    return fitted, information


@njit(cache=True, nogil=True, error_model="numpy")
def _fit(  # noqa: C901  one compiled loop over pixels; splitting it would pass a dozen numbers around
    depth: NDArray[np.float32],
    pinhole: tuple[float, float, float, float],
    vertices: NDArray[np.float64],
    faces: NDArray[np.int32],
    edges: NDArray[np.int32],
    model_planes: NDArray[np.float64],
    T_optical_support: NDArray[np.float64],
    T_support_model: NDArray[np.float64],
    base: float,
    loose: NDArray[np.float64],
    noise: float,
    steps: int,
    most: int,
    outline: int,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """One pose improved, and its information matrix."""
    fx, fy, cx, cy = pinhole
    T = T_support_model.copy()
    x_axis, y_axis, z_axis = (
        T_optical_support[:3, 0].copy(),
        T_optical_support[:3, 1].copy(),
        T_optical_support[:3, 2].copy(),
    )
    ground = np.empty(4)
    ground[:3] = z_axis
    ground[3] = (z_axis * T_optical_support[:3, 3]).sum() + base
    moved = np.zeros(4)  # from the guess
    information = np.zeros((5, 5))
    height, width = depth.shape
    for iteration in range(steps):
        T_optical_model = product(T_optical_support, T)
        placed = place(T_optical_model, vertices)
        region = region_of(placed, pinhole, most)
        if region[2] == 0:
            break
        planes = moved_planes(T_optical_model, model_planes)
        w, face = draw(placed, faces, planes, pinhole, region)
        u0, v0, columns, rows, step = region
        H = np.zeros((5, 5))
        g = np.zeros(5)
        # looser at first, so that a guess some millimetres off still catches the surface
        sigma = max(noise, 4e-3 * 0.45**iteration)
        weight = step * step / (sigma * sigma)
        limit = 4.0 * sigma + 1e-5
        px, py, pz = T_optical_model[0, 3], T_optical_model[1, 3], T_optical_model[2, 3]
        j = np.zeros(5)
        for r in range(rows):
            v = v0 + r * step
            if v < 0 or v >= height:
                continue
            for k in range(columns):
                u = u0 + k * step
                if face[r, k] < 0 or u < 0 or u >= width or depth[v, u] <= 0:
                    continue
                residual = 1.0 / depth[v, u] - w[r, k]
                if abs(residual) > limit:
                    continue
                rx, ry = (u - cx) / fx, (v - cy) / fy
                n0, n1, n2 = planes[face[r, k], 0], planes[face[r, k], 1], planes[face[r, k], 2]
                facing = n0 * rx + n1 * ry + n2
                if facing > -0.1:
                    continue
                z = 1.0 / w[r, k]
                scale = -1.0 / (facing * z * z)  # change of 1 / z for a step along the normal
                j[0] = scale * (n0 * x_axis[0] + n1 * x_axis[1] + n2 * x_axis[2])
                j[1] = scale * (n0 * y_axis[0] + n1 * y_axis[1] + n2 * y_axis[2])
                j[2] = scale * (n0 * z_axis[0] + n1 * z_axis[1] + n2 * z_axis[2])
                dx, dy, dz = rx * z - px, ry * z - py, z - pz
                t0 = z_axis[1] * dz - z_axis[2] * dy
                t1 = z_axis[2] * dx - z_axis[0] * dz
                t2 = z_axis[0] * dy - z_axis[1] * dx
                j[3] = scale * (n0 * t0 + n1 * t1 + n2 * t2)
                share = residual / limit
                trust = weight * (1.0 - share * share) ** 2  # Tukey's biweight
                for a in range(4):
                    g[a] += trust * j[a] * residual
                    for b in range(a, 4):
                        H[a, b] += trust * j[a] * j[b]
        reach = 8 if iteration < 2 else 5
        samples = scan(depth, pinhole, placed, faces, edges, planes, w, region, ground, noise, reach, outline)
        spread = (3.0, 1.8, 1.2)[iteration] if iteration < 3 else EDGE_NOISE
        for s in range(len(samples)):
            if samples[s, 0] != 0:
                continue
            share = samples[s, 1] / (4.0 * spread)
            if abs(share) >= 1:
                continue
            trust = samples[s, 4] / SPACING * (1.0 - share * share) ** 2 / (spread * spread)
            mx, my, x, y, z = samples[s, 2], samples[s, 3], samples[s, 5], samples[s, 6], samples[s, 7]
            for a in range(4):
                if a < 3:
                    d0, d1, d2 = T_optical_support[0, a], T_optical_support[1, a], T_optical_support[2, a]
                else:
                    dx, dy, dz = x - px, y - py, z - pz
                    d0 = z_axis[1] * dz - z_axis[2] * dy
                    d1 = z_axis[2] * dx - z_axis[0] * dz
                    d2 = z_axis[0] * dy - z_axis[1] * dx
                j[a] = mx * fx * (d0 - x / z * d2) / z + my * fy * (d1 - y / z * d2) / z
            j[4] = 1.0
            for a in range(5):
                g[a] += trust * j[a] * samples[s, 1]
                for b in range(a, 5):
                    H[a, b] += trust * j[a] * j[b]
        for a in range(5):
            for b in range(a):
                H[a, b] = H[b, a]
        for a in range(4):
            H[a, a] += 1.0 / (loose[a] * loose[a])
            g[a] -= moved[a] / (loose[a] * loose[a])
        H[4, 4] += 1.0 / (EDGE_BIAS * EDGE_BIAS)
        information = H
        change = _solve(H, g)
        size = max(abs(change[0]), abs(change[1]), abs(change[2]))
        shrink = min(1.0, 0.012 / max(size, 1e-9), 0.25 / max(abs(change[3]), 1e-9))
        for a in range(4):
            change[a] *= shrink
            moved[a] += change[a]
        _move(T, change)
        enough = max(2e-6, 0.02 * noise)
        if sigma == noise and iteration >= 3 and size < enough and abs(change[3]) < 10 * enough:
            break
    marginal = np.empty((4, 4))
    for a in range(4):
        for b in range(4):
            marginal[a, b] = information[a, b] - information[a, 4] * information[4, b] / max(information[4, 4], 1e-12)
    return T, marginal


@njit(cache=True, nogil=True, error_model="numpy")
def _solve(H: NDArray[np.float64], g: NDArray[np.float64]) -> NDArray[np.float64]:
    """Solve H x = g for a small positive definite H, by its Cholesky factor: a library takes longer to be called."""
    n = len(g)
    L, x = H.copy(), g.copy()
    for a in range(n):
        for b in range(a + 1):
            for k in range(b):
                L[a, b] -= L[a, k] * L[b, k]
            L[a, b] = np.sqrt(L[a, a]) if a == b else L[a, b] / L[b, b]
        for k in range(a):
            x[a] -= L[a, k] * x[k]
        x[a] /= L[a, a]
    for a in range(n - 1, -1, -1):
        for k in range(a + 1, n):
            x[a] -= L[k, a] * x[k]
        x[a] /= L[a, a]
    return x


@njit(cache=True, nogil=True, error_model="numpy")
def _move(T: NDArray[np.float64], change: NDArray[np.float64]) -> None:
    """Shift and turn a pose on the surface about its own centre, in place."""
    c, s = np.cos(change[3]), np.sin(change[3])
    for k in range(3):
        a, b = T[0, k], T[1, k]
        T[0, k] = c * a - s * b
        T[1, k] = s * a + c * b
        T[k, 3] += change[k]


def warm_up() -> None:
    """Compile the kernels (or load them from their cache)."""
    vertices = np.array([[0.0, 0.0, 1.0], [0.1, 0.0, 1.0], [0.0, 0.1, 1.0]])
    faces = np.array([[0, 2, 1]], np.int32)
    edges = np.array([[0, 1, 0, -1]], np.int32)
    depth = np.ones((100, 100), np.float32)
    pinhole = (100.0, 100.0, 50.0, 50.0)
    frames, one = np.eye(4)[np.newaxis], np.zeros(1)
    solid = vertices, faces, edges
    fit(depth, pinhole, *solid, frames, one.astype(np.int64), frames, one, np.ones((1, 4)), 1e-3, 2, 500, MOST)
