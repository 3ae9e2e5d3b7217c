"""The book's computed cloud."""

from __future__ import annotations

import numpy as np

from zsight_core.ellipse import ellipse
from zsight_core.points import XYZRGB, colours


def test_has_the_books_count_and_layout() -> None:
    cloud = ellipse()
    assert cloud.shape == (1, 2920)
    assert cloud.dtype == XYZRGB


def test_layers_rise_by_five_centimetres() -> None:
    heights = np.unique(ellipse()["z"])
    assert len(heights) == 40
    np.testing.assert_allclose(heights, np.linspace(-1, 0.95, 40), atol=1e-7)


def test_every_layer_is_the_same_closed_ellipse() -> None:
    layers = ellipse().reshape(40, 73)
    np.testing.assert_allclose((layers["x"] / 0.5) ** 2 + layers["y"] ** 2, 1, atol=1e-6)
    np.testing.assert_array_equal(layers["x"], np.broadcast_to(layers["x"][0], (40, 73)))
    np.testing.assert_allclose(layers["y"][:, 0], layers["y"][:, -1], atol=1e-6)
    np.testing.assert_allclose(np.diff(np.unwrap(np.arctan2(layers["y"], 2 * layers["x"]))), np.radians(5), atol=1e-6)


def test_colour_runs_from_red_over_green_to_blue() -> None:
    rgb = colours(ellipse()).reshape(40, 73, 3)[:, 0].astype(int)
    assert rgb[0].tolist() == [255, 0, 0]
    assert rgb[20].tolist() == [0, 255, 0]
    assert rgb[39, 2] == max(rgb[:, 2]) > 240
    assert (np.diff(rgb[:21, 0]) < 0).all()
    assert (np.diff(rgb[20:, 2]) > 0).all()
    assert abs(rgb.sum(axis=1) - 255).max() <= 1
