"""The gesture of a rectangle: the clouds hold still, somebody drags, and what was seen there is handed on."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING

from zsight.viewer.patches import lens_of, patches
from zsight_core.visible import Rectangle

if TYPE_CHECKING:
    from collections.abc import Callable

    import viser

    from zsight.viewer.clouds import Clouds
    from zsight.viewer.patches import Patch

__all__ = ["RectangleGesture"]


class RectangleGesture:
    """One rectangle at a time, for whoever asked last."""

    def __init__(self, server: viser.ViserServer, clouds: Clouds) -> None:
        """Args: server of the page; clouds that are selected from."""
        self._server, self._clouds = server, clouds
        self._ended: Callable[[], None] | None = None
        self._taken: Callable[[list[Patch]], None] = lambda _: None
        self._held_before = False
        self._lock = threading.RLock()

    def begin(self, taken: Callable[[list[Patch]], None], ended: Callable[[], None]) -> bool:
        """Wait for a rectangle; whoever waited before is told that it is over.

        Args:
            taken: told what was seen in the rectangle, after ``ended``; an empty list where nothing was.
            ended: told that no rectangle is waited for any more, whether one was dragged or not.

        Returns:
            False where no cloud is on the screen.
        """
        with self._lock:
            self.end()
            if not self._clouds.shown():
                return False
            self._taken, self._ended, self._held_before = taken, ended, self._clouds.held
            self._clouds.hold(still=True)
            self._server.scene.on_rect_select()(self._selected)
            return True

    def end(self) -> None:
        """Wait no longer; the clouds go on, unless they were held before."""
        with self._lock:
            ended, self._ended = self._ended, None
            if ended is not None:
                self._server.scene.remove_rect_select_callback(self._selected)
                self._clouds.hold(self._held_before)
                ended()

    def _selected(self, event: viser.SceneRectSelectEvent) -> None:
        part = Rectangle(*event.screen_min, *event.screen_max)
        found = patches(self._clouds.shown(), lens_of(event.client.camera), part, self._clouds.disc)
        with self._lock:
            if self._ended is None:
                return  # somebody has just called it off
            taken = self._taken
            self.end()
        taken(found)
