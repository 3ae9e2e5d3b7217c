"""Record the cell: start, stop, trigger; what the recorder tells of itself."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from viser import Icon

from zsight.errors import ZsightError
from zsight.recording_client import RecorderClient
from zsight_protocol.channels import Delivery
from zsight_protocol.recording import RecorderState, Recording

if TYPE_CHECKING:
    from collections.abc import Callable

    import viser

    from zsight.bus import Bus

__all__ = ["RecordPanel"]


class RecordPanel:
    """Buttons for whichever recorder is there."""

    def __init__(self, server: viser.ViserServer, bus: Bus) -> None:
        """Args: server of the page; bus."""
        self._states = bus.reader(bus.cell.recorder_status("*"), RecorderState, delivery=Delivery.LATCHED)
        recorder = RecorderClient(bus)
        gui = server.gui
        with gui.add_folder("Record"):
            self._words = gui.add_markdown("No recorder is there. Start one with `zsight run recorder`.")
            for label, icon, act in (
                ("Record", Icon.PLAYER_RECORD, recorder.start),
                ("Stop recording", Icon.PLAYER_STOP, recorder.stop),
                ("Trigger", Icon.BOLT, recorder.trigger),
            ):
                gui.add_button(label, icon=icon).on_click(partial(self._do, act))

    def _do(self, act: Callable[[], RecorderState], _: object) -> None:
        try:
            self._show(act())
        except ZsightError as error:
            self._words.content = f"**not done**: {error}"

    def update(self) -> None:
        """Show what recorders told."""
        while (received := self._states.take(0)) is not None:
            self._show(received.message)

    def _show(self, state: RecorderState) -> None:
        words = f"**{state.recorder}: {state.state.replace('_', ' ')}**"
        if state.state is Recording.ARMED:
            words += f", {state.in_memory:.0f} s in memory for a trigger"
        if state.path:
            words += (
                f"\n\n{state.path}: {state.seconds:.0f} s, {state.messages:,} messages, "
                f"{state.bytes_written / 1e6:.1f} MB, {state.lost} lost, {state.disk_free / 1e9:.0f} GB free"
            )
        self._words.content = words + (f"\n\n{state.message}" if state.message else "")
