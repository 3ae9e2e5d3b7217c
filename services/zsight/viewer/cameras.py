"""The cameras themselves: a frustum for each that tells its calibration, with its picture where the cloud has one."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

import numpy as np

from zsight.convert import points_of
from zsight.viewer.frames import place
from zsight_core.points import colours, has_colour, is_organised
from zsight_protocol.camera_info import CameraInfo
from zsight_protocol.channels import Delivery

if TYPE_CHECKING:
    import viser
    from numpy.typing import NDArray

    from zsight.bus import Bus
    from zsight.viewer.clouds import Clouds
    from zsight.viewer.frames import Frames

__all__ = ["Cameras"]

_PERIOD = 1.0  # seconds between two pictures in a frustum
_ACROSS = 160  # pixels of it
_SCALE = 0.15


class Cameras:
    """A frustum a camera."""

    def __init__(self, server: viser.ViserServer, bus: Bus, frames: Frames, clouds: Clouds) -> None:
        """Args: server of the page; bus; frames; clouds that the pictures are taken from."""
        self._server, self._frames, self._clouds = server, frames, clouds
        self._prefix = f"{bus.cell.namespace}/"
        self._infos = bus.reader(bus.cell.camera_info("*"), CameraInfo, delivery=Delivery.LATCHED)
        self._known: dict[str, CameraInfo] = {}
        self._shown = server.gui.add_checkbox("Cameras", True, hint="Where they stand, and what they see")
        self._shown.on_update(lambda _: self._draw())
        self._next = 0.0

    def update(self) -> None:
        """Take in calibrations; draw once a second."""
        while (received := self._infos.take(0)) is not None:
            self._known[received.key.removeprefix(self._prefix).split("/")[0]] = received.message
        if time.monotonic() >= self._next and self._server.get_clients():
            self._next = time.monotonic() + _PERIOD
            self._draw()

    def _draw(self) -> None:
        for camera, info in self._known.items():
            node = f"/cameras/{camera}"
            T = self._frames.T_fixed(info.header.frame_id)
            if T is None or not self._shown.value or info.k[4] <= 0:
                self._server.scene.remove_by_name(node)
                continue
            self._server.scene.add_camera_frustum(
                node,
                fov=2 * float(np.arctan(info.height / 2 / info.k[4])),
                aspect=info.width / info.height,
                scale=_SCALE,
                thickness=0.003,
                color=(0, 114, 178),
                image=self._picture(camera),
                **place(T),
            )

    def _picture(self, camera: str) -> NDArray[np.uint8] | None:
        cloud = self._clouds.newest(camera)
        if cloud is None:
            return None
        points = points_of(cloud)
        if not has_colour(points) or not is_organised(points):
            return None
        step = max(1, points.shape[1] // _ACROSS)
        return colours(points[::step, ::step])
