"""Select points with a rectangle: they go out as a patch, and the plane finder answers."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING

from viser import Icon

from zsight.convert import matrix_of
from zsight.viewer.frames import place
from zsight.words import numbers
from zsight_protocol.channels import Delivery
from zsight_protocol.geometry import Plane
from zsight_protocol.point_cloud import PointCloud2

if TYPE_CHECKING:
    from collections.abc import Callable

    import viser

    from zsight.bus import Bus, Writer
    from zsight.viewer.clouds import Clouds
    from zsight.viewer.frames import Frames
    from zsight.viewer.patches import Patch
    from zsight.viewer.rectangle import RectangleGesture

__all__ = ["Selection"]

_PATIENCE = 3.0  # seconds until the words say that no plane came
_BEGIN, _STOP = "Select a rectangle", "Stop selecting"
_HOW = "Press the button, then drag a rectangle over a flat place. The clouds hold still meanwhile."


class Selection:
    """The panel of selections, and what comes back."""

    def __init__(
        self,
        server: viser.ViserServer,
        bus: Bus,
        frames: Frames,
        clouds: Clouds,
        gesture: RectangleGesture,
        *,
        asks: bool,
    ) -> None:
        """Args: server of the page; bus; frames; clouds; gesture that selects; asks: false shows planes only."""
        self.last: Patch | None = None
        self._server, self._bus, self._frames, self._clouds, self._gesture = server, bus, frames, clouds, gesture
        self._planes = bus.reader(bus.cell.plane("*"), Plane, delivery=Delivery.EVERY)
        self._plane: Plane | None = None
        self._writers: dict[str, Writer[PointCloud2]] = {}
        self._lock = threading.Lock()
        self._waiting = threading.Event()
        self._generation = frames.generation
        gui = server.gui
        if asks:
            self._button = gui.add_button(_BEGIN, icon=Icon.MARQUEE_2, hint="Or press R")
            self._button.on_click(lambda _: self._toggle())
            gui.add_command(_BEGIN, hotkey="R").on_trigger(lambda _: self._toggle())
        self._words = gui.add_markdown(_HOW if asks else "Planes that others select are shown here.")
        gui.add_button("Clear", hint="Forget the plane").on_click(lambda _: self._clear())

    def _toggle(self) -> None:
        if self._button.label == _STOP:
            self._gesture.end()
        elif self._gesture.begin(self._selected, self._ended):
            self._button.label = _STOP
            self._words.content = "**Drag a rectangle** in the picture. The clouds hold still."
        else:
            self._words.content = "There is no cloud on the screen to select from: is a camera running, and shown?"

    def _ended(self) -> None:
        self._button.label = _BEGIN

    def _selected(self, found: list[Patch]) -> None:
        if not found:
            self._words.content = "No point was seen in this rectangle."
            return
        self.last = max(found, key=lambda patch: len(patch.xyz_fixed))
        self._waiting.set()
        for patch in found:
            self._send(patch)

    def _send(self, patch: Patch) -> None:
        camera = patch.shown.camera
        with self._lock:
            if camera not in self._writers:
                self._writers[camera] = self._bus.writer(self._bus.cell.selected_points(camera), PointCloud2)
        count = f"{patch.message.width:,} points of {camera}"
        writer = self._writers[camera]
        if not self._soon(writer.has_readers):
            self._words.content = (
                f"**{count}** selected; nobody reads them. Start the plane finder with `zsight run planes`."
            )
        else:
            self._words.content = f"**{count}** selected, waiting for their plane ..."
            threading.Timer(_PATIENCE, self._complain, (count,)).start()
        writer.send(patch.message)

    def _soon(self, happened: Callable[[], bool]) -> bool:
        """A matching reader is known at once, or after a round trip."""
        return any(happened() or self._bus.stopping.wait(0.01) for _ in range(100))

    def _complain(self, count: str) -> None:
        if self._waiting.is_set():
            self._words.content = (
                f"**{count}** selected; no plane came within {_PATIENCE:g} s. The log of the planes service says why."
            )

    def ask_again(self) -> None:
        """Send the last patch once more, for a plane finder that was set differently."""
        if self.last is not None:
            self._waiting.set()
            self._send(self.last)

    def update(self) -> None:
        """Show the planes that came."""
        while (received := self._planes.take(0)) is not None:
            self._plane = received.message
            self._waiting.clear()
            self._words.content = _describe(received.message, self.last)
            self._draw()
        if self._generation != self._frames.generation:
            self._generation = self._frames.generation
            self._draw()

    def _draw(self) -> None:
        if self._plane is None:
            return
        T = self._frames.T_fixed(self._plane.header.frame_id, self._plane.header.stamp.ns)
        if T is not None:
            T_fixed_plane = T @ matrix_of(self._plane.pose)
            self._server.scene.add_frame("/plane", axes_length=0.1, axes_radius=0.003, **place(T_fixed_plane))

    def _clear(self) -> None:
        self._plane = None
        self._server.scene.remove_by_name("/plane")
        self._clouds.clear_planes()
        self._words.content = _HOW


def _describe(plane: Plane, patch: Patch | None) -> str:
    n = plane.normal
    selected = f"{patch.message.width:,} points selected; " if patch is not None else ""
    return (
        f"{selected}**{plane.inliers:,} lie in their plane**\n\n"
        "| | |\n|---|---|\n"
        f"| normal | {numbers((n.x, n.y, n.z))} |\n"
        f"| distance | {plane.distance:.4f} m |\n"
        f"| tolerance | {plane.tolerance * 1e3:.1f} mm |\n"
        f"| rms | {plane.rms * 1e3:.2f} mm |\n"
        f"| frame | {plane.header.frame_id} |\n"
    )
