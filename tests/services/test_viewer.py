"""The page in a real browser: what it draws, what is touched in it, and what goes out on the bus."""

from __future__ import annotations

import contextlib
import re
from typing import TYPE_CHECKING

import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import expect
from tests.core.book_scene import T_WORLD_BLOCK, TOY_BLOCK
from tests.core.book_scene import cloud as book_cloud
from tests.services.browser import PATIENCE, SHOTS, chromium, count_near, open_page, pixels, tab
from tests.services.gated_work import Gated
from tests.services.recorded_answers import record
from tests.services.running import running
from tests.services.waiting import soon
from tests.system.commands import free_port

from zsight import finder, planes, viewer, voxel
from zsight.action.server import ActionServer, GoalHandle, Policy
from zsight.bus import Bus
from zsight.bus.memory_link import MemoryLink, MemoryNetwork
from zsight.catalogue import type_files
from zsight.catalogue.server import serve_catalogue
from zsight.convert import cloud_from_points, points_of, pose_of
from zsight.parameters import Parameters, Saved, serve_parameters
from zsight.recording import player, recorder
from zsight.recording.rerun import rerun
from zsight.viewer.patches import lens_of
from zsight.viewer.status import missing_router
from zsight_core.files import pcd
from zsight_core.points import colours, from_xyz, xyz
from zsight_core.transform import from_rpy
from zsight_protocol.channels import Cell
from zsight_protocol.find_object import DetectedObject, FindObjectGoal, FindObjectResult, Status
from zsight_protocol.geometry import Plane, Point
from zsight_protocol.message import Header, Time
from zsight_protocol.point_cloud import PointCloud2
from zsight_protocol.scene import Scene as SceneMessage
from zsight_protocol.scene import SceneSegment, SupportSurface

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from numpy.typing import ArrayLike, NDArray
    from playwright.sync_api import Browser, Locator, Page

    from zsight_core.points import Points

__all__ = ["chromium"]  # a fixture

pytestmark = [pytest.mark.usefixtures("warm_kernels"), pytest.mark.timeout(1200)]

FRAME = "eye_optical_frame"
RED, GREY = (200, 40, 40), (120, 125, 135)


T_PIN = from_rpy((-0.25, -0.1, 1.0), (0.6, 0.5, 0.4))


def sheet(z: float, half: tuple[float, float], spacing: float) -> NDArray[np.float64]:
    """A rectangle across the optical axis, (N, 3)."""
    x, y = np.meshgrid(*(np.arange(-h, h + spacing / 2, spacing) for h in half))
    return np.stack([x.ravel(), y.ravel(), np.full(x.size, z)], axis=1)


PANEL, WALL = sheet(1.0, (0.12, 0.12), 0.005), sheet(1.5, (0.42, 0.3), 0.014)


def room() -> Points:
    """A red panel in front of a grey wall, which goes on behind it."""
    rgb = np.concatenate([np.full(PANEL.shape, RED), np.full(WALL.shape, GREY)]).astype(np.uint8)
    return from_xyz(np.concatenate([PANEL, WALL]), rgb)


class Finder(Gated):
    """Says that it found a pin at a certain place, as soon as its gate is open."""

    def __init__(self) -> None:
        super().__init__()
        self.goals: list[FindObjectGoal] = []

    def execute(self, handle: GoalHandle[FindObjectGoal, FindObjectResult]) -> FindObjectResult:
        self.goals.append(handle.goal)
        done = super().execute(handle)
        pin = DetectedObject(
            type="pin",  # thinner than its triad, and of no type that is known here
            score=0.97,
            pose=pose_of(T_PIN),
            size=(0.002, 0.002, 0.07),
            covariance=tuple((np.eye(6) * 1e-6).ravel().tolist()),
            visible_fraction=1.0,
        )
        header = Header(stamp=Time.now(), frame_id=FRAME)
        return done.model_copy(update={"header": header, "status": Status.FOUND, "objects": (pin,), "message": ""})


class Scene:
    """A viewer with its page, a plane finder and a camera of the test, in one network in memory."""

    def __init__(self, page: viewer.Page, bus: Bus, finder: Finder, recordings: Path, planes: planes.Settings) -> None:
        self.page, self.bus, self.finder, self.recordings, self.planes = page, bus, finder, recordings, planes
        self.clouds = bus.writer(bus.cell.points("kinect"), PointCloud2)
        self.patches = bus.reader(bus.cell.selected_points("kinect"), PointCloud2)

    def send(self, points: Points) -> None:
        self.clouds.send(cloud_from_points(points, Time.now(), FRAME))

    def pixel(self, point: ArrayLike) -> NDArray[np.float64]:
        """Where a point of the fixed frame is on the first browser's screen: column and row."""
        camera = next(iter(self.page.viser.get_clients().values())).camera
        lens = lens_of(camera)
        x, y, z = lens.T_eye_points[:3, :3] @ np.asarray(point) + lens.T_eye_points[:3, 3]
        shares = np.array([x / z / lens.tangent_across, y / z / lens.tangent_down]) / 2 + 0.5
        return np.asarray(shares * (camera.image_width, camera.image_height))


@contextlib.contextmanager
def scene_of(settings: viewer.Settings, folder: Path) -> Iterator[Scene]:
    network, cell = MemoryNetwork(), Cell("test")
    with (
        contextlib.ExitStack() as stack,
        viewer.open_page(settings) as page,
        running(lambda bus, _: page.show(bus), Bus(MemoryLink(network), cell), settings),
    ):
        flat, flats = Bus(MemoryLink(network), cell), planes.Settings()
        stack.enter_context(running(planes.run, flat, flats))
        serve_parameters(flat, "here", "planes", "planes", Parameters(flats, Saved("test", "planes")))
        recording, playing = recorder.Settings(folder=str(folder)), player.Settings(paused=True)
        stack.enter_context(running(recorder.run, Bus(MemoryLink(network), cell), recording))
        stack.enter_context(running(player.run, Bus(MemoryLink(network), cell), playing))
        own, leaf = Bus(MemoryLink(network), cell), voxel.Settings()
        stack.enter_context(running(voxel.run, own, leaf))
        serve_parameters(own, "here", "voxel", "voxel", Parameters(leaf, Saved("test", "voxel")))
        serve_parameters(own, "here", "finder", "finder", Parameters(finder.Settings(), Saved("test", "finder")))
        work, served = Finder(), stack.enter_context(Bus(MemoryLink(network), cell))
        server = ActionServer(served, "finder", FindObjectGoal, work, Policy())
        types = serve_catalogue(served, type_files.load(type_files.shipped_folder()), None)
        yield Scene(page, stack.enter_context(Bus(MemoryLink(network), cell)), work, folder, flats)
        types.close()
        server.close()


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Scene]:
    with scene_of(viewer.Settings(port=0, budget=6000), tmp_path_factory.mktemp("recordings")) as running_scene:
        yield running_scene


@pytest.fixture(scope="module")
def page(chromium: Browser, scene: Scene) -> Iterator[Page]:
    """The page at 1280 x 720, with the room in it, looked at from where the sensor stands."""
    opened = open_page(chromium, scene.page.link)
    expect(opened.get_by_text("No camera publishes.")).to_be_visible()
    scene.send(room())
    expect(opened.get_by_text("points drawn, colour rgb")).to_be_visible()
    opened.get_by_role("button", name="sensor").click()
    with contextlib.suppress(Exception):
        opened.locator(".mantine-Notification-closeButton").first.click(timeout=3000)
    yield opened
    opened.context.close()


def drag(page: Page, left: float, top: float, right: float, bottom: float) -> None:
    """A rectangle in the picture, as a hand draws it."""
    page.mouse.move(left, top)
    page.mouse.down()
    page.mouse.move((left + right) / 2, (top + bottom) / 2, steps=3)
    page.mouse.move(right, bottom, steps=3)
    page.mouse.up()


def test_the_cloud_is_drawn(page: Page) -> None:
    assert soon(lambda: count_near(pixels(page), RED) > 5000, PATIENCE)
    assert count_near(pixels(page), GREY) > 5000


def test_a_rectangle_publishes_what_is_seen_and_the_plane_lights_up(page: Page, scene: Scene) -> None:
    tab(page, "Select")
    expect(page.get_by_label("Connected only")).to_be_enabled()  # settings are known, and no stage is drawn for it
    page.get_by_role("button", name="Select a rectangle").click()
    expect(page.get_by_text("Drag a rectangle")).to_be_visible()
    assert soon(lambda: count_near(pixels(page), RED) > 5000, PATIENCE)
    image = np.abs(pixels(page) - np.array(RED)).max(axis=2) < 12
    rows, columns = np.flatnonzero(image.any(axis=1)), np.flatnonzero(image.any(axis=0))
    left, right = float(columns[0] - 40), float(columns[-1] + 40)
    top, bottom = float(rows[0] - 40), float(rows[-1] + 40)
    drag(page, left, top, right, bottom)
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
    page.get_by_role("button", name="Clear").click()
    assert soon(lambda: count_near(pixels(page), RED) > 3000, PATIENCE)


def from_axis(image: NDArray[np.int16], channel: int, middle: NDArray[np.float64]) -> float:
    """Pixels from a place to the middle of the axis of this colour around it; infinite where none is drawn."""
    u, v = np.round(middle).astype(int)
    part = image[v - 45 : v + 45, u - 45 : u + 45]
    others = np.delete(part, channel, axis=2).max(axis=2)
    rows, columns = np.nonzero((part[..., channel] > 120) & (part[..., channel] > 1.8 * others))
    if len(rows) < 20:
        return float("inf")
    return float(np.hypot(columns.mean() + u - 45 - middle[0], rows.mean() + v - 45 - middle[1]))


def test_a_find_shows_its_progress_and_a_triad_at_its_place(page: Page, scene: Scene) -> None:
    tab(page, "Find")
    expect(page.get_by_role("combobox", name="Type")).to_have_value("ball")
    page.get_by_role("combobox", name="Type").click()
    page.get_by_role("option", name="toy_block").click()
    page.get_by_role("button", name="Find", exact=True).click()
    expect(page.get_by_text("finder: waiting")).to_be_visible()
    expect(page.get_by_role("button", name="Find", exact=True)).to_be_disabled()
    page.screenshot(path=SHOTS / "finding.png")
    scene.finder.gate.set()
    expect(page.get_by_text("found pin 97%").first).to_be_visible()
    ends = [scene.pixel(T_PIN[:3, 3]), *(scene.pixel(T_PIN[:3, 3] + 0.063 * T_PIN[:3, axis]) for axis in range(3))]

    def farthest() -> float:
        image = pixels(page)
        return max(from_axis(image, axis, (ends[0] + ends[1 + axis]) / 2) for axis in range(3))

    assert soon(lambda: farthest() < 3, PATIENCE), farthest()
    page.screenshot(path=SHOTS / "found.png")


def test_a_find_is_cancelled(page: Page, scene: Scene) -> None:
    scene.finder.gate.clear()
    tab(page, "Find")
    page.get_by_role("button", name="Find", exact=True).click()
    expect(page.get_by_text("finder: waiting")).to_be_visible()
    page.get_by_role("button", name="Cancel").click()
    expect(page.get_by_text("GoalCancelled")).to_be_visible()
    expect(page.get_by_role("button", name="Find", exact=True)).to_be_enabled()


def test_switches_beside_the_answer_set_the_planes_service_which_answers_again(page: Page, scene: Scene) -> None:
    answers = scene.bus.reader(scene.bus.cell.plane("kinect"), Plane)
    tab(page, "Select")
    expect(page.get_by_label("Connected only")).to_be_enabled()
    for name, words in (("connected", "Connected only"), ("above", "Above it, too")):
        page.get_by_label(words).click()
        assert soon(lambda name=name: getattr(scene.planes, name), PATIENCE)  # type: ignore[misc]  # bound at once
        assert answers.take(PATIENCE) is not None
    page.screenshot(path=SHOTS / "switches.png")
    scene.planes.connected = scene.planes.above = False
    expect(page.get_by_label("Connected only")).not_to_be_checked()  # the page follows whoever sets it
    page.get_by_role("button", name="Clear").click()
    assert soon(lambda: count_near(pixels(page), RED) > 3000, PATIENCE)


def test_a_region_is_drawn_that_finds_look_in_until_it_is_cleared(page: Page, scene: Scene) -> None:
    scene.finder.gate.set()
    tab(page, "Find")
    page.keyboard.press("g")
    expect(page.get_by_text("Drag a rectangle around what is sought")).to_be_visible()
    corners = np.array([scene.pixel((x, y, 1.0)) for x, y in ((-0.08, -0.06), (0.04, 0.1))])
    drag(page, *corners.min(axis=0), *corners.max(axis=0))
    expect(page.get_by_text("Finds look only in the region that was drawn")).to_be_visible()
    expect(page.get_by_text("Held still:")).not_to_be_visible()
    assert soon(lambda: count_near(pixels(page), (0, 114, 178), 40) > 100, PATIENCE)
    page.screenshot(path=SHOTS / "region.png")
    goal = asked(page, scene)
    assert goal.region is not None
    assert goal.frame_id == FRAME
    np.testing.assert_allclose(goal.region.low, (-0.1, -0.08, 0.98), atol=0.006)  # the points are 5 mm apart
    np.testing.assert_allclose(goal.region.high, (0.06, 0.12, 1.02), atol=0.006)
    page.get_by_role("button", name="Seek everywhere").click()
    expect(page.get_by_text("Finds look everywhere.")).to_be_visible()
    assert asked(page, scene).region is None
    assert soon(lambda: count_near(pixels(page), (0, 114, 178), 40) < 100, PATIENCE)


def asked(page: Page, scene: Scene) -> FindObjectGoal:
    """What the finder is asked when the button is pressed."""
    before = len(scene.finder.goals)
    page.get_by_role("button", name="Find", exact=True).click()
    assert soon(lambda: len(scene.finder.goals) > before, PATIENCE)
    expect(page.get_by_role("button", name="Find", exact=True)).to_be_enabled()
    return scene.finder.goals[-1]


def test_a_cloud_is_downloaded_as_it_came(page: Page, scene: Scene, tmp_path: Path) -> None:
    tab(page, "Keep")
    with page.expect_download() as download:
        page.get_by_role("button", name="Cloud as .pcd").click()
    download.value.save_as(tmp_path / "kept.pcd")
    back = pcd.read(tmp_path / "kept.pcd").points
    assert back.tobytes() == room().tobytes()
    del scene


def test_a_page_of_the_scene_opens_from_disk(page: Page, chromium: Browser, tmp_path: Path) -> None:
    tab(page, "Keep")
    with page.expect_download() as download:
        page.get_by_role("button", name="Page of the scene").click()
    download.value.save_as(tmp_path / "scene.html")
    opened = open_page(chromium, (tmp_path / "scene.html").as_uri(), 640, 400)
    assert soon(lambda: count_near(pixels(opened), RED) > 300, PATIENCE)
    opened.context.close()


def test_a_picture_of_the_view_is_kept(page: Page, tmp_path: Path) -> None:
    tab(page, "Keep")
    with page.expect_download() as download:
        page.get_by_role("button", name="Picture of the view").click()
    download.value.save_as(tmp_path / "view.png")
    picture = np.asarray(Image.open(tmp_path / "view.png"), dtype=np.int16)
    assert count_near(picture, RED) > 5000


def test_a_second_browser_joins_and_sees_the_same(page: Page, chromium: Browser, scene: Scene) -> None:
    second = open_page(chromium, scene.page.link, 1024, 768)
    assert soon(lambda: count_near(pixels(second), RED) > 1000, PATIENCE)
    second.screenshot(path=SHOTS / "tablet.png")
    tab(page, "Scene")
    page.get_by_label("Clouds", exact=True).click()
    assert soon(lambda: count_near(pixels(second), RED) < 100, PATIENCE)
    page.get_by_label("Clouds", exact=True).click()
    assert soon(lambda: count_near(pixels(second), RED) > 1000, PATIENCE)
    second.context.close()


def test_what_is_found_has_one_label(page: Page, scene: Scene) -> None:
    del page
    nodes, name = scene.page.viser.scene._handle_from_node_name, "/scene/kinect/segment_2/name"
    around = table().segments[0].model_copy(update={"pose": pose_of(T_PIN), "size": (0.05, 0.05, 0.1)})
    scenes = scene.bus.writer(scene.bus.cell.scene("kinect"), SceneMessage)
    scenes.send(table())
    assert soon(lambda: name in nodes, PATIENCE)
    scenes.send(table().model_copy(update={"segments": (around,)}))
    assert soon(lambda: "/scene/kinect/segment_2" in nodes and name not in nodes, PATIENCE)
    scene.page.viser.scene.remove_by_name("/scene")


def table(height: float = 0.02) -> SceneMessage:
    """A surface across the view with an unknown thing on it, left of the panel."""
    T_surface = np.eye(4)
    T_surface[:3, 3] = (-0.35, 0.0, 1.2)
    T_thing = np.eye(4)
    T_thing[:3, 3] = (-0.3, 0.05, 1.0)
    thing = SceneSegment(
        label=2,
        support=0,
        points=100,
        centroid=Point(x=-0.3, y=0.05, z=1.0),
        pose=pose_of(T_thing),
        size=(0.1, 0.1, height),
        low=0.0,
        high=height,
    )
    surface = SupportSurface(
        pose=pose_of(T_surface),
        outline=((-0.2, -0.1), (0.1, -0.1), (0.1, 0.2), (-0.2, 0.2)),
        area=0.09,
        points=1000,
        rms=0.001,
    )
    return SceneMessage(header=Header(stamp=Time.now(), frame_id=FRAME), supports=(surface,), segments=(thing,))


def test_surfaces_and_things_are_drawn_and_a_thing_is_asked_what_it_is(page: Page, scene: Scene) -> None:
    scene.finder.gate.set()
    tab(page, "Scene")
    scene.bus.writer(scene.bus.cell.scene("kinect"), SceneMessage).send(table())
    assert soon(lambda: count_near(pixels(page), (213, 94, 0), 40) > 100, PATIENCE)
    page.screenshot(path=SHOTS / "scene.png")
    u, v = scene.pixel((-0.31, 0.06, 0.99))
    page.mouse.click(float(u), float(v))
    expect(page.get_by_text("unknown 2: a pin with probability 97%")).to_be_visible()
    u, v = scene.pixel((-0.5, 0.15, 1.2))
    page.mouse.click(float(u), float(v))
    expect(page.get_by_text("surface 1: finds look only there now")).to_be_visible()
    tab(page, "Find")
    page.get_by_role("button", name="Seek everywhere").click()
    expect(page.get_by_text("Finds look everywhere.")).to_be_visible()
    expect(page.get_by_role("button", name="Seek everywhere")).to_be_disabled()


def test_a_slider_changes_the_points_of_its_stage_and_the_running_service(page: Page, scene: Scene) -> None:
    small = scene.bus.reader(scene.bus.cell.voxel_points("kinect"), PointCloud2)
    tab(page, "Tune")
    page.get_by_role("combobox", name="Process").click()
    page.get_by_role("option", name="here/voxel").click()
    page.get_by_role("button", name="Freeze the picture").click()
    expect(page.get_by_text("Held still:")).to_be_visible()
    coarse = averaged(page)
    setting(page, "leaf").fill("0.01")
    setting(page, "leaf").press("Enter")
    expect(page.get_by_text("On the frozen cloud")).not_to_contain_text(f"{coarse:,} averaged")
    assert averaged(page) > 2 * coarse
    assert soon(lambda: count_near(pixels(page), (230, 159, 0)) > 2000, PATIENCE)
    page.screenshot(path=SHOTS / "tuned.png")
    scene.send(room())
    received = small.take(PATIENCE)
    assert received is not None
    assert received.message.width == averaged(page)
    page.get_by_role("button", name="Go on").click()
    expect(page.get_by_text("Held still:")).not_to_be_visible()


def setting(page: Page, name: str) -> Locator:
    """The box with the number of a slider."""
    return page.get_by_text(name, exact=True).locator("xpath=following::input[@type='text'][1]")


def test_the_finders_limits_say_of_each_point_what_became_of_it(page: Page, scene: Scene) -> None:
    scene.send(book_cloud((TOY_BLOCK, T_WORLD_BLOCK)))
    expect(page.get_by_text("of 307,200 points drawn")).to_be_visible()
    tab(page, "Tune")
    page.get_by_role("combobox", name="Process").click()
    page.get_by_role("option", name="here/finder").click()
    page.get_by_role("button", name="Freeze the picture").click()
    expect(page.get_by_text("On the frozen cloud: 2 surfaces, 2 things.")).to_be_visible()
    things = count_in_legend(page, "of a thing")
    assert things > 500
    page.screenshot(path=SHOTS / "limits.png")
    setting(page, "smallest").fill("10000")
    setting(page, "smallest").press("Enter")
    expect(page.get_by_text("On the frozen cloud: 2 surfaces, 0 things.")).to_be_visible()
    assert count_in_legend(page, "of a thing") == 0
    assert count_in_legend(page, "of a thing too small (smallest)") >= things
    assert soon(lambda: count_near(pixels(page), (204, 121, 167)) > 20, PATIENCE)
    page.screenshot(path=SHOTS / "limits_small.png")
    setting(page, "smallest").fill("60")
    setting(page, "smallest").press("Enter")
    expect(page.get_by_text("On the frozen cloud: 2 surfaces, 2 things.")).to_be_visible()
    page.get_by_role("button", name="Go on").click()
    expect(page.get_by_text("On the frozen cloud")).not_to_be_visible()
    scene.send(room())


def count_in_legend(page: Page, name: str) -> int:
    row = page.locator("table.zs tr").filter(has=page.get_by_text(name, exact=True))
    return int(row.locator("td").last.inner_text().replace(",", ""))


def test_the_tuned_settings_run_over_a_recording(page: Page, tmp_path: Path) -> None:
    network = MemoryNetwork()
    recorded = record(lambda: Bus(MemoryLink(network), Cell("other")), tmp_path / "three.mcap")
    tab(page, "Tune")
    page.get_by_role("combobox", name="Process").click()
    page.get_by_role("option", name="here/finder").click()
    page.get_by_role("button", name="Run these settings over it").click()
    expect(page.get_by_text("There is no file")).to_be_visible()
    page.get_by_text("Recorded file", exact=True).locator("xpath=following::input[1]").fill(str(recorded.path))
    page.get_by_role("button", name="Run these settings over it").click()
    expect(page.get_by_role("button", name="Stop the run")).to_be_enabled()
    goals = len(rerun(recorded.path, type_files.load(type_files.shipped_folder())))
    expect(page.get_by_text(f"{goals} goals, 0 changed, 0 of them for the worse")).to_be_visible()
    setting(page, "lowest").fill("0.05")
    setting(page, "lowest").press("Enter")
    expect(page.get_by_text("lowest is 0.05")).to_be_visible()
    page.get_by_role("button", name="Run these settings over it").click()
    expect(page.get_by_text(f"{goals} goals, {goals} changed, {goals} of them for the worse")).to_be_visible()
    worse = page.get_by_role("cell", name="1 of 1 are found no more, 2 things, now 0")
    expect(worse).to_have_count(goals)
    worse.last.scroll_into_view_if_needed()
    page.screenshot(path=SHOTS / "rerun.png")
    page.get_by_role("button", name="Run these settings over it").click()
    page.get_by_role("button", name="Stop the run").click()
    expect(page.get_by_text("cancelled")).to_be_visible()


def averaged(page: Page) -> int:
    """How many points the voxel filter leaves of the frozen cloud, as the page says."""
    words = page.get_by_text("On the frozen cloud")
    expect(words).to_be_visible()
    found = re.search(r"([\d,]+) averaged", words.inner_text())
    assert found is not None
    return int(found[1].replace(",", ""))


def test_a_recording_is_made_and_played(page: Page, scene: Scene) -> None:
    tab(page, "Keep")
    expect(page.get_by_text("recorder: idle")).to_be_visible()
    page.get_by_role("button", name="Record", exact=True).click()
    expect(page.get_by_text("recorder: recording")).to_be_visible()
    scene.send(room())
    expect(page.get_by_text(re.compile(r"\.mcap: .* [1-9]\d* messages"))).to_be_visible()
    page.get_by_role("button", name="Stop recording").click()
    expect(page.get_by_text("recorder: idle")).to_be_visible()
    (file,) = scene.recordings.glob("*.mcap")
    clouds = scene.bus.reader(scene.bus.cell.points("kinect"), PointCloud2)
    page.get_by_text("Recording", exact=True).locator("xpath=following::input[1]").fill(str(file))
    page.get_by_role("button", name="Open").click()
    expect(page.get_by_text(f"player: paused {file.name}")).to_be_visible()
    page.screenshot(path=SHOTS / "recorded.png")
    page.mouse.click(20, 400)  # away from what takes keys for itself
    page.keyboard.press("Space")
    received = clouds.take(PATIENCE)
    assert received is not None
    assert points_of(received.message).tobytes() == room().tobytes()


def test_clouds_of_one_point_and_of_two_million_without_colour(page: Page, scene: Scene) -> None:
    scene.send(room().reshape(-1)[:1].reshape(1, 1))
    expect(page.get_by_text("1 point drawn, colour rgb")).to_be_visible()
    millions = np.random.default_rng(3).normal((0, 0, 2), 0.2, (2_000_000, 3))
    scene.send(from_xyz(millions))
    expect(page.get_by_text(re.compile(r"live, 5,9\d\d of 2,000,000 points drawn, colour height"))).to_be_visible()
    scene.send(from_xyz(np.full((1, 5, 3), np.nan)))
    expect(page.get_by_text("0 of 5 points drawn")).to_be_visible()
    expect(page.get_by_text(re.compile("no new cloud for"))).to_be_visible()
    page.screenshot(path=SHOTS / "stopped.png")


def test_an_open_page_finds_its_way_back_after_a_restart(
    chromium: Browser, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    settings = viewer.Settings(port=free_port(), budget=6000)
    with viewer.open_page(settings) as first:
        opened = open_page(chromium, first.link)
        first.say(missing_router(("tcp/192.0.2.7:7447",)))
        expect(opened.get_by_text("Nothing is running")).to_be_visible()
        opened.screenshot(path=SHOTS / "nothing.png")
    with scene_of(settings, tmp_path) as scene:
        expect(opened.get_by_text("No camera publishes.")).to_be_visible()
        scene.send(room())
        assert soon(lambda: count_near(pixels(opened), RED) > 300, PATIENCE)
    opened.context.close()
