"""Shared memory of dead processes is removed, of living ones never."""

from __future__ import annotations

import fcntl
import subprocess
import sys
from contextlib import ExitStack
from typing import TYPE_CHECKING

from zsight.shared_memory import leave, remove_orphans

if TYPE_CHECKING:
    from pathlib import Path


def test_only_what_nobody_holds_is_removed(tmp_path: Path) -> None:
    for name in ("orphan.zenoh", "shared.zenoh", "exclusive.zenoh", "other.shm"):
        (tmp_path / name).write_bytes(b"1")
    with (tmp_path / "shared.zenoh").open("rb") as shared, (tmp_path / "exclusive.zenoh").open("rb") as exclusive:
        fcntl.flock(shared, fcntl.LOCK_SH)
        fcntl.flock(exclusive, fcntl.LOCK_EX)
        assert remove_orphans(tmp_path) == 1
        assert {path.name for path in tmp_path.iterdir()} == {"shared.zenoh", "exclusive.zenoh", "other.shm"}
    assert remove_orphans(tmp_path) == 2
    assert [path.name for path in tmp_path.iterdir()] == ["other.shm"]


def test_links_are_not_followed(tmp_path: Path) -> None:
    (tmp_path / "precious").write_bytes(b"1")
    (tmp_path / "link.zenoh").symlink_to(tmp_path / "precious")
    assert remove_orphans(tmp_path) == 0
    assert (tmp_path / "precious").exists()


def test_a_host_without_that_folder_has_none(tmp_path: Path) -> None:
    assert remove_orphans(tmp_path / "absent") == 0


def test_at_its_end_a_process_removes_what_it_alone_holds(tmp_path: Path) -> None:
    for name in ("mine.zenoh", "ours.zenoh", "other.zenoh", "mine.shm"):
        (tmp_path / name).write_bytes(b"1")
    holds = (
        "import fcntl, sys; f = open(sys.argv[1]); fcntl.flock(f, fcntl.LOCK_SH); print('held', flush=True); input()"
    )
    other = subprocess.Popen(
        [sys.executable, "-c", holds, tmp_path / "ours.zenoh"], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    )
    with ExitStack() as files, other:
        assert other.stdout is not None
        assert other.stdout.readline() == b"held\n"
        for name in ("mine.zenoh", "mine.zenoh", "ours.zenoh", "mine.shm"):
            fcntl.flock(files.enter_context((tmp_path / name).open("rb")), fcntl.LOCK_SH)
        assert leave(tmp_path) == 1
        assert {path.name for path in tmp_path.iterdir()} == {"ours.zenoh", "other.zenoh", "mine.shm"}
        other.communicate(b"\n")
