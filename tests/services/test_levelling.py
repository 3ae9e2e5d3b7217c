"""A running camera is levelled by the table it sees."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from tests.services.running import running
from tests.services.told_health import tell_health
from tests.services.waiting import DEADLINE

from zsight import camera
from zsight.client import CellClient
from zsight.errors import DeadlinePassed, NobodyAnswers, UsageError, ZsightError
from zsight.levelling import level_of
from zsight.parameters import Parameters, Saved, serve_parameters
from zsight.settings import parse
from zsight.sources import open_source
from zsight.transforms import TransformBuffer
from zsight_core.points import from_xyz
from zsight_core.transform import from_rpy, inverse, quaternion
from zsight_protocol.geometry import TransformList

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from numpy.typing import NDArray

    from zsight.bus import Bus

    Join = Callable[[], Bus]

pytestmark = pytest.mark.usefixtures("warm_kernels")

TABLE = 0.7747


def book_pose() -> NDArray[np.float64]:
    """T_world_camera (4, 4) of the book's camera."""
    buffer, source = TransformBuffer(), open_source("book", frame="")
    assert source.transforms is not None
    buffer.put(source.transforms, static=True)
    return buffer.lookup("base_link", source.frame_id)


def pose_text(T: NDArray[np.float64]) -> str:
    return " ".join(str(value) for value in (*T[:3, 3], *quaternion(T)))


@pytest.fixture
def start(
    join_memory: Join, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Iterator[Callable[..., tuple[CellClient, camera.Settings]]]:
    """Start a camera of the book's scene that is taken to stand somewhere."""
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    contexts = []

    def started(pose: str) -> tuple[CellClient, camera.Settings]:
        bus, settings = join_memory(), camera.Settings(pose=pose)
        saved = Saved(bus.cell.namespace, "front")
        serve_parameters(bus, "desk", "front", "camera", Parameters(settings, saved))
        tell_health(bus, "front")
        contexts.append(running(camera.run, bus, settings))
        contexts[-1].__enter__()
        return CellClient(join_memory()), settings

    yield started
    for context in contexts:
        context.__exit__(None, None, None)


def told_pose(cell: CellClient) -> NDArray[np.float64]:
    buffer = TransformBuffer()
    reader = cell.bus.reader(cell.bus.cell.tf_static, TransformList)
    received = reader.take(DEADLINE)
    assert received is not None
    buffer.put(received.message, static=True)
    return buffer.lookup("base_link", "kinect_pc_frame")


def test_a_camera_with_a_wrong_pose_is_put_right(start: Callable[..., tuple[CellClient, camera.Settings]]) -> None:
    truth = book_pose()
    crooked = from_rpy((0.02, 0, 0.05), (0.03, 0.1, 0)) @ truth
    cell, settings = start(pose_text(crooked))
    np.testing.assert_allclose(told_pose(cell), crooked, atol=1e-9)
    level = cell.level_camera(surface_height=TABLE, timeout=DEADLINE)
    now = told_pose(cell)
    np.testing.assert_allclose(now, level.T_world_camera, atol=1e-5)
    np.testing.assert_allclose(now[2], truth[2], atol=1e-4)  # up in the camera's frame, and its height
    np.testing.assert_allclose(now[:2, 3], crooked[:2, 3], atol=1e-5)  # which no table tells
    assert (level.height, level.pitch, level.roll) == pytest.approx((1.81, 1.2, 0.0), abs=1e-3)
    assert settings.pose == level.setting
    link = inverse(told_pose(cell)) @ now
    np.testing.assert_allclose(link, np.eye(4), atol=1e-9)


def test_measuring_alone_changes_nothing(start: Callable[..., tuple[CellClient, camera.Settings]]) -> None:
    cell, settings = start("")
    level = cell.level_camera(surface_height=TABLE, timeout=DEADLINE, apply=False)
    np.testing.assert_allclose(level.T_world_camera, book_pose(), atol=1e-4)
    assert settings.pose == ""


def test_what_is_saved_holds_for_the_next_start(start: Callable[..., tuple[CellClient, camera.Settings]]) -> None:
    cell, _ = start("")
    level = cell.level_camera(surface_height=TABLE, timeout=DEADLINE, save=True)
    assert Saved(cell.bus.cell.namespace, "front").read() == {"pose": level.setting}


def test_a_pose_that_is_none_is_refused_at_the_start() -> None:
    for wrong in ("1 2 3", "nowhere", "0 0 0 0 0 0 0"):
        with pytest.raises(UsageError, match="expected seven numbers"):
            parse(camera.Settings, {"pose": wrong})


@pytest.mark.parametrize("height", [float("nan"), float("inf"), -101.0])
def test_a_height_that_is_none_of_a_surface_is_refused(height: float) -> None:
    with pytest.raises(UsageError, match=r"m high; expected -100 to 100 m"):
        level_of(next(open_source("book", frame="").clouds()), height)


def test_no_camera_and_no_surface_are_told(join_memory: Join) -> None:
    cell = CellClient(join_memory())
    with pytest.raises(DeadlinePassed, match="is the camera running"):
        cell.level_camera(timeout=0.01)
    dust = np.random.default_rng(1).uniform(0.5, 2.0, (1, 40, 3))
    with pytest.raises(ZsightError, match="point the camera at a table"):
        level_of(from_xyz(dust), 0.0)


def test_clouds_of_no_process_of_the_cell_cannot_be_moved(
    start: Callable[..., tuple[CellClient, camera.Settings]], monkeypatch: pytest.MonkeyPatch
) -> None:
    cell, _ = start("")
    monkeypatch.setattr("zsight.levelling.ask_health", lambda _: [])
    with pytest.raises(NobodyAnswers, match="no process writes"):
        cell.level_camera(surface_height=TABLE, timeout=DEADLINE)
