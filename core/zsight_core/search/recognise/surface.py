"""Table tops and other surfaces: the scene stage has found them; what is left is to choose by size."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from zsight_core.model import Surface
    from zsight_core.scene import Scene
    from zsight_core.support import Support

__all__ = ["surfaces"]


def surfaces(shape: Surface, scene: Scene) -> list[tuple[int, Support]]:
    """Number and surface of each that is large enough, best first."""
    return [(k, support) for k, support in enumerate(scene.supports) if support.area >= shape.minimum_area]
