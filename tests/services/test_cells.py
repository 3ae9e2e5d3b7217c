"""Which process holds a cell is noted where others may write too: links and files of theirs are refused."""

from __future__ import annotations

import fcntl
import os
import sys
from concurrent.futures import ThreadPoolExecutor
from typing import IO, TYPE_CHECKING

import pytest
from tests.services.waiting import DEADLINE

from zsight.cli import cells
from zsight.errors import ConnectionLost, NobodyAnswers, UsageError
from zsight.network import Network
from zsight.own_files import open_own

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

NETWORK = Network()
REFUSED = "no file of this user's own"


def note(network: Network) -> None:
    with cells._pid_file(network):
        pass


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where the cell is noted; what is started in the background only tells its version."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    monkeypatch.setattr(sys, "argv", ["zsight", "--version"])


def test_the_process_is_noted_and_found_by_who_stops_it() -> None:
    path = cells._pid_path(NETWORK)
    with cells._pid_file(NETWORK):
        assert cells._running(NETWORK) == path
        assert int(path.read_text(encoding="ascii")) == os.getpid()
    assert not path.exists()


@pytest.mark.parametrize(
    ("act", "suffix"),
    [(note, ".pid"), (cells._running, ".pid"), (cells._detach, ".pid"), (cells._detach, ".log")],
    ids=["up", "down", "detach", "log"],
)
def test_a_link_is_not_followed(act: Callable[[Network], object], suffix: str, tmp_path: Path) -> None:
    other = tmp_path / "other"
    other.write_text("1")
    cells._pid_path(NETWORK).with_suffix(suffix).symlink_to(other)
    with pytest.raises(UsageError, match=REFUSED):
        act(NETWORK)
    assert other.read_text() == "1"


@pytest.mark.parametrize("act", [note, cells._running, cells._detach], ids=["up", "down", "detach"])
def test_a_file_of_another_user_is_refused(act: Callable[[Network], object], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "getuid", lambda: 4321)
    path = cells._pid_path(NETWORK)
    path.write_text("1")
    with pytest.raises(UsageError, match=REFUSED):
        act(NETWORK)
    assert path.read_text() == "1"


def test_who_looks_keeps_no_cell_from_starting_and_is_no_cell() -> None:
    path = cells._pid_path(NETWORK)
    path.touch()
    with open_own(path) as looking, ThreadPoolExecutor() as threads:
        assert cells._lock(looking, fcntl.LOCK_SH)
        assert not cells._is_held(path)
        noted = threads.submit(note, NETWORK)
        fcntl.flock(looking, fcntl.LOCK_UN)
        noted.result(DEADLINE)


def test_two_cells_are_not_up_at_once() -> None:
    with cells._pid_file(NETWORK), pytest.raises(ConnectionLost, match="is up already"):
        note(NETWORK)


def test_a_file_that_an_ended_cell_took_away_is_not_held(monkeypatch: pytest.MonkeyPatch) -> None:
    path = cells._pid_path(NETWORK)
    take_lock = cells._lock

    def lock_too_late(file: IO[bytes], kind: int) -> bool:
        monkeypatch.setattr(cells, "_lock", take_lock)
        path.unlink()
        return take_lock(file, kind)

    monkeypatch.setattr(cells, "_lock", lock_too_late)
    with cells._pid_file(NETWORK):
        assert cells._running(NETWORK) == path


def test_a_start_that_comes_second_leaves_the_first_ones_log_alone() -> None:
    path = cells._pid_path(NETWORK).with_suffix(".log")
    path.write_text("up: router (1)\n")
    with pytest.raises(NobodyAnswers, match=r"\d"):  # what is started tells its version and ends
        cells._detach(NETWORK)
    assert path.read_text() == "up: router (1)\n"
    assert [path] == list(path.parent.iterdir())
