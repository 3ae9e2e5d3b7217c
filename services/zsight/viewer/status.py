"""The line on top of the page: what is there, what is missing, and how to start it."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import viser

    from zsight.bus import Bus
    from zsight.viewer.clouds import Clouds

__all__ = ["StatusLine", "missing_router"]

_STOPPED = 2.0  # seconds without a cloud until a camera counts as stopped
_PERIOD = 0.5  # seconds between two looks


def missing_router(endpoints: tuple[str, ...]) -> str:
    """What to say where no router answers."""
    return (
        f"**Nothing is running** at {', '.join(endpoints)}.\n\n"
        "Start a cell with `zsight up`, or name another router with `zsight view --connect ENDPOINT`. "
        "This page goes on by itself as soon as one answers."
    )


class StatusLine:
    """Says how the cameras are."""

    def __init__(self, words: viser.GuiMarkdownHandle, bus: Bus, clouds: Clouds, *, read_only: bool) -> None:
        """Args: words on top of the page; bus; clouds; whether the page only shows."""
        self._words, self._bus, self._clouds, self._read_only = words, bus, clouds, read_only
        self._next = 0.0

    def update(self) -> None:
        """Look again."""
        if time.monotonic() < self._next:
            return
        self._next = time.monotonic() + _PERIOD
        lines = self._lines()
        if self._clouds.held:
            lines.append("**Held still:** the clouds on the screen do not change.")
        if self._read_only:
            lines.append("*Read only.*")
        content = "\n\n".join(lines)
        if self._words.content != content:
            self._words.content = content

    def _lines(self) -> list[str]:
        if not self._bus.link.connected():
            return ["**The router is gone.** Start it again with `zsight up`; this page goes on by itself."]
        cameras = self._clouds.cameras()
        if not cameras:
            return ["**No camera publishes.** Start one with `zsight run camera`, or a whole cell with `zsight up`."]
        return [self._camera(name, age) for name, age in cameras.items()]

    def _camera(self, name: str, age: float) -> str:
        if age > _STOPPED:
            return f"**{name}: no new cloud for {age:.0f} s.** Has the camera stopped? See the tab Health."
        if name in (unplaced := self._clouds.unplaced()):
            return f"**{name}: not drawn.** No transform leads from {unplaced[name]} to the fixed frame."
        shown = next((shown for shown in self._clouds.shown() if shown.camera == name), None)
        if shown is None:
            return f"**{name}:** live"
        cloud = shown.cloud
        points = cloud.height * cloud.width
        size = f"{cloud.width} x {cloud.height}, " if cloud.height > 1 else ""
        drawn = f"{shown.drawn:,} of " if shown.drawn < points else ""
        return f"**{name}:** live, {size}{drawn}{points:,} point{'s' * (points != 1)} drawn, colour {shown.colouring}"
