"""Darkening where depth falls away, which makes the shape of a cloud visible without normals."""

from __future__ import annotations

from typing import Any

import numpy as np

from zsight_core.jit import njit

__all__ = ["shade_by_depth", "warm_up"]

REACH = 2  # pixels
STRENGTH = 25.0
DARKEST = 0.45
LEAST = 0.002  # of the depth: below this nothing darkens


def warm_up() -> None:
    """Compile the kernel of this module, or load it from the cache."""
    shade_by_depth(np.ones((4, 4), np.float32), np.zeros((4, 4, 3), np.uint8))


@njit(cache=True, nogil=True)
def shade_by_depth(depth: Any, image: Any) -> None:
    """Darken pixels behind their neighbours.

    Method: eye-dome lighting (Boucheny, Visualisation scientifique interactive de grands volumes de donnees, 2009): the
    shade of a pixel is exp of minus the mean of how much nearer, relative to its own depth, each neighbour is.

    Args:
        depth: (rows, columns) float32, metres; infinite where nothing is drawn.
        image: (rows, columns, 3) uint8, changed in place.
    """
    height, width = depth.shape
    for v in range(REACH, height - REACH):
        for u in range(REACH, width - REACH):
            here = depth[v, u]
            if here == np.inf:
                continue
            nearer = max(here - depth[v, u - REACH], 0.0) + max(here - depth[v, u + REACH], 0.0)
            nearer += max(here - depth[v - REACH, u], 0.0) + max(here - depth[v + REACH, u], 0.0)
            if nearer > LEAST * here:
                shade = max(np.exp(-STRENGTH / 4 * nearer / here), DARKEST)
                for k in range(3):
                    image[v, u, k] = np.uint8(shade * image[v, u, k])
