"""The clouds of all cameras in the scene: the newest of each, within a budget of points, or held still."""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from zsight.convert import points_of
from zsight.viewer.colouring import Colouring, coloured
from zsight.viewer.frames import place
from zsight.viewer.server import set_value
from zsight_core.errors import CoreError
from zsight_core.thin import thin
from zsight_core.transform import transform_xyz
from zsight_protocol.channels import Delivery
from zsight_protocol.point_cloud import PointCloud2

if TYPE_CHECKING:
    import viser
    from numpy.typing import NDArray

    from zsight.bus import Bus, Reader
    from zsight.viewer.frames import Frames
    from zsight.viewer.settings import Settings

__all__ = ["CloudKind", "Clouds", "Shown"]

_ORANGE, _SKY = (230, 159, 0), (86, 180, 233)  # two that everybody tells apart (Okabe and Ito 2008)


@dataclass(frozen=True)
class CloudKind:
    """A channel of clouds and how it is drawn; without a colour of its own as the user wishes."""

    name: str
    channel: str
    shown: bool
    colour: tuple[int, int, int] | None = None
    size: float = 1.0


KINDS = (
    CloudKind("Clouds", "points", True),
    CloudKind("Voxel clouds", "points/voxel", False, size=2.0),
    CloudKind("Points of the plane", "plane/points", True, _ORANGE, 1.3),
    CloudKind("Points above the plane", "plane/above", True, _SKY, 1.3),
)


@dataclass(frozen=True, eq=False)
class Shown:
    """A cloud that is on the screen: its message, where it stands, how many of its points are drawn."""

    camera: str
    cloud: PointCloud2
    T_fixed_cloud: NDArray[np.float64]
    drawn: int
    colouring: Colouring


class Clouds:
    """What is drawn of every camera; one thread for each kind of cloud."""

    def __init__(self, server: viser.ViserServer, bus: Bus, frames: Frames, settings: Settings) -> None:
        """Args: server of the page; bus; frames that place the clouds; settings with the rate and the budget."""
        self._server, self._bus, self._frames, self._settings = server, bus, frames, settings
        self._newest: dict[tuple[CloudKind, str], PointCloud2] = {}
        self._shown: dict[tuple[CloudKind, str], Shown] = {}
        self._unplaced: dict[str, str] = {}
        self._arrived: dict[str, float] = {}
        self._planes_hidden = False
        self._lock = threading.RLock()
        gui = server.gui
        self._wish = gui.add_dropdown("Colour by", tuple(Colouring), hint="Height where a cloud has nothing else")
        self._size = gui.add_slider("Point size", 1.0, 30.0, 0.5, 6.0, hint="Millimetres")
        self._boxes = {kind: gui.add_checkbox(kind.name, kind.shown) for kind in KINDS}
        self._hold = gui.add_checkbox("Hold still", False, hint="Keep the clouds that are on the screen")
        self._wish.on_update(lambda _: self.redraw())
        self._size.on_update(lambda _: self.redraw())
        for box in (*self._boxes.values(), self._hold):
            box.on_update(lambda _: self.redraw())
        self._generation = frames.generation
        for kind in KINDS:
            key = f"{bus.cell.namespace}/*/{kind.channel}"
            reader = bus.reader(key, PointCloud2, delivery=Delivery.LATEST)
            threading.Thread(target=self._follow, args=(kind, reader), name=kind.name, daemon=True).start()

    @property
    def disc(self) -> float:
        """Diameter that points are drawn with, metres."""
        return float(self._size.value) / 1e3

    @property
    def held(self) -> bool:
        """Whether the clouds are held still."""
        return bool(self._hold.value)

    def hold(self, still: bool) -> None:
        """Hold the clouds still, or let them go on."""
        set_value(self._hold, still)

    def shown(self) -> list[Shown]:
        """The cameras' own clouds that are on the screen."""
        with self._lock:
            return [shown for (kind, _), shown in self._shown.items() if kind is KINDS[0]]

    def newest(self, camera: str) -> PointCloud2 | None:
        """The newest cloud of a camera; the one on the screen while it is held still."""
        with self._lock:
            shown = self._shown.get((KINDS[0], camera))
            return shown.cloud if self.held and shown is not None else self._newest.get((KINDS[0], camera))

    def cameras(self) -> dict[str, float]:
        """Every camera that a cloud came from, and how many seconds ago the last one came."""
        now = time.monotonic()
        return {camera: now - arrived for camera, arrived in sorted(self._arrived.items())}

    def hide_planes(self, hidden: bool) -> None:
        """Leave out the points of planes, or draw them again, while something else has their colours."""
        if hidden != self._planes_hidden:
            self._planes_hidden = hidden
            self.redraw()

    def clear_planes(self) -> None:
        """Forget the points of planes."""
        with self._lock:
            for key in [key for key in self._newest if key[0].colour is not None]:
                del self._newest[key]
                self._remove(*key)

    def unplaced(self) -> dict[str, str]:
        """Cameras whose clouds cannot be drawn, and the frames that lead nowhere."""
        return dict(self._unplaced)

    def redraw(self) -> None:
        """Draw all anew: how they are to look has changed."""
        with self._lock:
            for (kind, camera), cloud in list(self._newest.items()):
                shown = self._shown.get((kind, camera))
                self._draw(kind, camera, shown.cloud if self.held and shown is not None else cloud)

    def update(self) -> None:
        """Draw anew where the fixed frame has changed, and what grows older."""
        if self._generation != self._frames.generation or (self._wish.value == Colouring.AGE and not self.held):
            self._generation = self._frames.generation
            self.redraw()

    def _follow(self, kind: CloudKind, reader: Reader[PointCloud2]) -> None:
        """Draw the newest cloud of every camera, no faster than the rate; in between only the newest is kept."""
        while (received := reader.take()) is not None:
            while received is not None:
                camera = received.key.removeprefix(f"{self._bus.cell.namespace}/").split("/")[0]
                self._arrive(kind, camera, received.message)
                received = reader.take(0)
            if self._bus.stopping.wait(1 / self._settings.rate):
                return

    def _arrive(self, kind: CloudKind, camera: str, cloud: PointCloud2) -> None:
        self._frames.heard(cloud.header.frame_id)
        with self._lock:
            self._newest[kind, camera] = cloud
            if kind is KINDS[0]:
                self._arrived[camera] = time.monotonic()
            if self._server.get_clients() and not (self.held and (kind, camera) in self._shown and not kind.colour):
                self._draw(kind, camera, cloud)

    def _draw(self, kind: CloudKind, camera: str, cloud: PointCloud2) -> None:
        if not self._boxes[kind].value or (self._planes_hidden and kind.colour is not None):
            self._remove(kind, camera)
            return
        T = self._frames.T_fixed(cloud.header.frame_id, cloud.header.stamp.ns)
        if T is None:
            self._unplaced[camera] = cloud.header.frame_id
            self._remove(kind, camera)
            return
        self._unplaced.pop(camera, None)
        try:
            points, xyz = thin(points_of(cloud), self._settings.budget)
        except CoreError:
            return
        age = max(0.0, (time.time_ns() - cloud.header.stamp.ns) / 1e9)
        colours, colouring = coloured(points, transform_xyz(T, xyz) @ self._frames.up, age, Colouring(self._wish.value))
        self._shown[kind, camera] = Shown(camera, cloud, T, len(xyz), colouring)
        self._server.scene.add_point_cloud(
            _node(kind, camera),
            xyz,
            np.array(kind.colour, np.uint8) if kind.colour else colours,
            point_size=self.disc * kind.size,
            point_shape="circle",
            point_shading="flat",
            precision="float32",
            **place(T),
        )

    def _remove(self, kind: CloudKind, camera: str) -> None:
        if self._shown.pop((kind, camera), None) is not None:
            self._server.scene.remove_by_name(_node(kind, camera))


def _node(kind: CloudKind, camera: str) -> str:
    return f"/clouds/{camera}/{kind.channel.replace('/', '_')}"
