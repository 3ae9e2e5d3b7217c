"""Ways to recognise: one file a shape, each a function from a shape and the clues of a scene to hypotheses.

All shapes that are known here say in which poses they rest, and let ``votes`` find where.

A hypothesis need only be within about 10 mm and 10 degrees; refinement, verification, rivals, score and covariance come
after it and know nothing of shapes. A new way is a new file and a line in ``_WAYS``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from zsight_core.model import Box, Cylinder, Mesh, Shape, Sphere
from zsight_core.recognise import box, cylinder, mesh, sphere

if TYPE_CHECKING:
    from collections.abc import Callable

    from zsight_core.clues import Clues, Hypothesis

__all__ = ["hypotheses"]

_WAYS: dict[type, Callable[[Any, Clues], list[Hypothesis]]] = {
    Box: box.hypotheses,
    Cylinder: cylinder.hypotheses,
    Sphere: sphere.hypotheses,
    Mesh: mesh.hypotheses,
}


def hypotheses(shape: Shape, clues: Clues) -> list[Hypothesis]:
    """Where the shape might stand; empty for a shape that nothing here recognises."""
    way = _WAYS.get(type(shape))
    return way(shape, clues) if way else []
