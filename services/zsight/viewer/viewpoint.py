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

__all__ = ["Viewpoint"]

_SOME = 5000  # points that tell where a cloud is


class Viewpoint:
    """Moves the camera of a browser."""

    def __init__(self, server: viser.ViserServer, clouds: Clouds) -> None:
        """Args: server of the page; clouds that are looked at."""
        self._server, self._clouds = server, clouds
        self._begun = False
        buttons = server.gui.add_button_group("Look from", ("sensor", "beside", "above"))
        buttons.on_click(lambda event: self._look(event.client, str(buttons.value)))

    def update(self) -> None:
        """Begin with a view of the first cloud, in browsers that are open and in those to come."""
        if self._begun or not (shown := self._clouds.shown()):
            return
        self._begun = True
        eye, aim = _eye(shown[0], "beside")
        self._server.initial_camera.position = eye
        self._server.initial_camera.look_at = aim
        for client in self._server.get_clients().values():
            self._look(client, "beside")

    def _look(self, client: viser.ClientHandle | None, side: str) -> None:
        shown = self._clouds.shown()
        if client is None or not shown:
            return
        eye, aim = _eye(shown[0], side)
        with client.atomic():
            client.camera.position = eye
            client.camera.look_at = aim


def _eye(shown: Shown, side: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Where the eye is and what it looks at, in the fixed frame, metres."""
    sensor = shown.T_fixed_cloud[:3, 3]
    _, xyz = thin(points_of(shown.cloud), _SOME)
    placed = transform_xyz(shown.T_fixed_cloud, xyz.astype(np.float64)) if len(xyz) else sensor[np.newaxis] + 1.0
    aim = np.median(placed, axis=0)
    away = sensor - aim
    distance = max(float(np.linalg.norm(away)), 0.1)
    if side == "above":
        return aim + np.array([0.0, -0.02, 1.2]) * distance, aim
    if side == "beside":
        return aim + 1.3 * _turned(away), aim
    return sensor + 0.02 * away / distance, aim


def _turned(away: NDArray[np.floating]) -> NDArray[np.float64]:
    """Half a right angle about the vertical."""
    c, s = np.cos(np.pi / 4), np.sin(np.pi / 4)
    return np.array([c * away[0] - s * away[1], s * away[0] + c * away[1], away[2]])
