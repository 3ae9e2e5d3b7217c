"""Second opinions change scores, and take away what is no longer likely."""

from __future__ import annotations

from importlib import metadata
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from zsight.finding import verifiers
from zsight_core.find import Answer, Detection

if TYPE_CHECKING:
    from collections.abc import Iterator

NOTHING: Any = None  # neither points nor scene are looked at here


def detection(kind: str, score: float) -> Detection:
    return Detection(
        kind, score, np.eye(4), None, (0.1, 0.1, 0.1), 0.1, np.eye(6), 1.0, 0, 0.0, truncated=False, occluded=False
    )


def doubts_cans(_points: Any, _scene: Any, found: Detection) -> float:
    return -3.0 if found.type == "can" else 1.0


@pytest.fixture
def plug(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[metadata.EntryPoint]]:
    points = [metadata.EntryPoint("doubt", f"{__name__}:doubts_cans", verifiers.GROUP)]
    installed = metadata.entry_points

    def entry_points(**wanted: str) -> Any:
        return points if wanted.get("group") == verifiers.GROUP else installed(**wanted)

    monkeypatch.setattr(metadata, "entry_points", entry_points)
    verifiers.known_verifiers.cache_clear()
    yield points
    verifiers.known_verifiers.cache_clear()


def test_without_verifiers_an_answer_stays_as_it_is(plug: list[metadata.EntryPoint]) -> None:
    plug.clear()
    answer = Answer("found", (detection("can", 0.9),), 1.0)
    assert verifiers.verified(answer, NOTHING, NOTHING) is answer


@pytest.mark.usefixtures("plug")
def test_odds_are_multiplied_and_the_most_likely_comes_first() -> None:
    answer = Answer("found", (detection("can", 0.99), detection("cube", 0.9)), 1.0)
    cube, can = verifiers.verified(answer, NOTHING, NOTHING).detections
    assert (cube.type, can.type) == ("cube", "can")
    assert cube.score / (1 - cube.score) == pytest.approx(9 * np.e)
    assert can.score / (1 - can.score) == pytest.approx(99 * np.exp(-3))


@pytest.mark.usefixtures("plug")
def test_what_is_no_longer_likely_is_not_reported() -> None:
    answer = verifiers.verified(Answer("found", (detection("can", 0.9),), 0.8), NOTHING, NOTHING)
    assert (answer.status, answer.detections, answer.p_absent) == ("cannot_tell", (), 0.8)


def test_a_verifier_that_cannot_be_loaded_is_left_out(
    plug: list[metadata.EntryPoint], caplog: pytest.LogCaptureFixture
) -> None:
    plug[0] = metadata.EntryPoint("doubt", "zsight:no_such_name", verifiers.GROUP)
    assert verifiers.known_verifiers() == ()
    assert "zsight:no_such_name is left out" in caplog.text
