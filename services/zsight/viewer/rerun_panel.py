"""Run the tuned settings over a recording: every goal in it once more, and what has changed."""

from __future__ import annotations

import threading
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

from viser import Icon

from zsight.recording.rerun_process import RerunProcess
from zsight.viewer.server import set_value
from zsight_core.scene_limits import SceneLimits
from zsight_protocol.channels import Delivery
from zsight_protocol.recording import RecorderState, Recording

if TYPE_CHECKING:
    import viser

    from zsight.bus import Bus
    from zsight.viewer.tuning import Tuning

__all__ = ["RerunPanel", "table_of"]

_ROWS = 200  # rows of the table at most


class RerunPanel:
    """One run at a time, in a process of its own on the viewer's host."""

    def __init__(self, server: viser.ViserServer, bus: Bus, tuning: Tuning) -> None:
        """Args: server of the page; bus; tuning whose settings are tried."""
        self._tuning = tuning
        self._states = bus.reader(bus.cell.recorder_status("*"), RecorderState, delivery=Delivery.LATCHED)
        self._process: RerunProcess | None = None
        self._lock = threading.RLock()
        gui = server.gui
        with gui.add_folder("Over a recording"):
            self._path = gui.add_text("Recorded file", "", hint="On the viewer's host, with goals and their clouds")
            self._run = gui.add_button("Run these settings over it", icon=Icon.PLAYER_TRACK_NEXT)
            self._cancel = gui.add_button("Stop the run", icon=Icon.X, disabled=True)
            self._bar = gui.add_progress_bar(0.0, visible=False)
            self._words = gui.add_markdown("Every goal in it is sought again with the finder's settings above.")
            self._table = gui.add_html("")
        self._run.on_click(lambda _: self._begin())
        self._cancel.on_click(lambda _: self._stop())

    def update(self) -> None:
        """Show how far the run is; offer the file that a recorder of this host has written last."""
        while (received := self._states.take(0)) is not None:
            state = received.message
            if state.state is Recording.IDLE and not self._path.value and state.path and Path(state.path).exists():
                set_value(self._path, state.path)
        with self._lock:
            if self._process is not None and not self._process.ended and self._process.look():
                self._show(self._process)

    def _begin(self) -> None:
        service, settings = self._tuning.chosen()
        path = Path(str(self._path.value).strip()).expanduser()
        if service != "finder":
            self._words.content = "Choose a finder above: a recording holds the goals that finders were asked."
            return
        if not str(self._path.value).strip() or not path.exists():
            self._words.content = f"**There is no file** {path} on this host: name a recording."
            return
        own = str(settings.get("catalogue", ""))
        with self._lock:
            if self._process is not None and not self._process.ended:
                return
            self._process = RerunProcess(path)
            self._process.start((Path(own),) if own and Path(own).is_dir() else (), SceneLimits.of(settings))
            self._show(self._process)

    def _stop(self) -> None:
        with self._lock:
            if self._process is not None:
                self._process.cancel()
                self._show(self._process)

    def _show(self, process: RerunProcess) -> None:
        self._run.disabled, self._cancel.disabled, self._bar.visible = (
            not process.ended,
            process.ended,
            not process.ended,
        )
        set_value(self._bar, 100.0 * process.share)
        self._words.content = _summary(process)
        self._table.content = table_of(process.rows)


def _summary(process: RerunProcess) -> str:
    rows = process.rows
    if process.error:
        return f"**{process.error}**" + (f", after {len(rows)} goals" if rows else "")
    if not process.ended:
        return f"{process.path.name}: {len(rows)} goals ..." if rows else f"opening {process.path.name} ..."
    if not rows:
        return f"{process.path.name} holds no goal with its answer and its cloud: record all keys of the cell."
    worse, changed = sum(bool(row["regression"]) for row in rows), sum(_differs(row) for row in rows)
    return f"{process.path.name}: **{len(rows)} goals, {changed} changed, {worse} of them for the worse**"


def _differs(row: dict[str, Any]) -> bool:
    return bool(row["regression"]) or row["then"] != row["now"] or row["found_then"] != row["found_now"]


def table_of(rows: list[dict[str, Any]]) -> str:
    """A row of HTML for each goal: what was found before and after, and how they differ; what is worse is marked."""
    if not rows:
        return ""
    head = "".join(f"<th>{name}</th>" for name in ("goal", "before", "after", "change"))
    body = "".join(_row(row) for row in rows[:_ROWS])
    more = f"<p class='zs'>and {len(rows) - _ROWS} more</p>" if len(rows) > _ROWS else ""
    return f"<table class='zs'><tr>{head}</tr>{body}</table>{more}"


def _row(row: dict[str, Any]) -> str:
    before = f"{row['then'].replace('_', ' ')} {row.get('found_then', '')}"
    after = f"{row['now'].replace('_', ' ')} {row.get('found_now', '')}"
    mark = "&#9888; " if row["regression"] else ("&#8226; " if _differs(row) else "")
    cells = (mark + escape(row["object_type"]), escape(before), escape(after), escape(_change(row)))
    return "<tr>" + "".join(f"<td>{cell}</td>" for cell in cells) + "</tr>"


def _change(row: dict[str, Any]) -> str:
    """What is worse in words, else how little has changed; and how many things were seen."""
    words = [row["regression"]] if row["regression"] else []
    if not words and "moved_mm" in row:
        words = [f"{row['moved_mm']:.1f} mm", f"{row['turned_deg']:.1f} deg", f"score {row['score_change']:+.2f}"]
    if row.get("segments_then") != row.get("segments_now"):
        words.append(f"{row.get('segments_then')} things, now {row.get('segments_now')}")
    return ", ".join(words)
