"""A cell of real processes: used, hurt, and stopped in every way there is."""

from __future__ import annotations

import json
import os
import signal
import socket
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from tests.services.waiting import Arrivals, soon
from tests.system.commands import DEADLINE, Command, free_port, is_alive, leftovers, run, shared_memory_of

from zsight.bus.zenoh_link import open_link
from zsight.network import Network
from zsight_core.files import pcd
from zsight_core.points import from_xyz
from zsight_core.transform import from_quaternion

if TYPE_CHECKING:
    from collections.abc import Iterator

    from tests.system.commands import Ended

pytestmark = [
    pytest.mark.system,
    pytest.mark.usefixtures("warm_kernels"),
    pytest.mark.skipif(not Path("/proc/self/maps").exists(), reason="processes are looked at as Linux has them"),
]


class Cell:
    """Where a cell of this test is, and how commands find it."""

    def __init__(self, namespace: str, folder: Path) -> None:
        self.endpoint = f"tcp/127.0.0.1:{free_port()}"
        self.namespace = namespace
        self.environment = {
            "ZSIGHT_CONNECT": self.endpoint,
            "ZSIGHT_LISTEN": self.endpoint,
            "ZSIGHT_NAMESPACE": namespace,
            "ZSIGHT_HOST": "here",
            "XDG_RUNTIME_DIR": str(folder),
        }
        self.folder = folder

    def run(self, *arguments: object) -> Ended:
        return run(*arguments, **self.environment)

    def up(self, *arguments: object) -> Command:
        return Command("up", *arguments, **self.environment)

    def is_listening(self) -> bool:
        with socket.socket() as probe:
            host, port = self.endpoint.removeprefix("tcp/").split(":")
            return probe.connect_ex((host, int(port))) == 0


@pytest.fixture
def cell(request: pytest.FixtureRequest, tmp_path: Path) -> Cell:
    name = "".join(letter for letter in request.node.name if letter.isalnum() and letter.islower())
    return Cell(f"system-{name[:30]}", tmp_path)


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Cell, Command]]:
    """The chapter's cell, up for the tests that only use it."""
    cell = Cell("system-chapter", tmp_path_factory.mktemp("cell"))
    with cell.up() as up:
        up.children()
        yield cell, up


# Used.


def test_every_process_tells_of_itself(running: tuple[Cell, Command]) -> None:
    cell, up = running
    nodes = {node["process"]: node for node in cell.run("node", "list", "--json").json["nodes"]}
    assert {name: node["pid"] for name, node in nodes.items()} == up.children()
    assert {(node["host"], node["level"], node["alive"]) for node in nodes.values()} == {("here", "ok", True)}
    topics = {topic["key"]: topic for topic in cell.run("topic", "list", "--json").json["topics"]}
    points = topics[f"{cell.namespace}/kinect/points"]
    assert [writer["process"] for writer in points["writers"]] == ["camera"]
    assert {reader["process"] for reader in points["readers"]} == {"voxel", "planes", "finder"}


def test_a_topic_tells_losses_and_the_time_of_each_stage(running: tuple[Cell, Command]) -> None:
    cell, _ = running
    points = f"{cell.namespace}/kinect/points"
    assert cell.run("topic", "hz", f"{points}/voxel", "--count", 3).code == 0  # the voxel filter has taken some
    info = cell.run("topic", "info", points, "--json").json
    (camera,) = info["writers"]
    assert (camera["host"], camera["process"]) == ("here", "camera")
    assert camera["sent"] >= 3
    assert camera["since_stamp"]["p50_ms"] > 0
    voxel = next(reader for reader in info["readers"] if reader["process"] == "voxel")
    assert voxel["received"] >= 3
    assert {"superseded", "lost", "late", "refused", "rate_hz", "age_of_last"} <= set(voxel)
    assert 0 < voxel["on_the_way"]["p50_ms"] <= voxel["since_stamp"]["max_ms"]
    told = cell.run("topic", "info", points).err
    assert "written by here/camera" in told
    assert "on the way" in told
    node = cell.run("node", "info", "voxel", "--json").json
    assert [writer["key"] for writer in node["writers"] if "/@" not in writer["key"]] == [f"{points}/voxel"]
    assert cell.run("topic", "info", f"{cell.namespace}/elsewhere/points").code == 3


def test_topics_are_looked_at_again_and_again(running: tuple[Cell, Command]) -> None:
    cell, _ = running
    points = f"{cell.namespace}/kinect/points"
    looks = [json.loads(line) for line in cell.run("topic", "info", points, "--count", 2, "--json").out.splitlines()]
    before, after = (look["writers"][0]["sent"] for look in looks)
    assert after > before
    lists = [json.loads(line) for line in cell.run("topic", "list", "--duration", 1.5, "--json").out.splitlines()]
    assert [points in {topic["key"] for topic in one["topics"]} for one in lists] == [True, True]


def test_the_block_is_found_over_the_network(running: tuple[Cell, Command]) -> None:
    cell, _ = running
    ended = cell.run("find", "toy_block", "--new", "--json")
    assert ended.code == 0
    np.testing.assert_allclose(ended.json["objects"][0]["position"], (0.5, -0.35, 0.7922), atol=0.001)
    table = cell.run("find", "1002", "--json").json["objects"][0]
    assert table["position"][2] == pytest.approx(0.7747, abs=0.0005)
    assert cell.run("find", "toy_blok").code == 2


def test_clouds_come_off_the_wire(running: tuple[Cell, Command]) -> None:
    cell, _ = running
    whole, small = cell.folder / "whole.pcd", cell.folder / "small.pcd"
    assert cell.run("snapshot", "-o", whole).code == 0
    assert cell.run("snapshot", f"{cell.namespace}/kinect/points/voxel", "-o", small).code == 0
    assert pcd.read(whole).points.shape == (480, 640)
    assert 1000 < pcd.read(small).points.size < 30_000
    assert cell.run("topic", "hz", f"{cell.namespace}/kinect/points", "--count", 5, "--json").json["messages"] == 5


def test_ctrl_c_ends_what_only_looks(running: tuple[Cell, Command]) -> None:
    cell, _ = running
    with Command("topic", "echo", f"{cell.namespace}/kinect/points", "--json", **cell.environment) as echo:
        assert echo.process.stdout is not None
        assert '"width": 640' in echo.process.stdout.readline()
        echo.interrupt()
        assert echo.ended().code == 130


def test_a_second_cell_on_the_same_port_says_so(running: tuple[Cell, Command]) -> None:
    cell, up = running
    same, other = cell.run("up"), cell.run("up", "--namespace", "system-other")
    assert (same.code, other.code) == (3, 3)
    assert f"cell {cell.namespace} on {cell.endpoint} is up already" in same.err
    assert f"port {cell.endpoint.rpartition(':')[2]} on 127.0.0.1 is taken" in other.err
    assert all(map(is_alive, up.children().values()))


def test_a_killed_service_is_seen_told_and_started_again(running: tuple[Cell, Command]) -> None:
    cell, up = running
    before = up.children()["voxel"]
    seen: Arrivals[bool] = Arrivals()
    link = open_link(Network().on(cell.endpoint))
    watch = link.watch_alive(f"{cell.namespace}/@alive/here/voxel", lambda _, alive: seen.add(alive))
    assert seen.wait(1) == [True]
    os.kill(before, signal.SIGKILL)
    assert seen.wait(2) == [True, False]
    assert seen.wait(3) == [True, False, True]
    watch.close()
    link.close()
    up.wait_for(r"^voxel died \(killed by SIGKILL\); starting it again")
    after = int(up.wait_for(r"^voxel started again as process (\d+)").group(1))
    assert (is_alive(before), is_alive(after)) == (False, True)
    assert cell.run("snapshot", f"{cell.namespace}/kinect/points/voxel", "-o", cell.folder / "again.pcd").code == 0
    told = cell.run("node", "info", "voxel", "--json").json["supervised"]
    assert (told["state"], told["pid"], told["starts"]) == ("running", after, 2)
    assert told["crash"]["reason"] == "killed by SIGKILL"
    assert "it ended" in cell.run("node", "info", "here/voxel").err
    whole = {row["process"]: row for row in cell.run("up", "--hosts", "--json").json["processes"]}
    assert whole["voxel"]["last_end"] == "killed by SIGKILL"
    assert {row["host"] for row in whole.values()} == {"here"}
    assert set(whole) == set(up.children())


def test_a_service_that_hangs_is_told(cell: Cell) -> None:
    (cell.folder / "cell.toml").write_text('[process.router]\n[process.camera]\nsource = "ellipse"\n')
    with cell.up(cell.folder / "cell.toml") as up:

        def state() -> object:
            rows = cell.run("up", "--hosts", "--json").json["processes"]
            return next(row["state"] for row in rows if row["process"] == "camera")

        hung = up.children()["camera"]
        assert state() == "running"
        os.kill(hung, signal.SIGSTOP)
        try:
            assert soon(lambda: state() == "silent", DEADLINE)
            told = cell.run("doctor")
            assert told.code == 1
            assert f"failed   process here/camera: pid {hung} runs and does not answer" in told.out
        finally:
            os.kill(hung, signal.SIGCONT)
        assert soon(lambda: state() == "running", DEADLINE)


# Stopped.


def test_ctrl_c_stops_all_within_two_seconds_and_leaves_nothing(cell: Cell) -> None:
    with cell.up() as up:
        pids = up.children()
        held = shared_memory_of(pids)
        started = time.monotonic()
        up.interrupt()
        ended = up.ended()
        took = time.monotonic() - started
    assert (ended.code, ended.err.splitlines()[-1]) == (0, "down")
    assert "killed" not in ended.err
    assert took < 2.0, f"{took:.2f} s"
    assert leftovers(pids, held) == []
    assert not cell.is_listening()
    assert list(cell.folder.iterdir()) == []


def test_a_cell_in_the_background_is_stopped_by_down(cell: Cell) -> None:
    (cell.folder / "cell.toml").write_text('[process.router]\n[process.camera]\nsource = "ellipse"\n')
    ended = cell.run("up", cell.folder / "cell.toml", "--detach")
    assert ended.code == 0
    nodes = {node["process"]: node["pid"] for node in cell.run("node", "list", "--json").json["nodes"]}
    assert sorted(nodes) == ["camera", "router"]
    assert cell.run("down").code == 0
    assert leftovers(nodes, set()) == []
    assert not cell.is_listening()
    assert cell.run("down").code == 3


def test_of_two_starts_at_once_one_is_told_that_the_cell_is_up(cell: Cell) -> None:
    (cell.folder / "cell.toml").write_text("[process.router]\n")
    with ThreadPoolExecutor() as threads:
        starts = [threads.submit(cell.run, "up", cell.folder / "cell.toml", "--detach") for _ in range(2)]
        ended = sorted((start.result(DEADLINE) for start in starts), key=lambda one: one.code)
    assert [one.code for one in ended] == [0, 3]
    assert "is up already" in ended[1].err
    assert cell.run("down").code == 0


def test_a_killed_supervisor_takes_its_processes_along(cell: Cell) -> None:
    (cell.folder / "cell.toml").write_text("[process.router]\n[process.camera]\n[process.voxel]\n")
    with cell.up(cell.folder / "cell.toml") as up:
        pids = up.children()
        held = shared_memory_of(pids)
        up.process.kill()
        up.process.wait()
        assert soon(lambda: leftovers(pids, held) == [], DEADLINE), leftovers(pids, held)
    assert not cell.is_listening()


def test_shared_memory_of_killed_processes_is_removed_by_the_next_that_starts(cell: Cell) -> None:
    (cell.folder / "cell.toml").write_text("[process.router]\n[process.camera]\n[process.voxel]\n")
    with cell.up(cell.folder / "cell.toml") as up:
        pids = up.children()
        assert cell.run("topic", "hz", f"{cell.namespace}/kinect/points/voxel", "--count", 2).code == 0
        held = shared_memory_of(pids)
        up.process.send_signal(signal.SIGSTOP)  # it would start again what dies
        for pid in (*pids.values(), up.process.pid):
            os.kill(pid, signal.SIGKILL)
        up.process.wait()
    assert soon(lambda: not any(map(is_alive, pids.values())), DEADLINE)
    assert [path for path in held if path.exists()]
    with Command("run", "router", **cell.environment):
        assert soon(cell.is_listening, DEADLINE)
        assert soon(lambda: not any(path.exists() for path in held), DEADLINE)


def test_a_service_whose_settings_make_no_sense_ends_the_start(cell: Cell) -> None:
    (cell.folder / "cell.toml").write_text('[process.router]\n[process.camera]\nsource = "boook"\n')
    ended = cell.run("up", cell.folder / "cell.toml")
    assert ended.code == 2
    assert "no scene is called 'boook'" in ended.err
    assert not cell.is_listening()


# A camera that plays a file.


def test_a_snapshot_of_a_file_is_the_file(cell: Cell) -> None:
    rng = np.random.default_rng(11)
    points = from_xyz(rng.normal(size=(48, 64, 3)), rng.integers(0, 256, (48, 64, 3)))
    for axis in "xyz":
        points[axis][rng.random(points.shape) < 0.2] = np.nan
    viewpoint = (1.0, -2.0, 0.5, 0.8, 0.0, 0.6, 0.0)
    source, taken = cell.folder / "source.pcd", cell.folder / "taken.pcd"
    pcd.write(source, points, viewpoint=viewpoint)
    (cell.folder / "cell.toml").write_text(
        f'[process.router]\n[process.camera]\nsource = "{source}"\npose = "viewpoint"\nrate = 20\n'
    )
    with cell.up(cell.folder / "cell.toml") as up:
        up.children()
        report = cell.run("snapshot", "-o", taken, "--json").json
        up.interrupt()
        up.ended()
    assert (report["width"], report["height"]) == (64, 48)
    back = pcd.read(taken)
    assert back.points.shape == points.shape
    assert back.points.dtype == points.dtype
    for name in ("x", "y", "z", "rgb"):
        assert back.points[name].tobytes() == points[name].tobytes(), name
    for got, expected in zip((back.viewpoint,), (viewpoint,), strict=True):
        T = [from_quaternion(v[:3], (*v[4:], v[3])) for v in (got, expected)]
        np.testing.assert_allclose(T[0], T[1], atol=1e-6)


def test_the_last_answer_is_bundled_from_what_the_recorder_keeps_in_memory(cell: Cell) -> None:
    (cell.folder / "cell.toml").write_text(
        "[process.router]\n[process.camera]\n[process.finder]\n"
        f"[process.recorder]\nring = 20\nafter = 0.5\nfolder = '{cell.folder}'\n"
    )
    with cell.up(cell.folder / "cell.toml") as up:
        up.children()
        answer = cell.folder / "answer.mcap"
        assert cell.run("find", "toy_block", "--json").json["status"] == "found"
        ended = cell.run("bundle", "last", "-o", answer, "--json")
        assert (ended.code, ended.json["object_type"], ended.json["status"]) == (0, "toy_block", "found")
        (again,) = cell.run("bag", "rerun", answer, "--json").json["goals"]
        assert (again["now"], again["regression"], again["new"]) == ("found", "", 0)
        refused = cell.run("bundle", "last", "-o", answer)
        assert refused.code == 2
        assert "is there already" in refused.err
