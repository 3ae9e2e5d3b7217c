"""What the chosen process's stage makes of the cloud that is held still: its points by their fate, and a legend."""

from __future__ import annotations

from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np

from zsight.convert import points_of
from zsight.viewer.frames import place
from zsight.viewer.stages import STAGES, Seen, StageResult
from zsight_core.errors import CoreError

if TYPE_CHECKING:
    from collections.abc import Mapping

    import viser

    from zsight.viewer.clouds import Clouds, Shown
    from zsight.viewer.frames import Frames
    from zsight.viewer.selection import Selection

__all__ = ["Preview"]

_NODES = ("/tuning/points", "/tuning/things")
_EDGES = (40, 40, 40)


class Preview:
    """One stage at a time."""

    def __init__(
        self, server: viser.ViserServer, frames: Frames, clouds: Clouds, selection: Selection, budget: int
    ) -> None:
        """Args: server of the page; frames; clouds that are held; selection with the patch; points drawn at most."""
        self._server, self._frames, self._clouds, self._selection = server, frames, clouds, selection
        self._budget = budget
        self._words = server.gui.add_markdown("")
        self._legend = server.gui.add_html("")

    def show(self, service: str, settings: Mapping[str, Any]) -> None:
        """Show what the stage of a service makes of the held cloud with these settings."""
        shown = next((shown for shown in self._clouds.shown() if shown.camera == settings.get("camera")), None)
        result = self._made(service, settings, shown)
        if shown is None or isinstance(result, str):
            self.clear()
            self._words.content = str(result)
            return
        self._words.content = f"On the frozen cloud: {result.words}."
        self._legend.content = _legend(result)
        self._draw(shown, result)

    def clear(self) -> None:
        """Show nothing."""
        self._words.content = self._legend.content = ""
        self._clouds.hide_planes(False)
        for node in _NODES:
            self._server.scene.remove_by_name(node)

    def _made(self, service: str, settings: Mapping[str, Any], shown: Shown | None) -> StageResult | str:
        """What the stage makes of a cloud; words where there is none, or nothing comes out."""
        stage = STAGES.get(service)
        if stage is None:
            return f"No setting of a {service} changes a point." if service else ""
        if shown is None:
            return f"No cloud of {settings.get('camera')} is on the screen to try it on."
        try:
            return stage(self._seen(shown), settings)
        except CoreError as error:
            return f"**nothing comes out**: {error}"

    def _seen(self, shown: Shown) -> Seen:
        patch = self._selection.last
        own = points_of(patch.message) if patch is not None and patch.shown.camera == shown.camera else None
        header = shown.cloud.header
        return Seen(points_of(shown.cloud), own, self._frames.T_world(header.frame_id, header.stamp.ns))

    def _draw(self, shown: Shown, result: StageResult) -> None:
        self._clouds.hide_planes(True)  # they have the colours of the fates
        step = -(-len(result.xyz) // self._budget) or 1
        finite = np.isfinite(result.xyz).all(axis=1)
        self._server.scene.add_point_cloud(
            _NODES[0],
            result.xyz[finite][::step],
            result.colours[finite][::step],
            point_size=1.4 * self._clouds.disc,
            point_shape="circle",
            point_shading="flat",
            precision="float32",
            **place(shown.T_fixed_cloud),
        )
        self._server.scene.remove_by_name(_NODES[1])
        if len(result.edges):
            self._server.scene.add_line_segments(
                _NODES[1], result.edges, _EDGES, thickness=2.0, thickness_units="screen", **place(shown.T_fixed_cloud)
            )


def _legend(result: StageResult) -> str:
    """A row for each fate with its colour and its number of points."""
    rows = ""
    for fate in result.fates:
        colour = "transparent" if fate.colour is None else f"rgb{fate.colour}"
        swatch = f"<span style='display:inline-block;width:1em;height:1em;background:{colour}'></span>"
        rows += f"<tr><td>{swatch}</td><td>{escape(fate.name)}</td><td class='n'>{fate.count:,}</td></tr>"
    return f"<table class='zs'><tr><th></th><th>points</th><th class='n'>how many</th></tr>{rows}</table>"
