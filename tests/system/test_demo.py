"""The main job on one machine, as a new user starts it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from tests.services.waiting import soon
from tests.system.commands import Command, children_of, leftovers, shared_memory_of

from zsight.scene_file import find_scene

if TYPE_CHECKING:
    from tests.system.commands import Ended

pytestmark = [
    pytest.mark.system,
    pytest.mark.usefixtures("warm_kernels"),
    pytest.mark.skipif(not Path("/dev/shm").is_dir(), reason="shared memory is looked at as Linux has it"),  # noqa: S108  read, not written
]


def demo(*arguments: object) -> Ended:
    """A demo that leaves nothing behind."""
    with Command("demo", "--json", *arguments) as command:
        pids = command.children()
        assert sorted(pids) == ["camera", "finder", "planes", "router", "voxel"]
        command.wait_for("^(found it at|block: )")
        held = shared_memory_of(pids)
        assert held
        ended = command.ended()
    assert leftovers(pids, held) == []
    if ended.code in (0, 1):
        assert ended.json["processes"] == [{"name": name, "pid": pid} for name, pid in pids.items()]
    return ended


def test_the_block_is_found_where_it_is(tmp_path: Path) -> None:
    picture = tmp_path / "answer.png"
    ended = demo("--picture", picture)
    assert ended.code == 0
    report = ended.json
    assert report["found"] is True
    assert report["error_mm"] <= 1.0
    assert report["error_deg"] <= 0.5
    assert report["table_height"] == pytest.approx(0.7747, abs=0.0005)
    assert report["truth"]["position"] == pytest.approx([0.5, -0.35, 0.7922])
    assert report["position"] == pytest.approx(report["truth"]["position"], abs=0.001)
    assert len(report["orientation"]) == len(report["truth"]["orientation"]) == 4
    assert report["picture"] == str(picture)
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_a_scene_without_the_block_has_none(tmp_path: Path) -> None:
    lines = find_scene("book").read_text(encoding="utf-8").splitlines(keepends=True)
    without = [line.replace("model: none", "model: kinect") for line in lines if "toy_block" not in line]
    assert len(without) == len(lines) - 1
    scene = tmp_path / "empty.yaml"
    scene.write_text("".join(without), encoding="utf-8")
    ended = demo("--scene", scene, "--seed", 7, "--picture", tmp_path / "answer.png")
    assert ended.code == 1
    report = ended.json
    assert (report["found"], report["status"], report["position"], report["truth"]) == (False, "not_found", None, None)
    assert report["table_height"] == pytest.approx(0.7747, abs=0.0005)
    assert report["p_absent"] > 0.5


def test_ctrl_c_while_it_starts_leaves_no_process_behind(tmp_path: Path) -> None:
    with Command("demo", "--picture", tmp_path / "answer.png") as command:
        command.wait_for("^starting")
        assert soon(lambda: bool(children_of(command.process.pid)))
        pids = {str(pid): pid for pid in children_of(command.process.pid)}
        command.interrupt()
        assert command.ended().code == 130
    assert leftovers(pids, set()) == []
    assert not (tmp_path / "answer.png").exists()
