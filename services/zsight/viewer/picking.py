"""What was clicked in the scene: a thing is asked what it is, or taught; a surface narrows the next finds to it."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING

from zsight.client import CellClient
from zsight.errors import ZsightError
from zsight.viewer.region import region_around
from zsight.viewer.server import set_value

if TYPE_CHECKING:
    import viser

    from zsight.bus import Bus
    from zsight.viewer.frames import Frames
    from zsight.viewer.region import RegionOfInterest
    from zsight.viewer.scene_layer import Pick
    from zsight_protocol.find_object import DetectedObject
    from zsight_protocol.geometry import Region

__all__ = ["Picking"]

_AROUND = 0.03  # metres beyond a thing in which it is sought
_TIMEOUT = 5.0  # seconds for each type that a thing may be


class Picking:
    """The panel under the scene."""

    def __init__(self, server: viser.ViserServer, bus: Bus, frames: Frames, region: RegionOfInterest) -> None:
        """Args: server of the page; bus; frames; region that a surface narrows finds to."""
        self._client, self._frames, self._region = CellClient(bus), frames, region
        self._pick: Pick | None = None
        self._busy = threading.Lock()
        gui = server.gui
        self._words = gui.add_markdown("Click a thing in the scene to ask what it is, a surface to seek only there.")
        self._bar = gui.add_progress_bar(0.0, visible=False)
        self._name = gui.add_text("Teach it as", "", hint="Name of a new type: lower-case letters, digits and _")
        gui.add_button("Teach", hint="Measure the thing that was clicked, and add it to the catalogue").on_click(
            lambda _: self._teach()
        )

    def picked(self, pick: Pick) -> None:
        """Something was clicked."""
        self._pick = pick
        if pick.is_surface:
            self._region.choose(region_around(pick.corners, 0.0), pick.name)
            self._words.content = f"**{pick.name}**: finds look only there now; see the tab Find."
        elif self._busy.acquire(blocking=False):
            try:
                self._identify(pick)
            finally:
                self._bar.visible = False
                self._busy.release()

    def _identify(self, pick: Pick) -> None:
        """Ask for every type in turn, only there: the most probable one is what it is."""
        region, best = region_around(pick.corners, _AROUND), None
        try:
            names = sorted(kind.name for kind in self._client.catalog.list() if kind.shape.surface is None)
            self._bar.visible = True
            for number, name in enumerate(names):
                set_value(self._bar, 100.0 * number / len(names))
                self._words.content = f"**{pick.name}**: is it a {name}?"
                best = max((best, self._sought(name, region)), key=lambda found: found.score if found else 0.0)
        except ZsightError as error:
            self._words.content = f"**{pick.name}**: {error}"
            return
        self._words.content = f"**{pick.name}**: {_verdict(best)}"

    def _sought(self, name: str, region: Region) -> DetectedObject | None:
        result = self._client.find(name, region=region, frame=self._frames.fixed, timeout=_TIMEOUT)
        return result.objects[0] if result.objects else None

    def _teach(self) -> None:
        pick, name = self._pick, str(self._name.value).strip()
        if pick is None or pick.is_surface or not name:
            self._words.content = "Click a thing and give a name first."
            return
        self._words.content = f"measuring {pick.name} ..."
        x, y, z = (float(value) for value in pick.corners.mean(axis=0))
        try:
            kind, taught = self._client.catalog.teach(
                name, place=(x, y, z), frame=self._frames.fixed, camera=pick.camera
            )
        except ZsightError as error:
            self._words.content = f"**not taught**: {error}"
            return
        shape = next(key for key in ("box", "cylinder", "sphere", "mesh", "surface") if getattr(kind.shape, key))
        self._words.content = f"**{name}** is in the catalogue: a {shape} that explains {taught.explained:.0%} of it."


def _verdict(best: DetectedObject | None) -> str:
    if best is None:
        return "nothing that the catalogue knows. Teach it, if it is to be found again."
    other = f"; else a {best.runner_up}" if best.runner_up else ""
    return f"a **{best.type}** with probability {best.score:.0%}{other}."
