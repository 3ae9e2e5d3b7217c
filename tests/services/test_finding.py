"""What the camera's own pose adds to how sure the place of an object is."""

from __future__ import annotations

import numpy as np
import pytest

from zsight.finding.answering import Extrinsic, with_extrinsic


@pytest.mark.parametrize("extrinsic", [Extrinsic(0.002, 0.001), Extrinsic(0.0, 0.01), Extrinsic(0.01, 0.0)])
def test_a_covariance_is_that_of_cameras_that_are_a_little_elsewhere(extrinsic: Extrinsic) -> None:
    generator = np.random.default_rng(0)
    place, camera = np.array([0.5, -0.3, 0.8]), np.array([0.0, 0.1, 1.8])
    turns = extrinsic.rotation * generator.standard_normal((200_000, 3))
    moved = extrinsic.position * generator.standard_normal((200_000, 3)) + np.cross(turns, place - camera)
    expected = np.cov(np.hstack([moved, turns]).T)
    found = with_extrinsic(np.zeros((6, 6)), place, camera, extrinsic)
    np.testing.assert_allclose(found, expected, atol=0.02 * np.abs(expected).max())
    own = np.diag(np.arange(1.0, 7.0))
    np.testing.assert_allclose(with_extrinsic(own, place, camera, extrinsic), own + found)
