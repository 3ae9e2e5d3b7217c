"""Recognisers of other distributions propose beside those that ship."""

from __future__ import annotations

from importlib import metadata
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from tests.core import book_scene as book

from zsight_core import find as finder
from zsight_core.scene import understand
from zsight_core.search import recognise
from zsight_core.search.clues import Hypothesis
from zsight_core.transform import inverse

if TYPE_CHECKING:
    from collections.abc import Iterator

    from zsight_core.model import Shape
    from zsight_core.search.clues import Clues

pytestmark = pytest.mark.usefixtures("warm_kernels")

ASKED: list[Shape] = []


def oracle(shape: Shape, _: Clues) -> list[Hypothesis]:
    """What a network would say."""
    ASKED.append(shape)
    return [] if ORACLE is None else [ORACLE]


ORACLE: Hypothesis | None = None


@pytest.fixture
def plug(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[metadata.EntryPoint]]:
    """Entry points that are there while a test runs."""
    points = [metadata.EntryPoint("box", f"{__name__}:oracle", recognise.GROUP)]

    installed = metadata.entry_points

    def entry_points(**wanted: str) -> Any:
        if wanted.get("group") != recognise.GROUP:
            return installed(**wanted)
        return [point for point in points if point.name == wanted["name"]]

    monkeypatch.setattr(metadata, "entry_points", entry_points)
    recognise.plugged.cache_clear()
    ASKED.clear()
    yield points
    recognise.plugged.cache_clear()


@pytest.mark.usefixtures("plug")
def test_what_only_a_plug_proposes_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recognise, "_WAYS", {})
    points = book.cloud((book.TOY_BLOCK, book.T_WORLD_BLOCK))
    nothing = finder.find(points, [book.TOY_BLOCK], T_world_camera=book.T_WORLD_CAMERA)
    assert nothing.detections == ()
    assert [book.TOY_BLOCK.shape] == ASKED
    scene = understand(points, T_world_camera=book.T_WORLD_CAMERA)
    T_world_support = book.T_WORLD_CAMERA @ scene.supports[0].T_camera_support
    T = inverse(T_world_support) @ book.T_WORLD_BLOCK
    T[:2, 3] += 0.004
    monkeypatch.setitem(globals(), "ORACLE", Hypothesis(T, 0.0, 0, turns=True))
    (block,) = finder.find(points, [book.TOY_BLOCK], scene=scene, T_world_camera=book.T_WORLD_CAMERA).detections
    assert block.T_world_model is not None
    np.testing.assert_allclose(block.T_world_model[:3, 3], book.T_WORLD_BLOCK[:3, 3], atol=2e-4)


@pytest.mark.usefixtures("plug")
def test_a_plug_is_asked_for_its_shapes_only() -> None:
    assert len(recognise.plugged("box")) == 1
    assert recognise.plugged("sphere") == ()


def test_a_plug_that_cannot_be_loaded_is_left_out(
    plug: list[metadata.EntryPoint], caplog: pytest.LogCaptureFixture
) -> None:
    plug[0] = metadata.EntryPoint("box", "no_such_package:propose", recognise.GROUP)
    assert recognise.plugged("box") == ()
    assert "no_such_package:propose is left out: No module named" in caplog.text
