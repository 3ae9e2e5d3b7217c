"""Tune a service: its settings with their ranges, and what its stage makes of the cloud that is held still."""

from __future__ import annotations

import math
import threading
from typing import TYPE_CHECKING, Any

import numpy as np

from zsight.client import CellClient
from zsight.convert import points_of
from zsight.errors import ZsightError
from zsight.viewer.frames import place
from zsight.viewer.stages import STAGES
from zsight_core.errors import CoreError
from zsight_core.points import xyz

if TYPE_CHECKING:
    import viser

    from zsight.bus import Bus
    from zsight.viewer.clouds import Clouds, Shown
    from zsight.viewer.selection import Selection
    from zsight_core.points import Points
    from zsight_protocol.parameter import Parameter, ParameterAnswer

__all__ = ["Tuning", "slider_range"]

_NONE = "(no process tells its settings)"
_LOOK = 2.0  # seconds between two looks at who is there
_KEPT, _REMOVED = (230, 159, 0), (90, 90, 90)


class Tuning:
    """One process at a time."""

    def __init__(self, server: viser.ViserServer, bus: Bus, clouds: Clouds, selection: Selection) -> None:
        """Args: server of the page; bus; clouds that are held still; selection with the patch of planes."""
        self._server, self._bus, self._clouds, self._selection = server, bus, clouds, selection
        self._client = CellClient(bus)
        self._answers: dict[str, ParameterAnswer] = {}
        self._values: dict[str, Any] = {}
        self._changed: set[str] = set()
        self._lock = threading.RLock()
        gui = server.gui
        self._hold = gui.add_button("Freeze the picture", hint="Changes are shown on this very cloud")
        self._process = gui.add_dropdown("Process", (_NONE,))
        self._folder = gui.add_folder("Settings")
        self._words = gui.add_markdown("")
        self._save = gui.add_button("Save as this process's settings", hint="They hold after it was started again too")
        self._hold.on_click(lambda _: self._freeze())
        self._process.on_update(lambda _: self._choose())
        self._save.on_click(lambda _: self._keep())
        threading.Thread(target=self._look, name="settings", daemon=True).start()

    def _look(self) -> None:
        while not self._bus.stopping.is_set():
            try:
                found = {f"{a.host}/{a.process}": a for a in self._client.parameters.list() if a.parameters}
            except ZsightError:
                found = {}
            if set(found) != set(self._answers):
                self._answers = found
                self._process.options = tuple(found) or (_NONE,)
                self._choose()
            self._bus.stopping.wait(_LOOK)

    def _freeze(self) -> None:
        still = not self._clouds.held
        self._clouds.hold(still)
        self._hold.label = "Go on" if still else "Freeze the picture"
        if still:
            self._preview()
        else:
            self._clear()

    def _choose(self) -> None:
        with self._lock:
            for child in tuple(self._folder._children.values()):  # noqa: SLF001  viser has no other way to empty one
                child.remove()
            self._changed.clear()
            self._clear()
            answer = self._answers.get(str(self._process.value))
            if answer is None:
                self._words.content = "Start a cell with `zsight up`: its processes can be tuned here."
                return
            self._words.content = (
                "" if any(p.live for p in answer.parameters) else "It reads its settings at its start alone."
            )
            self._values = {parameter.name: parameter.value for parameter in answer.parameters}
            with self._folder:
                for parameter in answer.parameters:
                    self._add(parameter)
            if self._clouds.held:
                self._preview()

    def _add(self, parameter: Parameter) -> None:
        """An input that suits the kind; what is fixed while the process runs is shown and cannot be changed."""
        gui, label = self._server.gui, parameter.name.replace("_", " ")
        fixed: dict[str, Any] = {"hint": parameter.description, "disabled": not parameter.live}
        handle: Any
        if parameter.choices:
            handle = gui.add_dropdown(
                label, tuple(map(str, parameter.choices)), initial_value=str(parameter.value), **fixed
            )
        elif parameter.kind == "bool":
            handle = gui.add_checkbox(label, bool(parameter.value), **fixed)
        elif parameter.kind in ("int", "float") and isinstance(parameter.value, int | float):
            low, high, step = slider_range(parameter)
            handle = gui.add_slider(label, low, high, step, parameter.value, **fixed)
        else:
            handle = gui.add_text(label, "" if parameter.value is None else str(parameter.value), **fixed)
        handle.on_update(lambda _: self._set(parameter, _typed(parameter, handle.value)))

    def _set(self, parameter: Parameter, value: Any) -> None:
        with self._lock:
            try:
                answer = self._client.parameters.set(str(self._process.value), parameter.name, value)
            except ZsightError as error:
                self._words.content = f"**not set**: {error}"
                return
            self._values[parameter.name] = value
            self._changed.add(parameter.name)
            self._words.content = answer.message
            if self._clouds.held:
                self._preview()
            else:
                self._selection.ask_again()

    def _keep(self) -> None:
        with self._lock:
            try:
                for name in sorted(self._changed):
                    self._client.parameters.set(str(self._process.value), name, self._values[name], save=True)
            except ZsightError as error:
                self._words.content = f"**not saved**: {error}"
                return
            kept = ", ".join(sorted(self._changed)) or "nothing was changed"
            self._words.content = f"saved: {kept}"
            self._changed.clear()

    def _preview(self) -> None:
        """What the stage makes of the held cloud with these settings, drawn at once."""
        answer = self._answers.get(str(self._process.value))
        stage = STAGES.get(answer.service) if answer is not None else None
        camera = str(self._values.get("camera", ""))
        shown = next((shown for shown in self._clouds.shown() if shown.camera == camera), None)
        if stage is None or shown is None:
            return
        patch = self._selection.last
        own = points_of(patch.message) if patch is not None and patch.shown.camera == camera else None
        try:
            result = stage(points_of(shown.cloud), own, self._values)
        except CoreError as error:
            self._words.content = f"**nothing comes out**: {error}"
            return
        if result is None:
            self._words.content = "Select a rectangle first: the plane is that of its points."
            return
        self._draw("kept", shown, result.kept, _KEPT)
        self._draw("removed", shown, result.removed, _REMOVED)
        self._words.content = f"On the frozen cloud: {result.words}."

    def _draw(self, name: str, shown: Shown, points: Points, colour: tuple[int, int, int]) -> None:
        coordinates = xyz(points).reshape(-1, 3) if points.size else np.zeros((0, 3), np.float32)
        whole = coordinates[np.isfinite(coordinates).all(axis=1)]
        self._server.scene.add_point_cloud(
            f"/tuning/{name}",
            whole,
            np.array(colour, np.uint8),
            point_size=1.4 * self._clouds.disc,
            point_shape="circle",
            point_shading="flat",
            precision="float32",
            **place(shown.T_fixed_cloud),
        )

    def _clear(self) -> None:
        for name in ("kept", "removed"):
            self._server.scene.remove_by_name(f"/tuning/{name}")


def _typed(parameter: Parameter, value: Any) -> Any:
    """What was typed as the kind of setting that it is; nothing typed is no value."""
    if not isinstance(value, str) or parameter.kind == "str":
        return value
    if not value:
        return None
    try:
        return float(value) if parameter.kind == "float" else int(value) if parameter.kind == "int" else value
    except ValueError:
        return value  # the process says what it expected


def slider_range(parameter: Parameter) -> tuple[float, float, float]:
    """Least, greatest and step of a slider: within the legal range, a tenth to ten times the present value.

    A length may legally be anything up to 10 m; a slider over all of that could not be set to a millimetre.
    """
    numbers = [float(v) for v in (parameter.value, parameter.default) if isinstance(v, int | float)]
    size = max(map(abs, numbers)) or 1.0
    is_bounded = parameter.minimum is not None and not parameter.minimum_excluded
    low = parameter.minimum if is_bounded and parameter.minimum is not None else size / 10
    high = 10 * size if parameter.maximum is None else min(10 * size, parameter.maximum)
    if parameter.kind == "int":
        return int(low), max(int(high), int(low) + 1), 1
    return min(low, *numbers), max(high, *numbers), 10.0 ** math.floor(math.log10(size / 10))
