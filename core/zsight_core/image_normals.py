"""Normals of an organised cloud, from how its points move from pixel to pixel in a window."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from zsight_core.errors import GeometryError, PointsError
from zsight_core.jit import njit
from zsight_core.points import is_organised
from zsight_core.scratch import scratch
from zsight_core.take import array_for
from zsight_core.words import words_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from zsight_core.points import Points
    from zsight_core.words import Layout

__all__ = ["image_normals", "load_row", "mark_edges", "mark_near", "normals_of_row", "warm_up"]

_LEAST = 3
"""Pixels along the edge of the smallest window."""


def image_normals(
    points: Points, window: int = 10, depth_change: float = 0.02, out: NDArray[np.float32] | None = None
) -> NDArray[np.float32]:
    """Unit normals, towards the origin, of the surface around each pixel.

    Method: in a window around the pixel the slopes of x, y and z from column to column and from row to row, by least
    squares, are two tangents; their cross product is the normal. It needs six sums over the window where the
    eigenvector of a covariance needs nine and an eigenvalue, and knows no camera: the cloud may be in any frame. As in
    PCL's integral images (Holzer et al. 2012), no window reaches over an edge in depth: near one it is smaller, down
    to 3 pixels.

    Args:
        points: (H, W), organised, metres; z is the depth, of either sign.
        window: pixels along its edge, 3 or more; around pixel u it spans u - window // 2 .. .
        depth_change: neighbours whose depths differ by more than 2 (1 + |z|) times this are on two surfaces.
        out: room for the result, contiguous.

    Returns:
        float32 (H, W, 3); NaN at holes and within 3 pixels of an edge, a hole or the border.

    Raises:
        PointsError: the cloud is not organised, or `out` does not fit.
        GeometryError: the window is below 3; `depth_change` not above zero.
    """
    if not is_organised(points):
        raise PointsError(f"cloud has shape {points.shape}; expected rows and columns of an image: use normals")
    if not (window >= _LEAST and depth_change > 0):
        raise GeometryError(f"window {window}, depth change {depth_change}; expected 3 or more, above zero")
    normals = array_for((*points.shape, 3), np.float32, out)
    cloud = words_of(points)
    edges, near = (scratch(f"normals {name}", points.shape, np.uint8) for name in ("edges", "near"))
    mark_edges(cloud.words, cloud.layout, points.shape[1], np.float32(depth_change), edges)
    normals[:] = np.nan
    for size in _sizes(window):
        mark_near(edges, size, near)
        _fill(cloud.words, cloud.layout, size, near, normals)
    return normals


def _sizes(window: int) -> list[int]:
    """Windows, the smallest first, each about 1.4 times the one before."""
    sizes = [window]
    while sizes[0] > _LEAST:
        sizes.insert(0, max(_LEAST, round(sizes[0] / 1.4)))
    return sizes


@njit(cache=True, nogil=True)
def mark_edges(
    words: NDArray[np.float32], layout: Layout, width: int, depth_change: Any, edges: NDArray[np.uint8]
) -> None:
    """Mark holes, and pixels on either side of a jump in depth, with 1 in (H, W)."""
    height = len(edges)
    row, below = np.empty((3, width), np.float32), np.empty((3, width), np.float32)
    factor, jump = np.float32(2 * depth_change), np.empty(width, np.uint8)
    load_row(words, layout, 0, row)
    edges[0] = 0
    for r in range(height):
        _mark_holes(row, jump)
        _add(jump, edges[r])
        _mark_jumps(row[2, :-1], row[2, 1:], factor, jump[:-1])
        _add(jump[:-1], edges[r, :-1])
        _add(jump[:-1], edges[r, 1:])
        if r + 1 == height:
            break
        load_row(words, layout, r + 1, below)
        _mark_jumps(row[2], below[2], factor, jump)
        _add(jump, edges[r])
        edges[r + 1] = jump
        row, below = below, row


@njit(cache=True, nogil=True)
def _mark_holes(row: NDArray[np.float32], hole: NDArray[np.uint8]) -> None:
    """1 where a coordinate of (3, W) is not finite (or their sum is beyond float32)."""
    x, y, z, infinite = row[0], row[1], row[2], np.float32(np.inf)
    for c in range(len(hole)):
        hole[c] = not (abs(x[c]) + abs(y[c]) + abs(z[c]) < infinite)


@njit(cache=True, nogil=True)
def _mark_jumps(depth: NDArray[np.float32], other: NDArray[np.float32], factor: Any, jump: NDArray[np.uint8]) -> None:
    """1 where two depths differ by more than factor (1 + |depth|), or one is not finite."""
    one = np.float32(1)
    for c in range(len(jump)):
        jump[c] = not (abs(depth[c] - other[c]) <= factor * (abs(depth[c]) + one))


@njit(cache=True, nogil=True)
def load_row(words: NDArray[np.float32], layout: Layout, r: int, row: NDArray[np.float32]) -> None:
    """Coordinates (3, W) of a row of the image."""
    step, at_x, at_y, at_z = layout
    width = row.shape[1]
    part = words[step * width * r : step * width * (r + 1)]
    if step == 4 and at_x == 0 and at_y == 1 and at_z == 2:  # so the compiler turns rows into columns in registers
        for c in range(width):
            row[0, c], row[1, c], row[2, c] = part[4 * c], part[4 * c + 1], part[4 * c + 2]
    else:
        for c in range(width):
            row[0, c], row[1, c], row[2, c] = part[step * c + at_x], part[step * c + at_y], part[step * c + at_z]


@njit(cache=True, nogil=True)
def mark_near(edges: NDArray[np.uint8], size: int, near: NDArray[np.uint8]) -> None:
    """Mark pixels from which an edge is less than `size` steps away; a diagonal step counts 1.4, as in PCL."""
    height, width = edges.shape
    near[:] = edges
    half_width = np.array([_half_width(down, size) for down in range(size)])
    wide, wider = np.empty(width, np.uint8), np.empty(width, np.uint8)
    for r in range(height):
        wide[:] = edges[r]
        for across in range(size):
            for down in range(size):
                if half_width[down] == across:
                    _add(wide, near[max(r - down, 0)])
                    _add(wide, near[min(r + down, height - 1)])
            wider[:] = wide
            _add(wide[1:], wider[:-1])
            _add(wide[:-1], wider[1:])
            wide, wider = wider, wide


@njit(cache=True, nogil=True)
def _half_width(down: int, size: int) -> int:
    """How many columns a pixel `down` rows off may be aside and still less than `size` steps away."""
    across = size - 1
    while across >= 0 and max(across, down) + 0.4 * min(across, down) >= size - 1e-6:
        across -= 1
    return across


@njit(cache=True, nogil=True)
def _add(marks: NDArray[np.uint8], into: NDArray[np.uint8]) -> None:
    for c in range(len(into)):
        into[c] |= marks[c]


@njit(cache=True, nogil=True)
def _fill(
    words: NDArray[np.float32], layout: Layout, size: int, near: NDArray[np.uint8], normals: NDArray[np.float32]
) -> None:
    """Write the normals of all pixels that are not near an edge."""
    height, width = near.shape
    ring = np.empty((size, 3, width), np.float32)
    sums, normal = np.empty((4, width), np.float32), np.empty((4, width), np.float32)
    for last in range(height):
        load_row(words, layout, last, ring[last % size])
        r = last - (size - 1 - size // 2)
        if r < size // 2:
            continue
        normals_of_row(ring, last, sums, normal)
        for c in range(size // 2, width - (size - 1 - size // 2)):
            if near[r, c] == 0:
                normals[r, c, 0], normals[r, c, 1], normals[r, c, 2] = normal[0, c], normal[1, c], normal[2, c]


@njit(cache=True, nogil=True)
def normals_of_row(
    ring: NDArray[np.float32], last: int, sums: NDArray[np.float32], normal: NDArray[np.float32]
) -> None:
    """Normals, and distance from the origin, of the row in the middle of a window of rows.

    Args:
        ring: (S, 3, W) the last S rows; row r of the image is ring[r % S].
        last: number of the newest.
        sums: (4, W) room.
        normal: (4, W) gets nx, ny, nz and the distance n . p, negative; garbage where the window holds holes.
    """
    size, _, width = ring.shape
    before = size // 2
    first, end = before, width - (size - 1 - before)
    tangents = np.zeros((2, 3, width), np.float32)
    for axis in range(3):
        _add_rows(ring, last, axis, sums)
        _slopes(sums[0], size, tangents[0, axis, first:end])
        _totals(sums[1], size, tangents[1, axis, first:end])
    for axis in range(3):
        one, other = (axis + 1) % 3, (axis + 2) % 3
        _cross(tangents[0, one], tangents[1, other], tangents[0, other], tangents[1, one], normal[axis])
    _towards_origin(normal, ring[(last - (size - 1 - before)) % size])


@njit(cache=True, nogil=True, fastmath={"contract"})
def _add_rows(ring: NDArray[np.float32], last: int, axis: int, sums: NDArray[np.float32]) -> None:
    """For each column, over the rows: the sum of a coordinate (0), and its slope from row to row (1)."""
    size = len(ring)
    plain, slope = sums[0], sums[1]
    if size % 2:
        plain[:] = ring[(last - size // 2) % size, axis]
    else:
        plain[:] = 0
    slope[:] = 0
    for k in range(size // 2):
        low, high, weight = (
            ring[(last + 1 + k) % size, axis],
            ring[(last - k) % size, axis],
            np.float32(size - 1 - 2 * k),
        )
        for c in range(len(plain)):
            plain[c] += low[c] + high[c]
            slope[c] += weight * (high[c] - low[c])


@njit(cache=True, nogil=True, fastmath={"contract"})
def _slopes(plain: NDArray[np.float32], size: int, across: NDArray[np.float32]) -> None:
    """Slope from column to column over `size` columns from each on, but for a common factor."""
    count = len(across)
    across[:] = 0
    for k in range(size // 2):
        j, weight = size - 1 - k, np.float32(size - 1 - 2 * k)
        left, right = plain[k : k + count], plain[j : j + count]
        for c in range(count):
            across[c] += weight * (right[c] - left[c])


@njit(cache=True, nogil=True)
def _totals(values: NDArray[np.float32], size: int, total: NDArray[np.float32]) -> None:
    """Sum of `size` columns from each on."""
    count = len(total)
    total[:] = 0
    for k in range(size):
        part = values[k : k + count]
        for c in range(count):
            total[c] += part[c]


@njit(cache=True, nogil=True, fastmath={"contract"})
def _cross(
    a: NDArray[np.float32],
    b: NDArray[np.float32],
    c: NDArray[np.float32],
    d: NDArray[np.float32],
    out: NDArray[np.float32],
) -> None:
    for i in range(len(out)):
        out[i] = a[i] * b[i] - c[i] * d[i]


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _towards_origin(normal: NDArray[np.float32], point: NDArray[np.float32]) -> None:
    """Make normals (rows 0..2) unit vectors that face the origin; row 3 gets n . p."""
    x, y, z, distance = normal[0], normal[1], normal[2], normal[3]
    px, py, pz, one = point[0], point[1], point[2], np.float32(1)
    for c in range(len(x)):
        distance[c] = x[c] * px[c] + y[c] * py[c] + z[c] * pz[c]
    scale = np.empty(len(x), np.float32)
    for c in range(len(x)):
        length = one / np.sqrt(x[c] * x[c] + y[c] * y[c] + z[c] * z[c])
        scale[c] = -length if distance[c] > 0 else length
    for row in range(4):
        values = normal[row]
        for c in range(len(scale)):
            values[c] *= scale[c]


def warm_up() -> None:
    """Compile the kernels of this file."""
    from zsight_core.points import from_xyz

    image_normals(from_xyz(np.ones((12, 12, 3))))
