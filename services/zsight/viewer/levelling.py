"""Set a camera's pose by the table or floor that it sees."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from zsight.client import CellClient
from zsight.errors import ZsightError
from zsight_core.errors import CoreError

if TYPE_CHECKING:
    import viser

    from zsight.bus import Bus
    from zsight.viewer.clouds import Clouds

__all__ = ["Levelling"]


class Levelling:
    """A camera, the height of the surface it sees, a button."""

    def __init__(self, server: viser.ViserServer, bus: Bus, clouds: Clouds) -> None:
        """Args: server of the page; bus; clouds whose cameras are offered."""
        self._client, self._clouds = CellClient(bus), clouds
        with server.gui.add_folder("Level a camera", expand_by_default=False):
            self._height = server.gui.add_number("Surface at, m", 0.0, step=0.001, hint="Its height in the world")
            self._save = server.gui.add_checkbox("Keep", False, hint="Over a restart of the camera too")
            server.gui.add_button("Level", hint="Roll, pitch and height by the largest surface in view").on_click(
                lambda _: self._level()
            )
            self._words = server.gui.add_markdown("")

    def _level(self) -> None:
        for camera in self._clouds.cameras():
            self._words.content = f"measuring {camera} ..."
            try:
                level = self._client.level_camera(
                    camera, surface_height=float(self._height.value), save=bool(self._save.value)
                )
            except (ZsightError, CoreError) as error:
                self._words.content = f"**{camera} stays as it was**: {error}"
                return
            roll, pitch = (math.degrees(angle) for angle in (level.roll, level.pitch))
            self._words.content = f"**{camera}**: roll {roll:.2f}, pitch {pitch:.2f} degrees, {level.height:.4f} m high"
