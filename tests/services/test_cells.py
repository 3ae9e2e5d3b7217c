"""Which process holds a cell is noted where others may write too: links and files of theirs are refused."""

from __future__ import annotations

import os
import sys
from typing import TYPE_CHECKING

import pytest

from zsight.cli import cells
from zsight.errors import UsageError
from zsight.network import Network

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
