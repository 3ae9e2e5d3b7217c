"""Found objects as viewers draw them: triangles, a colour, words."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from zsight.convert import matrix_of
from zsight_core.model import Box
from zsight_core.solid import solid_of

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from zsight.catalogue.type_files import Catalogue
    from zsight_protocol.find_object import FindObjectResult
    from zsight_protocol.message import Time

__all__ = ["Thing", "things_of"]

_PLAIN = (0, 158, 115)  # of objects whose type has no colour
_FLAT = (0.01, 0.01, 0.001)  # metres; of a surface whose extent is not known


@dataclass(frozen=True, eq=False)
class Thing:
    """A name that is its own, where it stands in which frame at which time, and how it looks."""

    name: str
    frame_id: str
    stamp: Time
    T_frame_thing: NDArray[np.float64]
    """(4, 4)"""
    vertices: NDArray[np.float64]
    """(V, 3) metres, in its own frame."""
    faces: NDArray[np.int32]
    """(F, 3) rows of vertices."""
    colour: tuple[int, int, int]
    words: str


def things_of(asked: str, result: FindObjectResult, catalogue: Catalogue) -> list[Thing]:
    """What an answer found.

    Args:
        asked: what was sought; answers to the same question name their things alike.
        result: the answer.
        catalogue: shapes and colours.
    """
    things = []
    for number, found in enumerate(result.objects):
        solid = solid_of(catalogue.outline(found) or Box(_FLAT))
        known = catalogue.types.get(found.type)
        colour = known.colour if known is not None and known.colour is not None else _PLAIN
        things.append(
            Thing(
                f"{asked}_{number}",
                result.header.frame_id,
                result.header.stamp,
                matrix_of(found.pose),
                solid.vertices,
                solid.faces,
                colour,
                f"{found.type} {found.score:.0%}",
            )
        )
    return things
