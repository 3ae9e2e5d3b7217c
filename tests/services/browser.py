"""A real browser without a screen, and a page of the viewer open in it."""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import expect, sync_playwright

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray
    from playwright.sync_api import Browser, Page

__all__ = ["PATIENCE", "SHOTS", "chromium", "count_near", "open_page", "pixels", "tab"]

CHROMIUM = Path("/usr/bin/chromium")
PATIENCE = 180.0  # seconds; software drawing on a busy machine is slow, and slow is no failure
SHOTS = Path(__file__).resolve().parent.parent.parent / "screenshots"
_SOFTWARE_DRAWING = ["--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-sandbox"]

expect.set_options(timeout=PATIENCE * 1e3)


@pytest.fixture(scope="module")
def chromium() -> Iterator[Browser]:
    """The browser of a module's tests."""
    if not CHROMIUM.exists():
        pytest.skip(f"no {CHROMIUM}: .ci/install_browser installs it")
    SHOTS.mkdir(exist_ok=True)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=_SOFTWARE_DRAWING)
        yield browser
        browser.close()


def open_page(browser: Browser, link: str, width: int = 1280, height: int = 720) -> Page:
    """A page in a window of its own, as patient as the tests."""
    context = browser.new_context(viewport={"width": width, "height": height}, accept_downloads=True)
    context.set_default_timeout(PATIENCE * 1e3)
    page = context.new_page()
    page.goto(link)
    return page


def pixels(page: Page) -> NDArray[np.int16]:
    """What the page shows: (rows, columns, 3), red green blue."""
    return np.asarray(Image.open(io.BytesIO(page.screenshot())).convert("RGB"), dtype=np.int16)


def count_near(image: NDArray[np.int16], colour: tuple[int, int, int], tolerance: int = 12) -> int:
    """How many pixels have a colour, nearly."""
    return int((np.abs(image - np.array(colour)).max(axis=2) <= tolerance).sum())


def tab(page: Page, name: str) -> None:
    """Turn to a tab of the panel."""
    page.get_by_role("tab", name=name).click()
