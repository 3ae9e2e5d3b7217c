"""Select points with a rectangle: they go out as a patch, and the plane finder answers."""

from __future__ import annotations

import threading
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from viser import Icon

from zsight.convert import cloud_from_points, matrix_of, points_of
from zsight.viewer.frames import place
from zsight_core.points import xyz
from zsight_core.transform import from_quaternion, inverse, transform_xyz
from zsight_core.visible import Lens, Rectangle, visible
from zsight_protocol.channels import Delivery
from zsight_protocol.geometry import Plane
from zsight_protocol.point_cloud import PointCloud2

if TYPE_CHECKING:
    from collections.abc import Callable

    import viser
    from numpy.typing import NDArray

    from zsight.bus import Bus, Writer
    from zsight.viewer.clouds import Clouds, Shown
    from zsight.viewer.frames import Frames

__all__ = ["Patch", "Selection", "patches"]

_PATIENCE = 3.0  # seconds until the words say that no plane came
_HOW = "Press the button, then drag a rectangle over a flat place. The clouds hold still meanwhile."


@dataclass(frozen=True, eq=False)
class Patch:
    """The points of one cloud that were seen in a rectangle: (1, M) in the cloud's frame, (M, 3) in the fixed one."""

    shown: Shown
    message: PointCloud2
    xyz_fixed: NDArray[np.floating]


def patches(clouds: list[Shown], lens: Lens, part: Rectangle, disc: float) -> list[Patch]:
    """What is seen of each cloud in a part of the picture; clouds hide each other.

    Args:
        clouds: on the screen; chosen among are all their points, not only those that are drawn.
        lens: the eye, in the fixed frame.
        part: the rectangle.
        disc: diameter that a point is drawn with, metres.
    """
    if not clouds:
        return []
    points = [points_of(shown.cloud) for shown in clouds]
    placed = [
        transform_xyz(shown.T_fixed_cloud, xyz(each).reshape(-1, 3).astype(np.float64))
        for shown, each in zip(clouds, points, strict=True)
    ]
    mask = visible(np.concatenate(placed), lens, part, disc)
    ends = np.cumsum([len(each) for each in placed])[:-1]
    found = []
    for shown, each, moved, chosen in zip(clouds, points, placed, np.split(mask, ends), strict=True):
        if chosen.any():
            header = shown.cloud.header
            patch = cloud_from_points(each[chosen.reshape(each.shape)][np.newaxis], header.stamp, header.frame_id)
            found.append(Patch(shown, patch, moved[chosen]))
    return found


class Selection:
    """The panel of selections, and what comes back."""

    def __init__(self, server: viser.ViserServer, bus: Bus, frames: Frames, clouds: Clouds, *, asks: bool) -> None:
        """Args: server of the page; bus; frames; clouds that are selected from; asks: false shows planes only."""
        self.last: Patch | None = None
        self._server, self._bus, self._frames, self._clouds = server, bus, frames, clouds
        self._planes = bus.reader(bus.cell.plane("*"), Plane, delivery=Delivery.EVERY)
        self._plane: Plane | None = None
        self._writers: dict[str, Writer[PointCloud2]] = {}
        self._lock = threading.Lock()
        self._waiting = threading.Event()
        self._generation = frames.generation
        gui = server.gui
        if asks:
            self._button = gui.add_button("Select a rectangle", icon=Icon.MARQUEE_2, hint="Or press R")
            self._button.on_click(lambda _: self._toggle())
            gui.add_command("Select a rectangle", hotkey="R").on_trigger(lambda _: self._toggle())
        self._words = gui.add_markdown(_HOW if asks else "Planes that others select are shown here.")
        gui.add_button("Clear", hint="Forget the plane").on_click(lambda _: self._clear())
        self._selecting = False

    def _toggle(self) -> None:
        self._end() if self._selecting else self._begin()

    def _begin(self) -> None:
        with self._lock:
            self._selecting = True
        if not self._clouds.shown():
            self._words.content = "There is no cloud on the screen to select from: is a camera running, and shown?"
            self._selecting = False
            return
        self._clouds.hold(still=True)
        self._button.label = "Stop selecting"
        self._words.content = "**Drag a rectangle** in the picture. The clouds hold still."
        self._server.scene.on_rect_select()(self._selected)

    def _end(self) -> None:
        with self._lock:
            if not self._selecting:
                return
            self._selecting = False
        self._server.scene.remove_rect_select_callback(self._selected)
        self._button.label = "Select a rectangle"
        self._clouds.hold(still=False)

    def _selected(self, event: viser.SceneRectSelectEvent) -> None:
        shown = self._clouds.shown()
        part = Rectangle(*event.screen_min, *event.screen_max)
        found = patches(shown, lens_of(event.client.camera), part, self._clouds.disc)
        self._end()
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


def lens_of(camera: viser.CameraHandle) -> Lens:
    """The eye of a browser, in the fixed frame."""
    w, x, y, z = camera.wxyz
    tangent = float(np.tan(camera.fov / 2))
    return Lens(inverse(from_quaternion(camera.position, (x, y, z, w))), tangent * camera.aspect, tangent)


def _describe(plane: Plane, patch: Patch | None) -> str:
    n = plane.normal
    selected = f"{patch.message.width:,} points selected; " if patch is not None else ""
    return (
        f"{selected}**{plane.inliers:,} lie in their plane**\n\n"
        "| | |\n|---|---|\n"
        f"| normal | ({n.x:.4f}, {n.y:.4f}, {n.z:.4f}) |\n"
        f"| distance | {plane.distance:.4f} m |\n"
        f"| tolerance | {plane.tolerance * 1e3:.1f} mm |\n"
        f"| rms | {plane.rms * 1e3:.2f} mm |\n"
        f"| frame | {plane.header.frame_id} |\n"
    )
