"""Tune a service: its settings with their ranges, and what its stage makes of the cloud that is held still."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING, Any

from zsight.errors import ZsightError
from zsight.viewer.known_settings import values_of
from zsight.viewer.preview import Preview
from zsight.viewer.setting_input import add_input

if TYPE_CHECKING:
    import viser

    from zsight.viewer.clouds import Clouds
    from zsight.viewer.frames import Frames
    from zsight.viewer.known_settings import KnownSettings
    from zsight.viewer.patches import Patch
    from zsight.viewer.selection import Selection
    from zsight_protocol.parameter import Parameter

__all__ = ["Tuning"]

_NONE = "(no process tells its settings)"
_FREEZE, _GO_ON = "Freeze the picture", "Go on"


class Tuning:
    """One process at a time."""

    def __init__(
        self,
        server: viser.ViserServer,
        known: KnownSettings,
        frames: Frames,
        clouds: Clouds,
        selection: Selection,
        budget: int,
    ) -> None:
        """Args: server of the page; settings; frames; clouds to hold; selection with a patch; points drawn at most."""
        self._server, self._known, self._clouds, self._selection = server, known, clouds, selection
        self._changed: dict[str, Any] = {}
        self._seen: tuple[bool, Patch | None] = (False, None)
        self._in_use = False  # clouds are held for other things, too, over which no stage is drawn
        self._lock = threading.RLock()
        gui = server.gui
        self._hold = gui.add_button(_FREEZE, hint="Changes are shown on this very cloud")
        self._process = gui.add_dropdown("Process", (_NONE,))
        self._preview = Preview(server, frames, clouds, selection, budget)
        self._folder = gui.add_folder("Settings")
        self._words = gui.add_markdown("")
        self._save = gui.add_button("Save as this process's settings", hint="They hold after it was started again too")
        self._hold.on_click(lambda _: self._hold_or_go_on())
        self._process.on_update(lambda event: self._choose(by_hand=event.client is not None))
        self._save.on_click(lambda _: self._keep())
        self._choose()

    def chosen(self) -> tuple[str, dict[str, Any]]:
        """The service of the chosen process, and its settings as they are set here."""
        answer = self._known.answers().get(str(self._process.value))
        return ("", {}) if answer is None else (answer.service, {**values_of(answer), **self._changed})

    def update(self) -> None:
        """Follow who is there, and the clouds when they are held, let go or selected from, here or elsewhere."""
        there = tuple(sorted(self._known.answers())) or (_NONE,)
        if tuple(self._process.options) != there:
            self._process.options = there
            self._choose()
        now = (self._clouds.held, self._selection.last)
        if now != self._seen:
            self._seen = now
            self._hold.label = _GO_ON if self._clouds.held else _FREEZE
            self._show()

    def _hold_or_go_on(self) -> None:
        self._in_use = not self._clouds.held
        self._clouds.hold(self._in_use)

    def _choose(self, *, by_hand: bool = False) -> None:
        with self._lock:
            self._in_use |= by_hand
            for child in tuple(self._folder._children.values()):  # noqa: SLF001  viser has no other way to empty one
                child.remove()
            self._changed.clear()
            answer = self._known.answers().get(str(self._process.value))
            if answer is None:
                self._preview.clear()
                self._words.content = "Start a cell with `zsight up`: its processes can be tuned here."
                return
            self._words.content = (
                "" if any(p.live for p in answer.parameters) else "It reads its settings at its start alone."
            )
            with self._folder:
                for parameter in sorted(answer.parameters, key=lambda p: not p.live):  # first what may be changed
                    add_input(self._server.gui, parameter, self._set)
            self._show()

    def _set(self, parameter: Parameter, value: Any) -> None:
        with self._lock:
            self._in_use = True
            try:
                words = self._known.set(str(self._process.value), parameter.name, value)
            except ZsightError as error:
                self._words.content = f"**not set**: {error}"
                return
            self._changed[parameter.name] = value
            self._words.content = words
            self._show()
            if not self._clouds.held and self.chosen()[0] == "planes":
                self._selection.ask_again()

    def _keep(self) -> None:
        with self._lock:
            try:
                for name, value in sorted(self._changed.items()):
                    self._known.set(str(self._process.value), name, value, save=True)
            except ZsightError as error:
                self._words.content = f"**not saved**: {error}"
                return
            kept = ", ".join(sorted(self._changed)) or "nothing was changed"
            self._words.content = f"saved: {kept}"
            self._changed.clear()

    def _show(self) -> None:
        """What comes of the held cloud; nothing while the clouds go on, or are held for something else."""
        with self._lock:
            self._in_use &= self._clouds.held
            if self._in_use:
                self._preview.show(*self.chosen())
            else:
                self._preview.clear()
