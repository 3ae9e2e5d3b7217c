"""Ways to recognise: one file a shape, each a function from a shape and the clues of a scene to hypotheses.

All shapes that are known here say in which poses they rest, and let ``votes`` find where.

A hypothesis need only be within about 10 mm and 10 degrees; refinement, verification, rivals, score and covariance come
after it and know nothing of shapes. A new way is a new file and a line in ``_WAYS``.

Other distributions bring ways too: an entry point of the group ``zsight.recognisers`` is called box, cylinder, sphere
or mesh and names such a function, a network that proposes poses for instance. What it proposes is looked at beside the
rest.
"""

from __future__ import annotations

import logging
from functools import cache
from importlib import metadata
from typing import TYPE_CHECKING, Any

from zsight_core.model import Box, Cylinder, Mesh, Shape, Sphere
from zsight_core.scene import go_on
from zsight_core.search.clues import NOTHING
from zsight_core.search.recognise import box, cylinder, mesh, sphere

if TYPE_CHECKING:
    from collections.abc import Callable

    from zsight_core.scene import Checkpoint
    from zsight_core.search.clues import Clues, Hypothesis

__all__ = ["GROUP", "hypotheses", "plugged", "prepare", "turned"]

log = logging.getLogger(__name__)

_WAYS: dict[type, Callable[[Any, Clues, Checkpoint], list[Hypothesis]]] = {
    Box: box.hypotheses,
    Cylinder: cylinder.hypotheses,
    Sphere: sphere.hypotheses,
    Mesh: mesh.hypotheses,
}


GROUP = "zsight.recognisers"


def hypotheses(shape: Shape, clues: Clues, checkpoint: Checkpoint = go_on) -> list[Hypothesis]:
    """Where the shape might stand; empty for a shape that nothing here recognises."""
    way = _WAYS.get(type(shape))
    found = way(shape, clues, checkpoint) if way else []
    return [*found, *(guess for other in plugged(type(shape).__name__.lower()) for guess in other(shape, clues))]


def turned(shape: Shape, clues: Clues, found: Hypothesis) -> list[Hypothesis]:
    """How else the shape may rest where it was found; empty for shapes of which every part tells how they rest."""
    return mesh.turned(shape, clues, found) if isinstance(shape, Mesh) else []


def prepare(shape: Shape) -> None:
    """Work out beforehand what the ways to recognise a shape know of it before they see any scene."""
    way = _WAYS.get(type(shape))
    if way:
        way(shape, NOTHING, go_on)


@cache
def plugged(kind: str) -> tuple[Callable[[Any, Clues], list[Hypothesis]], ...]:
    """Ways of other distributions for a kind of shape; what cannot be loaded is logged and left out."""
    found = []
    for point in sorted(metadata.entry_points(group=GROUP, name=kind), key=lambda point: point.value):
        try:
            found.append(point.load())
        except (ImportError, AttributeError) as error:
            log.warning("recogniser %s is left out: %s", point.value, error)
    return tuple(found)
