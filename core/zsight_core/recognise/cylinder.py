"""Cylinders: the side's normals vote for the axis, tops of the right height for its place."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from zsight_core.recognise import votes
from zsight_core.solid import solid_of
from zsight_core.clues import Clues, Hypothesis, Layer, Piece, ends_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from zsight_core.model import Cylinder

__all__ = ["hypotheses"]

LYING = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
"""Rotation that lays the model's z axis along x."""


def hypotheses(shape: Cylinder, clues: Clues) -> list[Hypothesis]:
    """Standing cylinders from tops and from sides; lying ones from the ridge of their sides."""
    poses = [votes.Pose(np.eye(3), shape.height, round=True), votes.Pose(LYING, shape.diameter)]
    found = votes.hypotheses(solid_of(shape), poses, clues)
    for piece in clues.segments + clues.pieces:
        if len(piece.points) < 12:
            continue
        found += _from_side(piece, shape, clues)
        found += _lying(piece, shape)
    return found


def _standing(xy: NDArray[np.float64], base: float, shape: Cylinder, support: int) -> Hypothesis:
    T = np.eye(4)
    T[:2, 3] = xy
    T[2, 3] = base + shape.height / 2
    return Hypothesis(T, base, support, turns=False)


def _disc_places(top: Layer, radius: float, clues: Clues) -> list[NDArray[np.float64]]:
    """Centres of a disc that covers the top: its middle, and if only a part is seen, a radius behind its near rim."""
    xy = top.xy
    (west, east), (south, north) = ends_of(xy[:, 0], 0.02), ends_of(xy[:, 1], 0.02)
    low, high = np.array([west, south]), np.array([east, north])
    places = [(low + high) / 2]
    if (np.abs(high - low - 2 * radius) > 0.01).any():
        towards = clues.eyes[top.support][:2] - xy.mean(axis=0)
        towards = towards / max(float(np.linalg.norm(towards)), 1e-9)
        across = np.array([-towards[1], towards[0]])
        near = ends_of(xy @ towards, 0.02)[1]
        middle = sum(ends_of(xy @ across, 0.02)) / 2
        places.append((near - radius) * towards + middle * across)
    return places


def _from_side(piece: Piece, shape: Cylinder, clues: Clues) -> list[Hypothesis]:
    """Standing on the surface: one radius behind the points of an upright side."""
    side = (np.abs(piece.normals[:, 2]) < 0.3) & (np.linalg.norm(piece.normals[:, :2], axis=1) > 0.8)
    if side.sum() < 10:
        return []
    heights = piece.points[side, 2]
    xy = _behind(piece.points[side, :2], piece.normals[side, :2], shape.diameter / 2)
    found = []
    low, high = ends_of(heights, 0.05)
    for base in clues.bases(piece.support):
        if base > low + 0.012 or high > base + shape.height + 0.012:
            continue
        if clues.is_carried(xy, shape.diameter, base, piece.support):
            found.append(_standing(xy, base, shape, piece.support))
    return found


def _lying(piece: Piece, shape: Cylinder) -> list[Hypothesis]:
    """Lying: the direction that no normal has is the axis."""
    known = np.abs(piece.normals).sum(axis=1) > 0.5
    known &= piece.points[:, 2] > 0.25 * shape.diameter
    if known.sum() < 12 or abs(piece.points[:, 2].max() - shape.diameter) > 0.4 * shape.diameter:
        return []
    normals = piece.normals[known]
    flat = normals[:, :2].T @ normals[:, :2]
    values, vectors = np.linalg.eigh(flat)
    if values[1] < 1e-6:
        return []
    axis = vectors[:, 0]
    across = np.array([-axis[1], axis[0]])
    points = piece.points[known]
    centre_across = float(np.median(points[:, :2] @ across - shape.diameter / 2 * (normals[:, :2] @ across)))
    along = points[:, :2] @ axis
    low, high = ends_of(along, 0.02)
    middles = [(low + high) / 2]
    if high - low < shape.height - 0.012:
        middles += [low + shape.height / 2, high - shape.height / 2]
    yaw = np.arctan2(axis[1], axis[0])
    c, s = np.cos(yaw), np.sin(yaw)
    found = []
    for middle in middles:
        T = np.eye(4)
        T[:3, :3] = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ LYING
        T[:2, 3] = middle * axis + centre_across * across
        T[2, 3] = shape.diameter / 2
        found.append(Hypothesis(T, 0.0, piece.support, turns=True))
    return found


def _behind(xy: NDArray[np.float64], normals: NDArray[np.float64], radius: float) -> NDArray[np.float64]:
    """The place that most points agree on when each steps one radius against its normal: median, twice."""
    centres = xy - radius * normals / np.linalg.norm(normals, axis=1, keepdims=True)
    centre: NDArray[np.float64] = np.median(centres, axis=0)
    near = np.linalg.norm(centres - centre, axis=1) < radius / 2
    return np.median(centres[near], axis=0) if near.sum() >= 5 else centre
