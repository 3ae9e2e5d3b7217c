"""Second opinions on what was found, from other distributions: a network that looks at each detection, for instance.

An entry point of the group ``zsight.verifiers`` names a function of the points, the scene and a detection, that returns
the logarithm of the odds by which the detection is more (above zero) or less likely than its score says.
"""

from __future__ import annotations

import logging
from dataclasses import replace
from functools import cache
from importlib import metadata
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable

    from zsight_core.find import Answer, Detection
    from zsight_core.points import Points
    from zsight_core.scene import Scene

    Verifier = Callable[[Points, Scene, Detection], float]

__all__ = ["GROUP", "known_verifiers", "verified"]

log = logging.getLogger(__name__)

GROUP = "zsight.verifiers"
LEAST = 0.5
"""Probability below which a detection is no longer reported."""


@cache
def known_verifiers() -> tuple[Verifier, ...]:
    """All that are installed; one that cannot be loaded is logged and left out."""
    found: list[Verifier] = []
    for point in sorted(metadata.entry_points(group=GROUP), key=lambda point: (point.name, point.value)):
        try:
            found.append(point.load())
        except (ImportError, AttributeError) as error:
            log.warning("verifier %s is left out: %s", point.value, error)
    return tuple(found)


def verified(answer: Answer, points: Points, scene: Scene) -> Answer:
    """The answer with what all verifiers say; where none of its objects stays likely, it cannot be told."""
    verifiers = known_verifiers()
    if not verifiers or not answer.detections:
        return answer
    judged = [
        _judged(detection, sum(float(verifier(points, scene, detection)) for verifier in verifiers))
        for detection in answer.detections
    ]
    kept = tuple(sorted((d for d in judged if d.score >= LEAST), key=lambda d: -d.score))
    if not kept:
        return replace(answer, status="cannot_tell", detections=())
    return replace(answer, detections=kept)


def _judged(detection: Detection, shift: float) -> Detection:
    odds = np.log(max(detection.score, 1e-12)) - np.log(max(1 - detection.score, 1e-12)) + shift
    return replace(detection, score=float(1 / (1 + np.exp(-np.clip(odds, -50.0, 50.0)))))
