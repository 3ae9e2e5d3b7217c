"""Choose where finds look: a rectangle dragged in the picture, the points last selected, or everywhere."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from viser import Icon

from zsight.viewer.region import feet, region_around

if TYPE_CHECKING:
    import viser

    from zsight.viewer.patches import Patch
    from zsight.viewer.rectangle import RectangleGesture
    from zsight.viewer.region import RegionOfInterest
    from zsight.viewer.scene_layer import SceneLayer
    from zsight.viewer.selection import Selection

__all__ = ["RegionPanel"]

_AROUND, _ABOVE = 0.05, 0.3  # metres that a region reaches beyond what was selected, and above it
_AROUND_DRAWN = 0.02  # metres that it reaches beyond what was drawn around
_DRAW, _STOP = "Draw a region", "Stop drawing"
_EVERYWHERE = "Finds look everywhere."


class RegionPanel:
    """Buttons that choose the region."""

    def __init__(
        self,
        server: viser.ViserServer,
        region: RegionOfInterest,
        gesture: RectangleGesture,
        selection: Selection,
        scenes: SceneLayer,
    ) -> None:
        """Args: server of the page; region to choose; gesture; selection; scenes that tell what things stand on."""
        self._region, self._gesture, self._selection, self._scenes = region, gesture, selection, scenes
        gui = server.gui
        self._draw = gui.add_button(_DRAW, icon=Icon.BOX, hint="Or press G")
        self._only = gui.add_button("Region from the selection", hint="Seek only around the points last selected")
        self._everywhere = gui.add_button("Seek everywhere", disabled=True)
        self._where = _EVERYWHERE
        self._words = gui.add_markdown(self._where)
        self._draw.on_click(lambda _: self._toggle())
        gui.add_command(_DRAW, hotkey="G").on_trigger(lambda _: self._toggle())
        self._only.on_click(lambda _: self._from_selection())
        self._everywhere.on_click(lambda _: region.clear())
        region.on_change = self._changed

    def _toggle(self) -> None:
        if self._draw.label == _STOP:
            self._gesture.end()
        elif self._gesture.begin(self._taken, self._ended):
            self._draw.label = _STOP
            self._words.content = "**Drag a rectangle** around what is sought. The clouds hold still."
        else:
            self._words.content = "There is no cloud on the screen to draw on: is a camera running, and shown?"

    def _ended(self) -> None:
        self._draw.label = _DRAW
        self._words.content = self._where

    def _taken(self, found: list[Patch]) -> None:
        if not found:
            self._words.content = "No point was seen in this rectangle: finds look where they did before."
            return
        points = np.concatenate([patch.xyz_fixed for patch in found])
        below = feet(points, self._scenes.surfaces())
        self._region.choose(region_around(np.concatenate([points, below]), _AROUND_DRAWN), "the region that was drawn")

    def _from_selection(self) -> None:
        if self._selection.last is None:
            self._words.content = "Select some points first: the region goes around them."
            return
        self._region.choose(region_around(self._selection.last.xyz_fixed, _AROUND, _ABOVE), "the selection")

    def _changed(self, words: str) -> None:
        self._everywhere.disabled = self._region.chosen is None
        self._where = words or _EVERYWHERE
        self._words.content = self._where
