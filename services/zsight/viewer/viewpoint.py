"""Where the browser looks from: a view of the first cloud to begin with, and buttons for others."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from zsight.convert import points_of
from zsight_core.thin import thin
from zsight_core.transform import transform_xyz

if TYPE_CHECKING:
    import viser
    from numpy.typing import NDArray

    from zsight.viewer.clouds import Clouds, Shown
    from zsight.viewer.frames import Frames

__all__ = ["Viewpoint"]

_SOME = 5000  # points that tell where a cloud is


class Viewpoint:
    """Moves the camera of a browser."""

    def __init__(self, server: viser.ViserServer, frames: Frames, clouds: Clouds) -> None:
        """Args: server of the page; frames that say where up is; clouds that are looked at."""
        self._server, self._frames, self._clouds = server, frames, clouds
        self._begun = False
        buttons = server.gui.add_button_group("Look from", ("sensor", "beside", "above"))
        buttons.on_click(lambda event: self._look(event.client, str(buttons.value)))

    def update(self) -> None:
        """Begin with a view of the first cloud, in browsers that are open and in those to come."""
        if self._begun or not (shown := self._clouds.shown()):
            return
        self._begun = True
        eye, aim = _eye(shown[0], "beside", np.array(self._frames.up))
        self._server.initial_camera.up = self._frames.up
        self._server.initial_camera.position = eye
        self._server.initial_camera.look_at = aim
        for client in self._server.get_clients().values():
            self._look(client, "beside")

    def _look(self, client: viser.ClientHandle | None, side: str) -> None:
        shown = self._clouds.shown()
        if client is None or not shown:
            return
        up = np.array(self._frames.up)
        eye, aim = _eye(shown[0], side, up)
        with client.atomic():
            client.camera.up_direction = up
            client.camera.position = eye
            client.camera.look_at = aim


def _eye(shown: Shown, side: str, up: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Where the eye is and what it looks at, in the fixed frame, metres."""
    sensor = shown.T_fixed_cloud[:3, 3]
    _, xyz = thin(points_of(shown.cloud), _SOME)
    placed = transform_xyz(shown.T_fixed_cloud, xyz.astype(np.float64)) if len(xyz) else sensor[np.newaxis] + 1.0
    aim = np.median(placed, axis=0)
    away = sensor - aim
    distance = max(float(np.linalg.norm(away)), 0.1)
    if side == "above":
        return aim + 1.2 * distance * up + 0.02 * away, aim
    if side == "beside":
        return aim + 1.3 * _turned(away, up), aim
    return sensor + 0.02 * away / distance, aim


def _turned(vector: NDArray[np.floating], up: NDArray[np.float64]) -> NDArray[np.float64]:
    """A vector turned by half a right angle about up (Rodrigues)."""
    c = s = np.sqrt(0.5)
    return np.asarray(c * vector + s * np.cross(up, vector) + (1 - c) * (up @ vector) * up)
