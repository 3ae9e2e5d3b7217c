"""Play a recording: open, play, pause, step, a time line to go anywhere on, speed, over and over."""

from __future__ import annotations

import time
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from viser import Icon

from zsight.errors import ZsightError
from zsight.recording_client import PlayerClient
from zsight.viewer.server import set_value
from zsight_protocol.channels import Delivery
from zsight_protocol.recording import PlayerState, Playing

if TYPE_CHECKING:
    from collections.abc import Callable

    import viser

    from zsight.bus import Bus

__all__ = ["PlayPanel"]

_OWN = 1.0  # seconds that the time line is left alone after somebody has moved it


class PlayPanel:
    """Controls for whichever player is there."""

    def __init__(self, server: viser.ViserServer, bus: Bus) -> None:
        """Args: server of the page; bus."""
        self._states = bus.reader(bus.cell.player_status("*"), PlayerState, delivery=Delivery.LATCHED)
        self._player = player = PlayerClient(bus)
        self._moved = 0.0
        gui = server.gui
        with gui.add_folder("Play"):
            self._words = gui.add_markdown("No player is there. Start one with `zsight run player`.")
            path = gui.add_text("Recording", "", hint="A file on the player's host")
            gui.add_button("Open").on_click(lambda _: self._do(lambda: player.open(str(path.value))))
            self._go = gui.add_button("Play", icon=Icon.PLAYER_PLAY)
            gui.add_button("Step").on_click(lambda _: self._do(player.step))
            self._line = gui.add_slider("Seconds", 0.0, 1.0, 0.01, 0.0)
            rate = gui.add_number("Speed", 1.0, min=0.01, max=1000.0, step=0.01)
            loop = gui.add_checkbox("Over and over", False)
        self._playing = False
        self._state: PlayerState | None = None
        self._go.on_click(lambda _: self._toggle())
        keys: tuple[tuple[str, Any, Callable[[], None]], ...] = (
            ("Play or pause", "space", self._toggle),
            ("Next message of the recording", "N", lambda: self._do(player.step)),
            ("A second back in the recording", "pageup", lambda: self._go_by(-1.0)),
            ("A second on in the recording", "pagedown", lambda: self._go_by(1.0)),
            ("Begin the recording again", "home", lambda: self._do(lambda: player.seek(0.0))),
        )
        for label, key, act in keys:
            gui.add_command(label, hotkey=key).on_trigger(partial(_called, act))
        self._line.on_update(self._seek)
        rate.on_update(lambda _: self._do(lambda: player.set_rate(float(rate.value))))
        loop.on_update(lambda _: self._do(lambda: player.set_loop(bool(loop.value))))

    def _toggle(self) -> None:
        self._do(self._player.pause if self._playing else self._player.play)

    def _go_by(self, seconds: float) -> None:
        state = self._state
        if state is not None and state.path:
            self._do(lambda: self._player.seek(min(max(state.position + seconds, 0.0), state.duration)))

    def _seek(self, event: viser.GuiEvent[viser.GuiSliderHandle[float]]) -> None:
        if event.client is not None:  # not moved by the player itself
            self._moved = time.monotonic()
            self._do(lambda: self._player.seek(float(self._line.value)))

    def _do(self, act: Callable[[], PlayerState]) -> None:
        try:
            self._show(act())
        except ZsightError as error:
            self._words.content = f"**not done**: {error}"

    def update(self) -> None:
        """Show what players told."""
        while (received := self._states.take(0)) is not None:
            self._show(received.message)

    def _show(self, state: PlayerState) -> None:
        self._state = state
        self._playing = state.state is Playing.PLAYING
        self._go.label = "Pause" if self._playing else "Play"
        words = f"**{state.player}: {state.state}**"
        if state.path:
            words += f" {Path(state.path).name}, {state.position:.1f} of {state.duration:.1f} s, {state.rate:g} x"
        self._words.content = words + (f"\n\n{state.message}" if state.message else "")
        if state.duration > 0:
            self._line.max = round(state.duration, 2)
        if time.monotonic() - self._moved > _OWN:
            set_value(self._line, min(state.position, float(self._line.max)))


def _called(act: Callable[[], None], _: object) -> None:
    act()
