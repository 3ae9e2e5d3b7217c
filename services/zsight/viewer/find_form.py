"""The form of a find: what is sought and how, the way there stage by stage, the answer."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING

from viser import Icon

from zsight.client import CellClient, FindOptions, answer_of
from zsight.errors import ZsightError
from zsight.viewer.goals import outcome
from zsight.viewer.server import set_value
from zsight.words import numbers
from zsight_protocol.find_object import Capture

if TYPE_CHECKING:
    import viser

    from zsight.action.client import GoalCall
    from zsight.bus import Bus
    from zsight.viewer.goals import Goals
    from zsight.viewer.region import RegionOfInterest
    from zsight_protocol.action import Update
    from zsight_protocol.find_object import FindObjectResult

__all__ = ["FindForm"]

_NONE = "(no finder answers)"
_LOOK = 2.0  # seconds between two looks at the catalogue


class FindForm:
    """Asks a finder, as ``zsight find`` does."""

    def __init__(self, server: viser.ViserServer, bus: Bus, region: RegionOfInterest, goals: Goals) -> None:
        """Args: server of the page; bus; region that finds look in; log of goals, which draws."""
        self._bus, self._region, self._goals = bus, region, goals
        self._client = CellClient(bus)
        self._call: GoalCall[FindObjectResult] | None = None
        gui = server.gui
        self._type = gui.add_dropdown("Type", (_NONE,))
        self._all = gui.add_checkbox("All instances", False)
        self._new = gui.add_checkbox("A new cloud", False, hint="Wait for a cloud measured after the question")
        self._know = gui.add_checkbox("Known height", False, hint="The height of the support surface is given below")
        self._height = gui.add_number("Height, m", 0.0, step=0.001)
        self._timeout = gui.add_number("Timeout, s", 10.0, min=0.1, max=3600.0, step=0.1)
        self._find = gui.add_button("Find", icon=Icon.SEARCH, color="teal", hint="Or press F")
        self._cancel = gui.add_button("Cancel", icon=Icon.X, disabled=True)
        self._bar = gui.add_progress_bar(0.0)
        self._words = gui.add_markdown("")
        self._find.on_click(lambda _: self._run())
        self._cancel.on_click(lambda _: self._stop())
        gui.add_command("Find", hotkey="F").on_trigger(lambda _: self._run())
        threading.Thread(target=self._keep_types, name="catalogue", daemon=True).start()

    def _keep_types(self) -> None:
        """Offer what the finders know."""
        while not self._bus.stopping.is_set():
            try:
                names = tuple(sorted(kind.name for kind in self._client.catalog.list())) or (_NONE,)
            except ZsightError:
                names = (_NONE,)
            if tuple(self._type.options) != names:
                self._type.options = names
            self._bus.stopping.wait(_LOOK)

    def _options(self) -> FindOptions:
        options = FindOptions(
            maximum=0 if self._all.value else 1,
            capture=Capture.NEW if self._new.value else Capture.LAST,
            timeout=float(self._timeout.value),
        )
        if self._know.value:
            options["known_height"] = float(self._height.value)
        if (chosen := self._region.chosen) is not None:
            options["region"], options["frame"] = chosen
        return options

    def _run(self) -> None:
        if self._call is not None:
            return
        wanted = str(self._type.value)
        if wanted == _NONE:
            self._words.content = (
                "**No finder answers.** Start one with `zsight run finder`, or a whole cell with `zsight up`."
            )
            return
        self._busy(True)
        try:
            self._call = self._client.start_find(wanted, **self._options())
            self._goals.asked(self._call.goal_id, wanted)
            result = answer_of(self._call.wait(self._progress))
        except ZsightError as error:
            self._words.content = f"**{type(error).__name__}**: {error}"
        else:
            self._words.content = _describe(result)
        finally:
            self._call = None
            self._busy(False)

    def _busy(self, busy: bool) -> None:
        self._find.disabled, self._cancel.disabled = busy, not busy
        if busy:
            set_value(self._bar, 0.0)
            self._words.content = "asking ..."

    def _progress(self, update: Update[FindObjectResult]) -> None:
        set_value(self._bar, 100.0 * update.fraction)
        self._words.content = f"{update.server}: {update.stage} ..."

    def _stop(self) -> None:
        call = self._call
        if call is not None:
            try:
                call.cancel()
            except ZsightError as error:
                self._words.content = f"not cancelled: {error}"


def _describe(result: FindObjectResult) -> str:
    lines = [f"**{outcome(result)}**", ""]
    for found in result.objects:
        p, q = found.pose.position, found.pose.orientation
        lines += [
            (
                f"position {numbers((p.x, p.y, p.z))} m in {result.header.frame_id}, "
                f"orientation {numbers((q.x, q.y, q.z, q.w))}, {found.visible_fraction:.0%} visible"
            ),
            "",
        ]
    took = result.timings_ms.get("in_finder")
    return "\n".join(lines) + ("" if took is None else f"\n{took:.0f} ms in the finder")
