"""The page in a real browser: what it draws, what is touched in it, and what goes out on the bus."""

from __future__ import annotations

import contextlib
import re
from typing import TYPE_CHECKING

import numpy as np
import pytest
from playwright.sync_api import expect
from tests.services.browser import PATIENCE, SHOTS, chromium, count_near, pixels, tab
from tests.services.running import running
from tests.services.waiting import soon

from zsight import planes, viewer
from zsight.bus import Bus
from zsight.bus.memory_link import MemoryLink, MemoryNetwork
from zsight.convert import cloud_from_points, points_of
from zsight.viewer.selection import lens_of
from zsight_core.points import colours, from_xyz, xyz
from zsight_protocol.channels import Cell
from zsight_protocol.message import Time
from zsight_protocol.point_cloud import PointCloud2

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray
    from playwright.sync_api import Browser, Page

    from zsight_core.points import Points

__all__ = ["chromium"]  # a fixture

pytestmark = [pytest.mark.usefixtures("warm_kernels"), pytest.mark.timeout(600)]

FRAME = "eye_optical_frame"
RED, GREY = (200, 40, 40), (120, 125, 135)


def sheet(z: float, half: tuple[float, float], spacing: float) -> NDArray[np.float64]:
    """A rectangle across the optical axis, (N, 3)."""
    x, y = np.meshgrid(*(np.arange(-h, h + spacing / 2, spacing) for h in half))
    return np.stack([x.ravel(), y.ravel(), np.full(x.size, z)], axis=1)


PANEL, WALL = sheet(1.0, (0.12, 0.12), 0.005), sheet(1.5, (0.42, 0.3), 0.014)


def room() -> Points:
    """A red panel in front of a grey wall, which goes on behind it."""
    rgb = np.concatenate([np.full(PANEL.shape, RED), np.full(WALL.shape, GREY)]).astype(np.uint8)
    return from_xyz(np.concatenate([PANEL, WALL]), rgb)


class Scene:
    """A viewer with its page, a plane finder and a camera of the test, in one network in memory."""

    def __init__(self, page: viewer.Page, bus: Bus) -> None:
        self.page, self.bus = page, bus
        self.clouds = bus.writer(bus.cell.points("kinect"), PointCloud2)
        self.patches = bus.reader(bus.cell.selected_points("kinect"), PointCloud2)

    def send(self, points: Points) -> None:
        self.clouds.send(cloud_from_points(points, Time.now(), FRAME))


@contextlib.contextmanager
def scene_of(settings: viewer.Settings) -> Iterator[Scene]:
    network, cell = MemoryNetwork(), Cell("test")
    with (
        contextlib.ExitStack() as stack,
        viewer.open_page(settings) as page,
        running(lambda bus, _: page.show(bus), Bus(MemoryLink(network), cell), settings),
    ):
        stack.enter_context(running(planes.run, Bus(MemoryLink(network), cell), planes.Settings()))
        yield Scene(page, stack.enter_context(Bus(MemoryLink(network), cell)))


@pytest.fixture(scope="module")
def scene() -> Iterator[Scene]:
    with scene_of(viewer.Settings(port=0)) as running_scene:
        yield running_scene


@pytest.fixture(scope="module")
def page(chromium: Browser, scene: Scene) -> Iterator[Page]:
    """The page at 1280 x 720, with the room in it, looked at from where the sensor stands."""
    context = chromium.new_context(viewport={"width": 1280, "height": 720}, accept_downloads=True)
    opened = context.new_page()
    opened.goto(scene.page.link)
    expect(opened.get_by_text("No camera publishes.")).to_be_visible()
    scene.send(room())
    expect(opened.get_by_text("points, colour rgb")).to_be_visible()
    opened.get_by_role("button", name="sensor").click()
    with contextlib.suppress(Exception):
        opened.locator(".mantine-Notification-closeButton").first.click(timeout=3000)
    yield opened
    context.close()


def test_the_cloud_is_drawn(page: Page) -> None:
    assert soon(lambda: count_near(pixels(page), RED) > 5000, PATIENCE)
    assert count_near(pixels(page), GREY) > 5000


def test_a_rectangle_publishes_what_is_seen_and_the_plane_lights_up(page: Page, scene: Scene) -> None:
    tab(page, "Select")
    page.get_by_role("button", name="Select a rectangle").click()
    expect(page.get_by_text("Drag a rectangle")).to_be_visible()
    image = np.abs(pixels(page) - np.array(RED)).max(axis=2) < 12
    rows, columns = np.flatnonzero(image.any(axis=1)), np.flatnonzero(image.any(axis=0))
    left, right = float(columns[0] - 40), float(columns[-1] + 40)
    top, bottom = float(rows[0] - 40), float(rows[-1] + 40)
    page.mouse.move(left, top)
    page.mouse.down()
    page.mouse.move((left + right) / 2, (top + bottom) / 2, steps=3)
    page.mouse.move(right, bottom, steps=3)
    page.mouse.up()
    received = scene.patches.take(PATIENCE)
    assert received is not None
    assert received.message.header.frame_id == FRAME
    patch = points_of(received.message)
    chosen = {tuple(point) for point in np.round(xyz(patch).reshape(-1, 3).astype(np.float64), 4).tolist()}
    # What is to be seen, worked out from the rays alone.
    camera = next(iter(scene.page.viser.get_clients().values())).camera
    lens = lens_of(camera)
    eye = np.asarray(camera.position)
    ahead = (1.0 - eye[2]) / (WALL[:, 2] - eye[2])
    crossing = eye[:2] + (WALL[:, :2] - eye[:2]) * ahead[:, np.newaxis]
    from_panel = np.abs(crossing).max(axis=1) - 0.12
    hidden, free = WALL[from_panel < -0.002], WALL[from_panel > 0.012]
    width, height = camera.image_width, camera.image_height
    T = lens.T_eye_points
    seen = free @ T[:3, :3].T + T[:3, 3]
    u = (seen[:, 0] / seen[:, 2] / lens.tangent_across / 2 + 0.5) * width
    v = (seen[:, 1] / seen[:, 2] / lens.tangent_down / 2 + 0.5) * height
    inside = free[(u > left + 1) & (u < right - 1) & (v > top + 1) & (v < bottom - 1)]
    assert len(hidden) > 200
    assert len(inside) > 200
    assert not chosen & {tuple(point) for point in np.round(hidden, 4).tolist()}
    expected = {tuple(point) for point in np.round(np.concatenate([PANEL, inside]), 4).tolist()}
    assert len(chosen & expected) >= 0.95 * len(expected)
    np.testing.assert_array_equal(np.unique(colours(patch).reshape(-1, 3), axis=0), sorted([RED, GREY]))
    expect(page.get_by_text("lie in their plane")).to_be_visible()
    assert soon(lambda: count_near(pixels(page), (230, 159, 0)) > 3000, PATIENCE)
    page.screenshot(path=SHOTS / "selected.png")
    assert re.search(r"distance\s*-1\.000", page.locator("body").inner_text())
