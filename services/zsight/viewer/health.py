"""How every process is: a table of beats, and rates and delays that move."""

from __future__ import annotations

import time
from collections import deque
from html import escape
from typing import TYPE_CHECKING

import numpy as np
from viser import uplot

from zsight.hosts.beats import topics_of
from zsight_protocol.channels import Delivery
from zsight_protocol.health import Health, Level

if TYPE_CHECKING:
    import viser

    from zsight.bus import Bus

__all__ = ["HealthPanel"]

_SILENT = 3.5  # seconds without a beat until a process counts as silent
_FORGOTTEN = 60.0  # seconds until it is no longer shown
_WINDOW = 90  # beats in the plots
_PERIOD = 1.0  # seconds between two columns of the plots
_LINES = 5  # lines of a plot at most; more are not told apart
_COLOURS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9")  # told apart by everybody (Okabe and Ito 2008)
_MARKS = {Level.OK: "✓", Level.WARN: "!", Level.ERROR: "✗", Level.STALE: "…"}


class HealthPanel:
    """The table and two plots."""

    def __init__(self, server: viser.ViserServer, bus: Bus) -> None:
        """Args: server of the page; bus."""
        self._beats = bus.reader(bus.cell.health("*", "*"), Health, delivery=Delivery.EVERY)
        self._known: dict[tuple[str, str], tuple[float, Health]] = {}
        self._html = server.gui.add_html(_table([]))
        self._rates = _Plot(server, "Clouds a second")
        self._delays = _Plot(server, "Delay from the stamp, ms (median)")
        self._next = 0.0

    def beats(self) -> list[Health]:
        """The last beat of every process that is not silent."""
        now = time.monotonic()
        return [beat for at, beat in self._known.values() if now - at < _SILENT]

    def update(self) -> None:
        """Take in what was heard; draw once a second."""
        now = time.monotonic()
        while (received := self._beats.take(0)) is not None:
            self._known[received.message.host, received.message.process] = (now, received.message)
        if now < self._next:
            return
        self._next = now + _PERIOD
        self._known = {key: entry for key, entry in self._known.items() if now - entry[0] < _FORGOTTEN}
        self._html.content = _table([(now - at, beat) for _, (at, beat) in sorted(self._known.items())])
        self._rates.add(now, self._rates_now())
        self._delays.add(now, self._delays_now())

    def _rates_now(self) -> dict[str, float]:
        return {
            topic.key.partition("/")[2]: sum(writer.rate_hz for _, writer in topic.writers)
            for topic in topics_of(self.beats())
            if topic.writers and "points" in topic.key
        }

    def _delays_now(self) -> dict[str, float]:
        """By stage: until a process has sent it, until another has it decoded."""
        stages: dict[str, float] = {}
        for topic in topics_of(self.beats()):
            key = topic.key.partition("/")[2]
            if not key.endswith(("points", "points/voxel")):
                continue
            for beat, writer in topic.writers:
                if writer.since_stamp is not None:
                    stages[f"{key} sent by {beat.process}"] = writer.since_stamp.p50_ms
            for beat, reader in topic.readers:
                if reader.since_stamp is not None and "*" not in key:
                    stages[f"{key} in {beat.process}"] = reader.since_stamp.p50_ms
        return stages


class _Plot:
    """Lines over the last minute and a half; its series are fixed when it is made, so it is made anew for others."""

    def __init__(self, server: viser.ViserServer, title: str) -> None:
        self._title = title
        self._server = server
        self._folder = server.gui.add_folder(title)
        self._columns: deque[tuple[float, dict[str, float]]] = deque(maxlen=_WINDOW)
        self._names: tuple[str, ...] = ()
        self._handle: viser.GuiUplotHandle | None = None

    def add(self, now: float, values: dict[str, float]) -> None:
        """A column of values by name."""
        self._columns.append((now, values))
        names = tuple(sorted({name for _, column in self._columns for name in column}))[:_LINES]
        if len(self._columns) < 2 or not names:
            return
        data = self._data(now, names)
        if self._handle is not None and names == self._names:
            self._handle.data = data
            return
        if self._handle is not None:
            self._handle.remove()
        self._names = names
        lines = (
            uplot.Series(label=name, stroke=colour, width=2) for name, colour in zip(names, _COLOURS, strict=False)
        )
        with self._folder:
            self._handle = self._server.gui.add_uplot(
                data,
                (uplot.Series(label="s"), *lines),
                scales={"x": uplot.Scale(time=False, auto=True), "y": uplot.Scale(auto=True)},
                legend=uplot.Legend(live=False),
                height=170,
            )

    def _data(self, now: float, names: tuple[str, ...]) -> tuple[np.ndarray, ...]:
        rows = [[column.get(name, 0.0) for _, column in self._columns] for name in names]
        return (np.array([at - now for at, _ in self._columns]), *(np.array(row) for row in rows))


def _table(beats: list[tuple[float, Health]]) -> str:
    if not beats:
        return "<p class='zs'>No process tells how it is.</p>"
    rows = "".join(_row(silent, beat) for silent, beat in beats)
    return (
        f"<table class='zs'><tr><th></th><th>process</th><th>in, out /s</th><th>lost</th><th>MB</th></tr>{rows}</table>"
    )


def _row(silent: float, beat: Health) -> str:
    level = Level.STALE if silent > _SILENT else beat.level
    into = sum(reader.rate_hz for reader in beat.readers)
    out = sum(writer.rate_hz for writer in beat.writers if "/@" not in writer.key)
    lost = sum(reader.lost + reader.refused for reader in beat.readers)
    last = beat.last_error if level is not Level.STALE else f"silent for {silent:.0f} s"
    words = f"<tr><td></td><td colspan='4'>{escape(last)}</td></tr>" if last else ""
    return (
        f"<tr title='{escape(beat.service)} as process {beat.pid} on {escape(beat.host)}'>"
        f"<td>{_MARKS[level]}</td><td>{escape(beat.process)}</td><td>{into:.1f}, {out:.1f}</td>"
        f"<td>{lost}</td><td>{beat.memory_bytes / 2**20:.0f}</td></tr>{words}"
    )
