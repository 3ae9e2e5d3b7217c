"""The viewer service: a page in the browser, in place of rviz."""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING

from zsight.viewer.page import Page, open_page
from zsight.viewer.settings import Settings

if TYPE_CHECKING:
    from zsight.bus import Bus

__all__ = ["Page", "Settings", "open_page", "run"]

log = logging.getLogger(__name__)


def run(bus: Bus, settings: Settings) -> None:
    """Serve the page of a cell."""
    with open_page(settings) as page:
        log.info("the page is at %s", page.link)
        page.show(bus)
