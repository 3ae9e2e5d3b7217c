"""What the finders see in the clouds: surfaces with outlines, segments, unknown obstacles, places without depth."""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from zsight.convert import matrix_of
from zsight.viewer.box_lines import corners_of, edges_of
from zsight.viewer.frames import place
from zsight_protocol.channels import Delivery
from zsight_protocol.scene import Scene

if TYPE_CHECKING:
    from collections.abc import Callable

    import viser
    from numpy.typing import NDArray

    from zsight.bus import Bus
    from zsight.viewer.frames import Frames
    from zsight_protocol.scene import MissingDepth, SceneSegment, SupportSurface

__all__ = ["Pick", "SceneLayer"]

_PERIOD = 0.5  # seconds between two pictures of a scene
_SURFACE, _KNOWN, _UNKNOWN, _MISSING = (0, 114, 178), (0, 158, 115), (213, 94, 0), (204, 121, 167)
_BESIDE = 0.01  # metres that the centre of an object may lie beside the box around what is seen of it
_ABOVE = 0.5  # metres above a surface that belong to it


@dataclass(frozen=True, eq=False)
class Pick:
    """What was clicked: its name, and the corners (8, 3) of the space that it fills, in the fixed frame."""

    name: str
    is_surface: bool
    camera: str
    label: int
    corners: NDArray[np.float64]


class SceneLayer:
    """Draws the newest scene of every camera; what is clicked in it is handed on."""

    def __init__(self, server: viser.ViserServer, bus: Bus, frames: Frames) -> None:
        """Args: server of the page; bus; frames that place the scenes."""
        self.on_pick: Callable[[Pick], None] = lambda _: None
        self.explained: Callable[[], NDArray[np.float64]] = lambda: np.zeros((0, 3))  # centres of found objects
        self._server, self._frames = server, frames
        self._prefix = f"{bus.cell.namespace}/"
        self._reader = bus.reader(bus.cell.scene("*"), Scene, delivery=Delivery.EVERY)
        self._scenes: dict[str, Scene] = {}
        self._nodes: set[str] = set()
        self._places = np.zeros((0, 3))
        self._lock = threading.RLock()
        self._next, self._is_stale = 0.0, False
        gui = server.gui
        self._surfaces = gui.add_checkbox("Surfaces", True, hint="What things stand on; click one to seek only there")
        self._segments = gui.add_checkbox("Segments", True, hint="What stands there; click one to ask what it is")
        self._missing = gui.add_checkbox("Missing depth", False, hint="Where nothing was measured")
        for box in (self._surfaces, self._segments, self._missing):
            box.on_update(lambda _: self.draw())

    def update(self) -> None:
        """Take in scenes and what was found, and draw the newest."""
        while (received := self._reader.take(0)) is not None:
            self._scenes[received.key.removeprefix(self._prefix).split("/")[0]] = received.message
            self._is_stale = True
        places = self.explained()
        if not np.array_equal(places, self._places):
            self._places, self._is_stale = places, True
        if self._is_stale and time.monotonic() >= self._next:
            self._next, self._is_stale = time.monotonic() + _PERIOD, False
            self.draw()

    def surfaces(self) -> list[tuple[NDArray[np.float64], NDArray[np.float64]]]:
        """Of every surface T_fixed_surface (4, 4), with z up from it, and its outline (K, 2) in that frame, metres."""
        found: list[tuple[NDArray[np.float64], NDArray[np.float64]]] = []
        for scene in list(self._scenes.values()):
            T = self._frames.T_fixed(scene.header.frame_id, scene.header.stamp.ns)
            if T is not None:
                found += [(T @ matrix_of(s.pose), np.array(s.outline).reshape(-1, 2)) for s in scene.supports]
        return found

    def draw(self) -> None:
        """Draw all scenes; what is no longer there goes."""
        with self._lock:
            before, self._nodes = self._nodes, set()
            for camera, scene in self._scenes.items():
                T = self._frames.T_fixed(scene.header.frame_id, scene.header.stamp.ns)
                if T is not None:
                    self._draw_scene(camera, scene, T)
            for gone in before - self._nodes:
                self._server.scene.remove_by_name(gone)

    def _draw_scene(self, camera: str, scene: Scene, T: NDArray[np.float64]) -> None:
        for number, surface in enumerate(scene.supports if self._surfaces.value else ()):
            self._draw_surface(camera, number, surface, T)
        for segment in scene.segments if self._segments.value else ():
            self._draw_segment(camera, segment, T)
        for number, hole in enumerate(scene.missing if self._missing.value else ()):
            self._draw_missing(camera, number, hole, T)

    def _draw_surface(self, camera: str, number: int, surface: SupportSurface, T: NDArray[np.float64]) -> None:
        if len(surface.outline) < 3:
            return
        T_fixed = T @ matrix_of(surface.pose)
        corners = np.array([(x, y, 0.001) for x, y in surface.outline])
        faces = np.array([(0, i, i + 1) for i in range(1, len(corners) - 1)])  # the outline is convex
        node = self._node(camera, f"surface_{number}")
        handle = self._server.scene.add_mesh_simple(
            node, corners, faces, color=_SURFACE, opacity=0.15, side="double", cast_shadow=False, **place(T_fixed)
        )
        rim = np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)
        self._server.scene.add_line_segments(f"{node}/rim", rim, _SURFACE, thickness=2.0, thickness_units="screen")
        low, high = corners.min(axis=0), corners.max(axis=0) + np.array([0, 0, _ABOVE])
        space = corners_of(low, high) @ T_fixed[:3, :3].T + T_fixed[:3, 3]
        pick = Pick(f"surface {number + 1}", True, camera, 0, space)
        handle.on_click(lambda _: self.on_pick(pick))

    def _draw_segment(self, camera: str, segment: SceneSegment, T: NDArray[np.float64]) -> None:
        colour = _KNOWN if segment.type else _UNKNOWN
        T_fixed, half = T @ matrix_of(segment.pose), np.maximum(segment.size, 1e-3) / 2
        node = self._node(camera, f"segment_{segment.label}")
        handle = self._server.scene.add_box(
            node, colour, 2 * half, opacity=0.12, side="double", cast_shadow=False, **place(T_fixed)
        )
        corners = corners_of(-half, half)
        scene, name = self._server.scene, segment.type or f"unknown {segment.label}"
        scene.add_line_segments(f"{node}/edges", edges_of(corners), colour, thickness=2.0, thickness_units="screen")
        inside = np.abs((self._places - T_fixed[:3, 3]) @ T_fixed[:3, :3]) <= half + _BESIDE
        if inside.all(axis=1).any():
            scene.remove_by_name(f"{node}/name")  # what was found there has a label of its own
        else:
            foot = (0.0, 0.0, -float(half[2]))
            scene.add_label(f"{node}/name", name, position=foot, font_screen_scale=0.7, anchor="top-center")
        pick = Pick(name, False, camera, segment.label, corners @ T_fixed[:3, :3].T + T_fixed[:3, 3])
        handle.on_click(lambda _: self.on_pick(pick))

    def _draw_missing(self, camera: str, number: int, hole: MissingDepth, T: NDArray[np.float64]) -> None:
        x, y = hole.size[0] / 2, hole.size[1] / 2
        corners = np.array([(-x, -y, 0), (x, -y, 0), (x, y, 0), (-x, y, 0)])
        rim = np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)
        self._server.scene.add_line_segments(
            self._node(camera, f"missing_{number}"),
            rim,
            _MISSING,
            thickness=2.0,
            thickness_units="screen",
            **place(T @ matrix_of(hole.pose)),
        )

    def _node(self, camera: str, name: str) -> str:
        node = f"/scene/{camera}/{name}"
        self._nodes.add(node)
        return node
