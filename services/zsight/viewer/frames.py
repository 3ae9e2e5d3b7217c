"""The tree of frames, drawn in the one that is held fixed."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING, TypedDict

import numpy as np

from zsight.transforms import TransformBuffer, TransformUnknown
from zsight.viewer.server import set_value
from zsight_core.transform import quaternion
from zsight_protocol.geometry import TransformList

if TYPE_CHECKING:
    import viser
    from numpy.typing import NDArray

    from zsight.bus import Bus, Reader

__all__ = ["Frames", "Place", "place"]

AUTOMATIC = "root of the tree"
_AXES = 0.15  # metres


class Place(TypedDict):
    """Where a node of the scene stands, as viser takes it."""

    wxyz: tuple[float, float, float, float]
    position: tuple[float, float, float]


def place(T: NDArray[np.float64]) -> Place:
    """The place of a matrix T_fixed_node (4, 4)."""
    x, y, z, w = (float(value) for value in quaternion(T))
    px, py, pz = (float(value) for value in T[:3, 3])
    return Place(wxyz=(w, x, y, z), position=(px, py, pz))


class Frames:
    """Where everything is in the fixed frame; what was heard on tf and tf_static."""

    def __init__(self, server: viser.ViserServer, bus: Bus, fixed: str) -> None:
        """Args: server of the page; bus; fixed frame to begin with, empty for the root."""
        self.generation = 0  # counts what moves everything: the fixed frame, the static tree
        self._server = server
        self._buffer = TransformBuffer()
        self._moving = bus.reader(bus.cell.tf, TransformList)
        self._static = bus.reader(bus.cell.tf_static, TransformList)
        self._seen: set[str] = set()
        self._drawn: set[str] = set()
        self._lock = threading.RLock()
        self._choice = server.gui.add_dropdown(
            "Fixed frame", (fixed or AUTOMATIC,), hint="Everything is drawn as seen from this frame"
        )
        self._shown = server.gui.add_checkbox("Frames", True, hint="The tree of frames with their names")
        self._choice.on_update(lambda _: self._choose())
        self._shown.on_update(lambda _: self._draw())

    @property
    def fixed(self) -> str:
        """The fixed frame; empty while none is known."""
        chosen = str(self._choice.value)
        if chosen != AUTOMATIC:
            return chosen
        with self._lock:
            some = min(self._seen, default="")
        return self._buffer.root_of(some) if some else ""

    @property
    def up(self) -> tuple[float, float, float]:
        """Against gravity in the fixed frame: z, in optical frames against y."""
        return (0.0, -1.0, 0.0) if self.fixed.endswith("_optical_frame") else (0.0, 0.0, 1.0)

    def heard(self, frame: str) -> None:
        """A message came in this frame."""
        with self._lock:
            if frame in self._seen:
                return
            self._seen.add(frame)
        self._offer()
        self._server.scene.set_up_direction(self.up)

    def T_fixed(self, frame: str, stamp_ns: int | None = None) -> NDArray[np.float64] | None:
        """T_fixed_frame (4, 4) at a time, or the newest that is known; none where no chain leads there."""
        for when in (stamp_ns, None):
            try:
                return self._buffer.lookup(self.fixed or frame, frame, when)
            except TransformUnknown:
                continue
        return None

    def T_world(self, frame: str, stamp_ns: int) -> NDArray[np.float64] | None:
        """T_root_frame (4, 4) in the root of its tree, whose z is up; none where nothing is known above the frame."""
        root = self._buffer.root_of(frame)
        try:
            return None if root == frame else self._buffer.lookup(root, frame, stamp_ns)
        except TransformUnknown:
            return None

    def update(self) -> None:
        """Take in what was heard, and draw the tree where it changed."""
        fixed_ones = self._take_in(self._static, static=True)
        if self._take_in(self._moving, static=False) or fixed_ones:
            self._offer()
            self._server.scene.set_up_direction(self.up)
            self._draw()
        self.generation += fixed_ones

    def _take_in(self, reader: Reader[TransformList], *, static: bool) -> bool:
        changed = False
        while (received := reader.take(0)) is not None:
            self._buffer.put(received.message, static=static)
            changed = True
        return changed

    def _offer(self) -> None:
        """Let the user choose among all frames."""
        with self._lock:
            options = (AUTOMATIC, *sorted(self._buffer.frames() | self._seen))
            chosen = self._choice.value
            if tuple(self._choice.options) != options and chosen in options:
                self._choice.options = options
                set_value(self._choice, chosen)

    def _choose(self) -> None:
        self._server.scene.set_up_direction(self.up)
        self._draw()
        self.generation += 1

    def _draw(self) -> None:
        with self._lock:
            for name in self._drawn:
                self._server.scene.remove_by_name(f"/frames/{name}")
            places = {name: self.T_fixed(name) for name in sorted(self._buffer.frames())} if self._shown.value else {}
            known = {name: T for name, T in places.items() if T is not None}
            for name, T in known.items():
                node = f"/frames/{name}"
                self._server.scene.add_frame(node, axes_length=_AXES, axes_radius=_AXES / 40, **place(T))
            for names in _together(known):
                text = " = ".join(names)
                self._server.scene.add_label(
                    f"/frames/{names[0]}/name", text, font_screen_scale=0.7, anchor="top-center"
                )
            self._drawn = set(known)


def _together(places: dict[str, NDArray[np.float64]]) -> list[list[str]]:
    """Names of frames by where they are: those at one place share a label, which would hide each other."""
    groups: list[list[str]] = []
    for name, T in places.items():
        for group in groups:
            if np.linalg.norm(places[group[0]][:3, 3] - T[:3, 3]) < _AXES / 2:
                group.append(name)
                break
        else:
            groups.append([name])
    return groups
