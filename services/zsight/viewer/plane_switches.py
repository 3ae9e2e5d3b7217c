"""Two settings of the planes service, beside its answers: only what is connected, and what stands above."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from zsight.errors import ZsightError
from zsight.viewer.known_settings import values_of
from zsight.viewer.server import set_value

if TYPE_CHECKING:
    import viser

    from zsight.viewer.known_settings import KnownSettings
    from zsight.viewer.selection import Selection

__all__ = ["PlaneSwitches"]

_SWITCHES = (
    ("connected", "Connected only", "Only what is connected to the selected points lies in the plane"),
    ("above", "Above it, too", "Show the points that stand above the plane as well"),
)


class PlaneSwitches:
    """Check boxes that follow the service, whoever sets it."""

    def __init__(self, server: viser.ViserServer, known: KnownSettings, selection: Selection) -> None:
        """Args: server of the page; settings of the cell; selection that is answered anew."""
        self._known, self._selection = known, selection
        self._boxes = {
            name: server.gui.add_checkbox(label, False, disabled=True, hint=hint) for name, label, hint in _SWITCHES
        }
        self._words = server.gui.add_markdown("", visible=False)
        for name, box in self._boxes.items():
            box.on_update(partial(self._changed, name))

    def update(self) -> None:
        """Show how the service is set; without one there is nothing to set."""
        process = self._process()
        values = {} if process is None else values_of(self._known.answers()[process])
        for name, box in self._boxes.items():
            if box.disabled != (name not in values):
                box.disabled = name not in values
            if name in values and box.value != values[name]:
                set_value(box, bool(values[name]))

    def _process(self) -> str | None:
        """The planes service of the camera that was selected from, else any."""
        found = {name: values_of(a) for name, a in self._known.answers().items() if a.service == "planes"}
        camera = None if self._selection.last is None else self._selection.last.shown.camera
        return next((name for name, values in found.items() if camera in (None, values.get("camera"))), None)

    def _changed(self, name: str, event: viser.GuiEvent[viser.GuiCheckboxHandle]) -> None:
        process = self._process()
        if event.client is None or process is None:
            return  # it was the service that changed
        try:
            self._known.set(process, name, bool(self._boxes[name].value))
        except ZsightError as error:
            self._words.content, self._words.visible = f"**not set**: {error}", True
            return
        self._words.visible = False
        self._selection.ask_again()
