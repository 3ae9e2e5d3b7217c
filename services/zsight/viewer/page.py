"""The page: its panels in their tabs, and the round in which they look what is new."""

from __future__ import annotations

import contextlib
import logging
from typing import TYPE_CHECKING, Protocol

from zsight.viewer.cameras import Cameras
from zsight.viewer.clouds import Clouds
from zsight.viewer.find_form import FindForm
from zsight.viewer.found import FoundObjects
from zsight.viewer.frames import Frames
from zsight.viewer.goals import Goals
from zsight.viewer.health import HealthPanel
from zsight.viewer.keep import Keep
from zsight.viewer.known_settings import KnownSettings
from zsight.viewer.levelling import Levelling
from zsight.viewer.picking import Picking
from zsight.viewer.plane_switches import PlaneSwitches
from zsight.viewer.play_panel import PlayPanel
from zsight.viewer.record_panel import RecordPanel
from zsight.viewer.rectangle import RectangleGesture
from zsight.viewer.region import RegionOfInterest
from zsight.viewer.region_panel import RegionPanel
from zsight.viewer.rerun_panel import RerunPanel
from zsight.viewer.scene_layer import SceneLayer
from zsight.viewer.selection import Selection
from zsight.viewer.server import open_server
from zsight.viewer.status import StatusLine
from zsight.viewer.tuning import Tuning
from zsight.viewer.viewpoint import Viewpoint

if TYPE_CHECKING:
    from collections.abc import Iterator

    import viser

    from zsight.bus import Bus
    from zsight.viewer.settings import Settings

__all__ = ["Page", "open_page"]

log = logging.getLogger(__name__)

_ROUND = 0.1  # seconds between two looks at what is new, clouds aside
_WIDTH = 370  # pixels of the panel: all tabs in one row, and most of a small screen left for the scene

_STYLE = """<style>
table.zs { width: calc(100% - 1.6em); margin: 0 0.8em; border-collapse: collapse; }
table.zs { font-size: 0.85em; line-height: 1.35; }
table.zs th { text-align: left; font-weight: 600; white-space: nowrap; }
table.zs td:first-child { white-space: nowrap; }
table.zs .n { text-align: right; font-variant-numeric: tabular-nums; }
table.zs td, table.zs th { padding: 0.1em 0.35em; border-bottom: 1px solid #8884; overflow-wrap: anywhere; }
p.zs { font-size: 0.9em; margin: 0.3em 0.9em; }
</style>"""


class Panel(Protocol):
    """A part of the page that looks what is new."""

    def update(self) -> None:
        """Look, and show what has changed."""


class Page:
    """A page that is served; empty until it has a bus."""

    def __init__(self, server: viser.ViserServer, settings: Settings, link: str) -> None:
        """Args: server; settings; link that opens the page."""
        self.link = link
        self.viser = server
        self._settings = settings
        server.gui.configure_theme(show_share_button=False, show_logo=False, control_width="medium")
        server.gui.main_panel.dock_right()
        server.gui.main_panel.set_width(_WIDTH)
        server.gui.add_html(_STYLE)
        self._words = server.gui.add_markdown("")

    def say(self, words: str) -> None:
        """Words on top of the page."""
        self._words.content = words

    def show(self, bus: Bus) -> None:
        """Fill the page, and keep it up to date until the bus stops."""
        panels = self._panels(bus)
        bus.ready()
        while not bus.stopping.wait(_ROUND):
            for panel in panels:
                panel.update()

    def _panels(self, bus: Bus) -> list[Panel]:
        server, settings = self.viser, self._settings
        tabs = server.gui.add_tab_group()
        scene_tab = tabs.add_tab("Scene")
        with scene_tab:
            frames = Frames(server, bus, settings.frame)
            clouds = Clouds(server, bus, frames, settings)
            cameras = Cameras(server, bus, frames, clouds)
            scenes = SceneLayer(server, bus, frames)
            viewpoint = Viewpoint(server, frames, clouds)
        with tabs.add_tab("Select"):
            gesture = RectangleGesture(server, clouds)
            selection = Selection(server, bus, frames, clouds, gesture, asks=not settings.read_only)
            known = KnownSettings(bus)
            switches: list[Panel] = [] if settings.read_only else [PlaneSwitches(server, known, selection)]
        with tabs.add_tab("Find"):
            form = None if settings.read_only else server.gui.add_folder(None)
            region = RegionOfInterest(server, frames)
            found = FoundObjects(server, frames, clouds)
            scenes.explained = found.places
            goals = Goals(server, bus, found)
            if form is not None:
                with form:
                    FindForm(server, bus, region, goals)
                    with server.gui.add_folder("Where finds look"):
                        RegionPanel(server, region, gesture, selection, scenes)
                with scene_tab:
                    scenes.on_pick = Picking(server, bus, frames, region).picked
                    Levelling(server, bus, clouds)
        with tabs.add_tab("Health"):
            health = HealthPanel(server, bus)
        tune: list[Panel] = []
        if not settings.read_only:
            with tabs.add_tab("Tune"):
                tuning = Tuning(server, known, frames, clouds, selection, settings.budget)
                tune = [tuning, RerunPanel(server, bus, tuning)]
        with tabs.add_tab("Keep"):
            keep = Keep(server, frames, clouds, settings.folder)
            if not settings.read_only:
                recording: list[Panel] = [RecordPanel(server, bus), PlayPanel(server, bus)]
            else:
                recording = []
        status = StatusLine(self._words, bus, clouds, read_only=settings.read_only)
        server.on_client_connect(lambda _: clouds.redraw())
        shown: list[Panel] = [status, frames, clouds, cameras, scenes, viewpoint, selection, goals, found, region]
        return [*shown, *switches, health, *tune, keep, *recording]


@contextlib.contextmanager
def open_page(settings: Settings) -> Iterator[Page]:
    """Serve a page until the end of the block.

    Raises:
        UsageError: its port is taken.
    """
    with open_server(settings) as server:
        yield Page(server.viser, settings, server.link)
