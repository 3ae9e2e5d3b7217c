"""Objects that were found, in the scene: shape, triad, label, and how sure their place is."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING

import numpy as np

from zsight.catalogue import type_files
from zsight.things import things_of
from zsight.viewer.frames import place

if TYPE_CHECKING:
    import viser
    from numpy.typing import NDArray

    from zsight.things import Thing
    from zsight.viewer.clouds import Clouds
    from zsight.viewer.frames import Frames
    from zsight_protocol.find_object import DetectedObject, FindObjectResult

__all__ = ["FoundObjects", "ellipsoid"]

_DEVIATIONS = 3.0  # standard deviations that the ellipsoid reaches
_REJECTED = (90, 90, 90)


class FoundObjects:
    """The last answer for each type."""

    def __init__(self, server: viser.ViserServer, frames: Frames, clouds: Clouds) -> None:
        """Args: server of the page; frames that place the objects; clouds in whose frames candidates are told."""
        self._server, self._frames, self._clouds = server, frames, clouds
        self._rejected = server.gui.add_checkbox("Rejected", False, hint="Candidates that were looked at and rejected")
        self._rejected.on_update(lambda _: self._redraw())
        server.gui.add_button("Clear found objects").on_click(lambda _: self.clear())
        self._catalogue = type_files.load(type_files.shipped_folder())
        self._results: dict[str, FindObjectResult] = {}
        self._nodes: list[str] = []
        self._places: list[NDArray[np.float64]] = []
        self._generation = frames.generation
        self._lock = threading.RLock()

    def show(self, object_type: str, result: FindObjectResult) -> None:
        """Draw an answer in place of the last one for this type."""
        with self._lock:
            self._results[object_type] = result
            self._draw()

    def clear(self) -> None:
        """Forget all."""
        with self._lock:
            self._results.clear()
            self._draw()

    def places(self) -> NDArray[np.float64]:
        """Centres (N, 3) of the objects that are drawn, in the fixed frame, metres."""
        with self._lock:
            return np.array(self._places).reshape(-1, 3)

    def update(self) -> None:
        """Draw anew where the fixed frame has changed."""
        if self._generation != self._frames.generation:
            self._generation = self._frames.generation
            self._redraw()

    def _redraw(self) -> None:
        with self._lock:
            self._draw()

    def _draw(self) -> None:
        for node in self._nodes:
            self._server.scene.remove_by_name(node)
        self._nodes, self._places = [], []
        for asked, result in self._results.items():
            T_fixed_answer = self._frames.T_fixed(result.header.frame_id, result.header.stamp.ns)
            if T_fixed_answer is not None:
                for found, thing in zip(result.objects, things_of(asked, result, self._catalogue), strict=True):
                    self._draw_one(found, thing, T_fixed_answer)
            if self._rejected.value:
                self._draw_rejected(result)

    def _draw_rejected(self, result: FindObjectResult) -> None:
        """Where candidates were seen, with what they were taken for; told in the frame of the cloud."""
        T = next((shown.T_fixed_cloud for shown in self._clouds.shown()), None)
        candidates = result.report.get("rejected")
        if T is None or not isinstance(candidates, list):
            return
        for candidate in candidates:
            node = f"/found/{len(self._nodes)}"
            self._nodes.append(node)
            place_of = T[:3, :3] @ np.array(candidate["position"]) + T[:3, 3]  # type: ignore[index,call-overload]  # JSON
            words = f"{candidate['type']} {candidate['probability']:.0%}, rejected"  # type: ignore[index,call-overload]  # JSON
            self._server.scene.add_icosphere(node, 0.006, _REJECTED, subdivisions=1, position=place_of)
            self._server.scene.add_label(f"{node}/label", words, font_screen_scale=0.7, anchor="top-center")

    def _draw_one(self, found: DetectedObject, thing: Thing, T_fixed_answer: NDArray[np.float64]) -> None:
        scene, node = self._server.scene, f"/found/{len(self._nodes)}"
        self._nodes.append(node)
        T = T_fixed_answer @ thing.T_frame_thing
        self._places.append(T[:3, 3])
        length = float(np.clip(0.9 * max(found.size), 0.05, 0.2))
        scene.add_frame(node, axes_length=length, axes_radius=length / 30, **place(T))
        scene.add_mesh_simple(
            f"{node}/shape",
            thing.vertices,
            thing.faces,
            color=thing.colour,
            opacity=0.55,
            flat_shading=True,
            side="double",
        )
        top = (0.0, 0.0, max(found.size) / 2 + 0.02)
        scene.add_label(f"{node}/label", thing.words, position=top, font_screen_scale=0.9, anchor="bottom-center")
        T_answer_axes, radii = ellipsoid(np.reshape(found.covariance, (6, 6))[:3, :3])
        T_fixed_axes = np.eye(4)
        T_fixed_axes[:3, :3] = T_fixed_answer[:3, :3] @ T_answer_axes
        T_fixed_axes[:3, 3] = T[:3, 3]
        sure = f"{node}_sure"
        self._nodes.append(sure)
        scene.add_icosphere(sure, 1.0, (204, 121, 167), scale=radii, opacity=0.6, subdivisions=2, **place(T_fixed_axes))


def ellipsoid(covariance: NDArray[np.float64]) -> tuple[NDArray[np.float64], tuple[float, float, float]]:
    """Axes (3, 3), a rotation, and half lengths of the ellipsoid of three standard deviations, metres.

    Args:
        covariance: (3, 3) of a position, square metres.
    """
    values, axes = np.linalg.eigh((covariance + covariance.T) / 2)
    if np.linalg.det(axes) < 0:
        axes[:, 0] = -axes[:, 0]
    x, y, z = (_DEVIATIONS * float(np.sqrt(max(value, 0.0))) for value in values)
    return axes, (x, y, z)
