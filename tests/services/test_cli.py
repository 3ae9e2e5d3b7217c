"""The words, exit codes and JSON of the command line, without processes of its own."""

from __future__ import annotations

import itertools
import json
import sys
import threading
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from tests.services.gated_work import Gated
from tests.services.running import running
from tests.services.told_health import tell_health
from tests.services.waiting import DEADLINE, known, soon

from zsight import camera, cli, finder, planes, voxel
from zsight.action.server import ActionServer, Policy
from zsight.bus import Bus
from zsight.bus.zenoh_link import open_link
from zsight.client import CellClient
from zsight.log_book import LogBook
from zsight.parameters import Parameters, Saved, serve_parameters
from zsight.sources import open_source, viewpoint_matrix
from zsight_core.files import pcd
from zsight_core.points import colours, from_xyz, xyz
from zsight_core.transform import from_quaternion, transform_xyz
from zsight_protocol.channels import Cell
from zsight_protocol.find_object import FindObjectGoal
from zsight_protocol.geometry import TransformList

if TYPE_CHECKING:
    from collections.abc import Iterator

    from zsight.network import Network

pytestmark = pytest.mark.usefixtures("warm_kernels")

POSE = "0.027 0 1.81 -0.694989044 0.694989044 -0.130346571 0.130346571"
_names = (f"cli{number}" for number in itertools.count())


@dataclass(frozen=True)
class Ended:
    """How a command ended."""

    code: int
    out: str
    err: str

    @property
    def json(self) -> Any:
        """The one JSON object on stdout."""
        (line,) = self.out.splitlines()
        value = json.loads(line, parse_constant=lambda word: pytest.fail(f"{word} is no JSON"))
        assert isinstance(value, dict)
        return value


class Zsight:
    """Runs commands in this process."""

    def __init__(self, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
        self._capsys = capsys
        self._monkeypatch = monkeypatch
        monkeypatch.setattr("zsight.shared_memory.leave", lambda: 0)  # this process goes on after the command

    def __call__(self, *arguments: object) -> Ended:
        self._monkeypatch.setattr("sys.argv", ["zsight", *map(str, arguments)])
        self._capsys.readouterr()
        with pytest.raises(SystemExit) as left:
            cli.main()
        out, err = self._capsys.readouterr()
        assert "Traceback" not in err
        assert isinstance(left.value.code, int)
        return Ended(left.value.code, out, err)


@pytest.fixture
def zsight(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Zsight:
    return Zsight(capsys, monkeypatch)


@pytest.fixture(scope="module")
def book(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The book's cloud in a file, with where it was seen from."""
    path = tmp_path_factory.mktemp("clouds") / "book.pcd"
    x, y, z, qx, qy, qz, qw = map(float, POSE.split())
    pcd.write(path, next(open_source("book", frame="").clouds()), viewpoint=(x, y, z, qw, qx, qy, qz))
    return path


# Words.


def test_help_and_version(zsight: Zsight) -> None:
    assert "find" in zsight("--help").out
    assert zsight("version").out == zsight("--version").out
    assert zsight("find", "-h").code == 0
    assert "--leaf" in zsight("run", "voxel", "--help").out
    assert "voxel-grid" in zsight("run", "--help").out


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["fnd"], "No such command 'fnd'"),
        (["find"], "Missing argument 'TYPE'"),
        (["find", "cube", "--fast"], "No such option"),
        (["find", "cube", "--timeout", "soon"], "Invalid value for '--timeout'"),
        (["find", "cube", "--timeout", "0"], "greater than or equal to 0.01"),
        (["find", "cube", "--region", "1 2 3"], "six numbers are needed"),
        (["find", "cube", "--region", "0 0 0 1 1 0"], "low < high on every axis"),
        (["find", "cube", "--camera-pose", "0 0 0 0 0 0 1"], "--camera-pose needs --cloud FILE"),
        (["find", "cube", "--cloud", "x.pcd", "--frame", "world"], "--frame means nothing with --cloud"),
        (["run"], ""),
        (["run", "voxl"], "did you mean voxel"),
        (["run", "voxel", "--leef", "1"], "no setting is called leef"),
        (["run", "voxel", "--leaf", "-1"], "greater than 0"),
        (["run", "voxel", "0.1"], "expected a setting as --name value"),
        (["up", "absent.toml"], "absent.toml: cannot be read"),
        (["demo", "--scene", "boook"], "no scene is called 'boook'"),
        (["plane", "absent.pcd", "--patch", "1", "2", "3"], ""),
        (["snapshot", "Nonsense", "-o", "x.pcd"], "key is 'Nonsense'"),
        (["bench", "nonsense"], "no bench is called 'nonsense'"),
    ],
)
def test_bad_usage_is_said_with_exit_code_2(
    zsight: Zsight,
    arguments: list[str],
    words: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    reachable: Network,
) -> None:
    del reachable
    monkeypatch.chdir(tmp_path)
    ended = zsight(*arguments)
    assert (ended.code, words in ended.err) == (2, True), ended.err
    assert list(tmp_path.iterdir()) == []


# Clouds in files.


def test_find_in_a_file(zsight: Zsight, book: Path) -> None:
    ended = zsight("find", "toy_block", "--cloud", book, "--camera-pose", POSE, "--json")
    assert ended.code == 0
    report = ended.json
    assert (report["status"], report["code"], report["frame_id"]) == ("found", 0, "world")
    assert set(report) >= {"status", "code", "stamp_ns", "frame_id", "objects", "p_absent", "report", "timings_ms"}
    (block,) = report["objects"]
    assert set(block) >= {
        "type",
        "score",
        "position",
        "orientation",
        "size",
        "covariance",
        "visible_fraction",
        "support",
    }
    np.testing.assert_allclose(block["position"], (0.5, -0.35, 0.7922), atol=0.001)
    assert (len(block["orientation"]), len(block["covariance"])) == (4, 36)
    assert block["size"] == [0.035, 0.2, 0.035]
    assert block["measured_height"] == pytest.approx(0.035, abs=0.001)


def test_the_files_own_viewpoint_can_be_taken(zsight: Zsight, book: Path) -> None:
    report = zsight("find", "1000", "--cloud", book, "--camera-pose", "viewpoint", "--json").json
    np.testing.assert_allclose(report["objects"][0]["position"], (0.5, -0.35, 0.7922), atol=0.001)


def test_for_people_the_answer_is_words_on_stderr(zsight: Zsight, book: Path) -> None:
    ended = zsight("find", "toy_block", "--cloud", book, "--camera-pose", POSE)
    assert (ended.code, ended.out) == (0, "")
    assert "toy_block" in ended.err


def test_what_is_not_there_is_not_found(zsight: Zsight, book: Path) -> None:
    ended = zsight("find", "mug", "--cloud", book, "--camera-pose", POSE, "--all", "--json")
    assert (ended.code, ended.json["status"], ended.json["objects"]) == (1, "not_found", [])


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["toy_blok"], "did you mean toy_block"),
        ([""], "no object type is called ''"),
        (["toy_block", "--camera-pose", "1 2 3"], "expected seven numbers"),
        (["toy_block", "--known-height", "0.77"], "give the camera's pose"),
        (["toy_block", "--catalogue", "nowhere"], "nowhere does not exist"),
    ],
)
def test_a_bad_question_about_a_file(zsight: Zsight, book: Path, arguments: list[str], words: str) -> None:
    ended = zsight("find", *arguments, "--cloud", book, "--json")
    assert (ended.code, ended.out) == (2, "")
    assert words in ended.err


@pytest.mark.parametrize("command", [["find", "cube", "--cloud"], ["segment"], ["downsample"], ["cloud", "info"]])
@pytest.mark.parametrize("content", [None, b"", b"VERSION .7\nFIELDS x y z\n", b"\x89PNG"])
def test_bad_files_are_named(zsight: Zsight, tmp_path: Path, command: list[str], content: bytes | None) -> None:
    path = tmp_path / "bad.pcd"
    if content is not None:
        path.write_bytes(content)
    ended = zsight(*command, path)
    assert (ended.code, ended.out) == (2, "")
    assert ended.err.startswith("zsight: ")
    assert "bad.pcd" in ended.err


@pytest.mark.parametrize(
    ("command", "advice"),
    [
        (["calibrate", "level", "BOOK", "-o", "nowhere/pose.toml"], "see whether it and its folder are there"),
        (["keys", "init", "localhost", "--folder", "file/keys"], "see whether its folder is one"),
    ],
    ids=["missing", "file"],
)
def test_what_the_system_refuses_is_named(
    zsight: Zsight, book: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: list[str], advice: str
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("file").touch()
    ended = zsight(*(book if argument == "BOOK" else argument for argument in command))
    assert ended.code == 2
    assert ended.err.endswith(f": {advice}\n")
    assert command[-1].split("/")[0] in ended.err


def test_a_cloud_of_holes_is_said(zsight: Zsight, tmp_path: Path) -> None:
    path = tmp_path / "holes.pcd"
    pcd.write(path, from_xyz(np.full((4, 5, 3), np.nan)))
    for command in (["find", "cube", "--cloud", path], ["segment", path]):
        ended = zsight(*command)
        assert (ended.code, "finite" in ended.err) == (2, True)


def test_segment(zsight: Zsight, book: Path, tmp_path: Path) -> None:
    labels = tmp_path / "labels.npy"
    ended = zsight("segment", book, "--labels", labels, "--camera-pose", POSE, "--json")
    assert ended.code == 0
    report = ended.json
    numbers = [float(word) for word in POSE.split()]
    T_world_camera = from_quaternion(numbers[:3], numbers[3:])
    centres = [T_world_camera[:3, :3] @ o["centroid"] + T_world_camera[:3, 3] for o in report["objects"]]
    nearest = int(np.argmin([np.linalg.norm(centre - (0.5, -0.35, 0.79)) for centre in centres]))
    assert np.linalg.norm(centres[nearest] - (0.5, -0.35, 0.79)) < 0.02
    block = report["objects"][nearest]
    assert max(block["size"]) == pytest.approx(0.2, abs=0.006)
    saved = np.load(labels)
    assert (saved.shape, saved.dtype) == ((480, 640), np.int32)
    for entry in report["objects"]:
        assert np.count_nonzero(saved == entry["label"]) == entry["points"]
    assert set(np.unique(saved)) <= {-1, 0, 1, *(entry["label"] for entry in report["objects"])}
    assert zsight("segment", book, "--labels", labels).code == 2
    assert zsight("segment", book, "--labels", labels, "--force").code == 0


def test_downsample(zsight: Zsight, book: Path, tmp_path: Path) -> None:
    out = tmp_path / "small.pcd"
    ended = zsight("downsample", book, "--leaf", "0.05", "-o", out, "--json")
    assert ended.code == 0
    small = pcd.read(out)
    assert ended.json == {"points_in": np.isfinite(pcd.read(book).points["x"]).sum(), "points_out": small.points.size}
    assert small.viewpoint == pytest.approx(pcd.read(book).viewpoint)
    ended = zsight("downsample", book, "--leaf", "0.05", "-o", out)
    assert (ended.code, "--force" in ended.err) == (2, True)
    assert zsight("downsample", book, "--leaf", "0").code == 2


def test_plane(zsight: Zsight, book: Path, tmp_path: Path) -> None:
    out = tmp_path / "plane.pcd"
    ended = zsight("plane", book, "--patch", 300, 100, 340, 140, "-o", out, "--json")
    assert ended.code == 0
    report = ended.json
    normal, distance = np.array(report["normal"]), report["distance"]
    assert np.linalg.norm(normal) == pytest.approx(1)
    assert distance < 0
    on_plane = xyz(pcd.read(out).points).reshape(-1, 3)
    assert len(on_plane) == report["inliers"]
    assert np.abs(on_plane @ normal - distance).max() < 0.0101
    T = np.array(report["T_camera_plane"]).reshape(4, 4)
    np.testing.assert_allclose(T[:3, 2], normal, atol=1e-9)
    ended = zsight("plane", book, "--patch", 0, 0, 640, 10)
    assert (ended.code, "leaves the image; expected pixels 0 0 to 639 479" in ended.err) == (2, True)


def test_a_plane_is_written_whole_or_not_at_all(zsight: Zsight, book: Path, tmp_path: Path) -> None:
    out, above = tmp_path / "plane.pcd", tmp_path / "above.pcd"
    above.write_text("mine")
    patch = ("plane", book, "--patch", 350, 250, 450, 300)
    ended = zsight(*patch, "-o", out, "--above", above)
    assert (ended.code, out.exists(), above.read_text()) == (2, False, "mine")
    assert "above.pcd is there already" in ended.err
    ended = zsight(*patch, "-o", out, "--above", tmp_path / "." / out.name, "--force")
    assert (ended.code, out.exists()) == (2, False)
    assert "name two files" in ended.err


def test_an_ellipse_comes_back_in_its_colours(zsight: Zsight, tmp_path: Path) -> None:
    for name, option in (("a.pcd", "--ascii"), ("b.pcd", "--compressed"), ("c.ply", "--ascii")):
        assert zsight("cloud", "ellipse", "-o", tmp_path / name, option).code == 0
        report = zsight("cloud", "info", tmp_path / name, "--json").json
        assert (report["width"] * report["height"], report["finite"]) == (2920, 2920)
    assert zsight("cloud", "convert", tmp_path / "c.ply", "-o", tmp_path / "d.pcd").code == 0
    a, b, d = (pcd.read(tmp_path / name).points for name in ("a.pcd", "b.pcd", "d.pcd"))
    np.testing.assert_array_equal(colours(a), colours(b))
    np.testing.assert_array_equal(colours(a), colours(d))
    assert zsight("cloud", "ellipse", "-o", tmp_path / "e.ply", "--compressed").code == 2
    assert zsight("cloud", "ellipse", "-o", tmp_path / "e.txt").code == 2
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.pcd", "b.pcd", "c.ply", "d.pcd"]


def test_filters(zsight: Zsight, book: Path, tmp_path: Path) -> None:
    out = tmp_path / "red.pcd"
    ended = zsight(
        "cloud", "filter", book, "-o", out, "--transform", POSE, "--box", 0.3, -0.5, 0.78, 0.7, -0.2, 0.9, "--json"
    )
    assert ended.code == 0
    kept = xyz(pcd.read(out).points).reshape(-1, 3)
    assert len(kept) == ended.json["points_out"] > 1000
    assert ((kept >= (0.3, -0.5, 0.78)) & (kept <= (0.7, -0.2, 0.9))).all()
    assert zsight("cloud", "filter", book, "-o", out, "--pass-through", "q", 0, 1, "--force").code == 2


def test_a_cloud_that_is_moved_into_another_frame_stays_where_it_is_in_the_world(
    zsight: Zsight, book: Path, tmp_path: Path
) -> None:
    out = tmp_path / "moved.pcd"
    ended = zsight("cloud", "filter", book, "-o", out, "--transform", "1 2 3 0.5 0.5 0.5 0.5", "--json")
    assert (ended.code, ended.json["points_out"]) == (0, ended.json["points_in"])
    before, after = (pcd.read(path) for path in (book, out))
    assert np.nanmax(np.abs(xyz(before.points) - xyz(after.points))) > 1.0
    was, is_now = (transform_xyz(viewpoint_matrix(file.viewpoint), xyz(file.points)) for file in (before, after))
    np.testing.assert_allclose(is_now, was, atol=1e-5)


@pytest.mark.parametrize(
    "options", [("--colour", 300, 0, 0), ("--colour", 0, 0, -1), ("--colour", 9, 9, 9, "--colour-tolerance", 256)]
)
def test_colours_are_of_eight_bits(zsight: Zsight, book: Path, tmp_path: Path, options: tuple[Any, ...]) -> None:
    ended = zsight("cloud", "filter", book, "-o", tmp_path / "out.pcd", *options)
    assert ended.code == 2
    assert "255" in ended.err
    assert not (tmp_path / "out.pcd").exists()


def test_table(zsight: Zsight, book: Path) -> None:
    report = zsight("cloud", "table", book, "--camera-pose", POSE, "--json").json
    assert report["height"] == pytest.approx(0.7747, abs=0.0026)


# Over the network.


@pytest.fixture
def reachable(zenoh_network: Network, monkeypatch: pytest.MonkeyPatch) -> Network:
    """A router, and the environment that leads commands to an empty cell on it."""
    monkeypatch.setenv("ZSIGHT_CONNECT", ",".join(zenoh_network.connect))
    monkeypatch.setenv("ZSIGHT_NAMESPACE", next(_names))
    monkeypatch.setenv("ZSIGHT_HOST", "here")
    monkeypatch.delenv("ZENOH_CONFIG", raising=False)
    return zenoh_network.from_environment()


@pytest.fixture
def join_cell(reachable: Network) -> Iterator[Any]:
    """Join the cell that commands see."""
    buses: list[Bus] = []

    def join() -> Bus:
        buses.append(Bus(open_link(reachable), Cell(reachable.namespace)))
        return buses[-1]

    yield join
    for bus in buses:
        bus.close()


@pytest.fixture
def served(join_cell: Any) -> Iterator[Gated]:
    """A finder whose work ends when the test says so."""
    work, bus = Gated(), join_cell()
    server = ActionServer(bus, "finder", FindObjectGoal, work, Policy(parallel=1, queue=0))
    known(bus, join_cell())
    yield work
    work.gate.set()
    server.close()


@pytest.mark.parametrize(
    "command",
    [
        ["find", "cube"], ["snapshot", "-o", "x.pcd"], ["topic", "list"], ["node", "list"], ["catalog", "list"],
        ["topic", "echo", "zsight/kinect/points"], ["topic", "hz", "zsight/kinect/points"], ["why"],
    ],
)  # fmt: skip
def test_without_a_router_the_exit_code_is_3(
    zsight: Zsight, command: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ZSIGHT_CONNECT", "tcp/127.0.0.1:9")
    ended = zsight(*command)
    assert (ended.code, ended.out) == (3, "")
    assert "cannot reach a router: tcp/127.0.0.1:9" in ended.err
    assert "zsight up" in ended.err


@pytest.mark.parametrize(
    "command",
    [["find", "cube"], ["topic", "list"], ["node", "list"], ["node", "info", "voxel"], ["catalog", "list"], ["down"]],
)
def test_in_an_empty_cell_the_exit_code_is_3(zsight: Zsight, reachable: Network, command: list[str]) -> None:
    del reachable
    ended = zsight(*command)
    assert (ended.code, ended.out) == (3, "")


@pytest.mark.parametrize(
    "command", [["snapshot", "--timeout", "0.05", "-o"], ["topic", "echo", "--duration", "0.05"],
                ["topic", "hz", "--duration", "0.05"], ["topic", "bw", "--duration", "0.05"]],
)  # fmt: skip
def test_when_nothing_comes_the_exit_code_is_4(
    zsight: Zsight, reachable: Network, command: list[str], tmp_path: Path
) -> None:
    last = tmp_path / "x.pcd" if command[0] == "snapshot" else f"{reachable.namespace}/kinect/points"
    ended = zsight(*command, last)
    assert (ended.code, ended.out) == (4, "")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("bad", ["toy block", "Toy", "a/b", ""])
def test_a_name_that_no_type_can_have_is_said(zsight: Zsight, reachable: Network, bad: str) -> None:
    del reachable
    for command in ("show", "remove"):
        ended = zsight("catalog", command, bad)
        assert (ended.code, "no type can be called" in ended.err) == (2, True)


@pytest.mark.parametrize(
    "arguments", [[""], ["x" * 200], ["cube", "--known-height", "nan"], ["cube", "--frame", "f" * 300]]
)
def test_a_goal_that_cannot_be_said_is_refused(zsight: Zsight, served: Gated, arguments: list[str]) -> None:
    ended = zsight("find", *arguments)
    assert (ended.code, ended.out) == (2, "")
    assert served.runs == []


def test_a_process_that_is_not_there_has_no_logs(zsight: Zsight, join_cell: Any) -> None:
    process = join_cell()
    with LogBook("here", "eye").on(process):
        tell_health(process, "eye")
        assert soon(lambda: zsight("logs", "eye").code == 0)
        ended = zsight("logs", "nope")
        assert (ended.code, ended.out, ended.err) == (
            3,
            "",
            "zsight: no process nope is there; see: zsight node list\n",
        )


def test_a_setting_is_set_to_nothing_as_it_is_shown(
    zsight: Zsight, join_cell: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    process, settings = join_cell(), camera.Settings(rate=15, pose=POSE)
    serve_parameters(process, "here", "eye", "camera", Parameters(settings, Saved(process.cell.namespace, "eye")))
    assert soon(lambda: zsight("param", "get", "eye", "rate").out == "15.0\n")
    for name in ("rate", "pose"):
        assert zsight("param", "set", "eye", name, "-").code == 0
        assert zsight("param", "get", "eye", name).out == "-\n"
    assert (settings.rate, settings.pose) == (None, "")


def test_find_refused(zsight: Zsight, served: Gated) -> None:
    del served
    assert zsight("find", "unknown", "--json").code == 2


def test_find_answered(zsight: Zsight, served: Gated) -> None:
    served.gate.set()
    ended = zsight("find", "cube", "--json")
    assert (ended.code, ended.json["status"], ended.json["message"]) == (1, "cannot_tell", "done")


def test_find_too_late_tells_what_is_known(zsight: Zsight, served: Gated) -> None:
    del served
    ended = zsight("find", "cube", "--timeout", "0.1", "--json")
    assert ended.code == 4
    assert (ended.json["deadline_passed"], ended.json["message"]) == (True, "deadline")
    assert "deadline" in ended.err


def test_find_cancelled_by_somebody_else(zsight: Zsight, served: Gated, join_cell: Any) -> None:
    client = CellClient(join_cell())

    def cancel() -> None:
        assert soon(lambda: bool(served.runs))
        client.cancel(served.runs[0])

    thread = threading.Thread(target=cancel)
    thread.start()
    ended = zsight("find", "cube", "--json")
    thread.join(DEADLINE)
    assert (ended.code, ended.out) == (5, "")


def test_find_when_the_finder_is_busy(zsight: Zsight, served: Gated, join_cell: Any) -> None:
    call = CellClient(join_cell()).start_find("cube")
    assert soon(lambda: bool(served.runs))
    ended = zsight("find", "cube")
    assert (ended.code, "busy" in ended.err) == (3, True)
    served.gate.set()
    call.wait()


def test_ctrl_c_cancels_this_goal_and_no_other(
    zsight: Zsight, served: Gated, join_cell: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Ctrl-C comes as KeyboardInterrupt while the command waits for its answer."""
    from zsight.action.client import GoalCall

    sent: list[str] = []
    wait = GoalCall.wait

    def interrupted(call: GoalCall[Any], *_: Any) -> Any:
        sent.append(call.goal_id)
        assert soon(lambda: bool(served.runs))
        monkeypatch.setattr(GoalCall, "wait", wait)
        raise KeyboardInterrupt

    monkeypatch.setattr(GoalCall, "wait", interrupted)
    assert zsight("find", "cube").code == 130
    assert served.runs == sent
    client = CellClient(join_cell())
    assert soon(lambda: [update.state.name for update in client.results(sent[0])] == ["CANCELLED"])


def test_a_running_cell_through_every_command(
    zsight: Zsight, join_cell: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One cell of real services in this process, seen by all commands that look at it."""
    monkeypatch.chdir(tmp_path)
    test = join_cell()
    points = test.cell.points("kinect")
    with (
        running(camera.run, join_cell(), camera.Settings(rate=30)),
        running(voxel.run, join_cell(), voxel.Settings()),
        running(planes.run, join_cell(), planes.Settings()),
        running(finder.run, join_cell(), finder.Settings(catalogue=str(tmp_path))),
    ):
        assert test.reader(test.cell.tf_static, TransformList).take(DEADLINE) is not None
        assert soon(lambda: zsight("find", "toy_block").code == 0)
        found = zsight("find", "toy_block", "--json", "--new").json
        np.testing.assert_allclose(found["objects"][0]["position"], (0.5, -0.35, 0.7922), atol=0.001)
        assert zsight("find", "toy_block", "--frame", "kinect_pc_frame", "--json").json["frame_id"] == "kinect_pc_frame"
        assert zsight("find", "mug", "--json").code == 1
        assert zsight("find", "toy_blok").code == 2
        for goal, code in (("mug", 2), ("01234567-89ab-cdef-0123-456789abcdef", 1)):
            ended = zsight("why", goal)
            assert (ended.code, f"no goal is called {goal}" in ended.err) == (code, True)
        _snapshots(zsight, points)
        _topics(zsight, points)
        _catalogue(zsight, tmp_path)


def test_a_type_is_taught_from_a_file(zsight: Zsight, book: Path, tmp_path: Path) -> None:
    out = tmp_path / "bar.yaml"
    report = zsight("catalog", "teach", "bar", "--cloud", book, "--camera-pose", POSE, "-o", out, "--json").json
    np.testing.assert_allclose(report["position"], (0.5, -0.35, 0.7922), atol=0.001)
    assert (report["frame_id"], report["explained"] > 0.9) == ("world", True)
    found = zsight("find", "bar", "--cloud", book, "--camera-pose", POSE, "--catalogue", tmp_path, "--json").json
    assert found["objects"][0]["size"] == pytest.approx(report["type"]["shape"]["box"]["size"])
    assert zsight("catalog", "teach", "bar", "--cloud", book, "-o", out).code == 2  # it is there already


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["bar", "--at", "1 2"], "expected three numbers"),
        (["bar", "--shape", "cone"], "expected one of box, cylinder"),
        (["Bar"], "no type can be called 'Bar'"),
        (["bar", "--at", "5 5 5"], "nothing is at (5.000, 5.000, 5.000)"),
        (["bar", "--frame", "odom"], "--frame means nothing with --cloud"),
    ],
)
def test_a_lesson_that_makes_no_sense(zsight: Zsight, book: Path, arguments: list[str], words: str) -> None:
    ended = zsight("catalog", "teach", *arguments, "--cloud", book)
    assert ended.code == 2
    assert words in ended.err


def _snapshots(zsight: Zsight, points: str) -> None:
    report = zsight("snapshot", "-o", "a.pcd", "--json").json
    assert (report["width"], report["height"], report["frame_id"]) == (640, 480, "kinect_pc_frame")
    saved = pcd.read("a.pcd")
    x, y, z, qx, qy, qz, qw = map(float, POSE.split())
    assert saved.viewpoint == pytest.approx((x, y, z, qw, qx, qy, qz), abs=1e-5)
    assert zsight("snapshot", "-o", "a.pcd").code == 2
    assert zsight("snapshot", points, "-o", "a.pcd", "--ascii", "--force").code == 0
    again = pcd.read("a.pcd").points
    np.testing.assert_array_equal(colours(again), colours(saved.points))
    np.testing.assert_array_equal(xyz(again), xyz(saved.points))
    assert zsight("snapshot", f"{points}/voxel", "-o", "b.ply").code == 0


def _topics(zsight: Zsight, points: str) -> None:
    hz = zsight("topic", "hz", points, "--count", 5, "--json").json
    assert hz["messages"] == 5
    assert 5 < hz["hz"] < 100
    assert zsight("topic", "bw", points, "--count", 2, "--json").json["bytes"] > 2 * 640 * 480 * 16
    (cloud,) = [json.loads(line) for line in zsight("topic", "echo", points, "--count", 1, "--json").out.splitlines()]
    once = zsight("topic", "hz", points, "--count", 1, "--json").json
    assert (once["messages"], once["hz"]) == (1, None)
    assert zsight("topic", "bw", points, "--count", 1, "--json").json["bytes_per_second"] is None
    for what in ("hz", "bw"):
        assert zsight("topic", what, points, "--count", 1).err.startswith("one message has no rate, ")
    assert (cloud["width"], cloud["data"]) == (640, f"<{640 * 480 * 16} bytes>")
    assert "frame_id: kinect_pc_frame" in zsight("topic", "echo", points, "--count", 1).out
    assert zsight("topic", "echo", "elsewhere/points").code == 2


def _catalogue(zsight: Zsight, folder: Path) -> None:
    (folder / "in").mkdir()
    (folder / "in" / "bar.yaml").write_text("name: bar\ncode: 4711\nshape:\n  box: {size: [0.2, 0.035, 0.035]}\n")
    names = [kind["name"] for kind in zsight("catalog", "list", "--json").json["types"]]
    assert len(names) == 11
    assert zsight("catalog", "add", folder / "in" / "bar.yaml").code == 0
    assert "toy_block" in zsight("catalog", "list").out
    assert zsight("catalog", "show", "4711", "--json").json["name"] == "bar"
    shown = zsight("catalog", "show", "bar")
    assert "size:" in shown.out
    assert "the same when turned about" in shown.err
    assert zsight("catalog", "show", "bar", "--version", "1").code == 0
    assert zsight("catalog", "show", "bar", "--version", "9").code == 2
    assert zsight("catalog", "remove", "bar").code == 0
    assert zsight("catalog", "show", "bar").code == 2
    taught = zsight("catalog", "teach", "stick", "--picture", "stick.png", "--json").json
    assert sorted(taught["type"]["shape"]["box"]["size"]) == pytest.approx([0.035, 0.035, 0.2], abs=0.001)
    assert Path("stick.png").read_bytes().startswith(b"\x89PNG")
    assert zsight("catalog", "show", "stick", "--json").json["version"] == 1
    assert "box:" in zsight("catalog", "teach", "twig", "--at", "0.5 -0.35 0.8", "--dry-run").out
    assert zsight("catalog", "show", "twig").code == 2
    (folder / "in" / "bar.yaml").write_text("name: bar\n")
    assert "line 1" in zsight("catalog", "add", folder / "in" / "bar.yaml").err


# Other viewers.


@pytest.mark.parametrize("name", ["foxglove", "rerun"])
def test_without_the_extra_of_a_viewer_the_command_names_it(
    zsight: Zsight, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    monkeypatch.setitem(sys.modules, name, None)
    monkeypatch.delitem(sys.modules, f"zsight.bridge.{name}_sink", raising=False)
    ended = zsight("view", f"--{name}")
    assert ended.code == 2
    assert f"pip install 'zsight[{name}]'" in ended.err


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--foxglove", "--rerun"], "two viewers"),
        (["--foxglove", "--folder", "x"], "--folder means nothing"),
        (["--foxglove", "--open"], "--open means nothing"),
        (["--to", "x.rrd"], "--to needs --rerun"),
        (["--rerun", "--port", "9"], "--port means nothing"),
    ],
)
def test_options_of_another_viewer_are_refused(zsight: Zsight, options: list[str], words: str) -> None:
    ended = zsight("view", *options)
    assert ended.code == 2
    assert words in ended.err
