"""A terminal that is closed, or whose line is cut: what runs in it ends well, what was sent away from it goes on."""

from __future__ import annotations

import os
import signal
from typing import TYPE_CHECKING

import pytest
from tests.services.waiting import DEADLINE, soon
from tests.system.commands import Command, free_port, leftovers, run

from zsight.recording.checking import check

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

pytestmark = pytest.mark.system


@pytest.fixture(autouse=True)
def _not_ignored() -> Iterator[None]:
    """As a terminal starts commands, however the tests were started."""
    before = signal.signal(signal.SIGHUP, signal.SIG_DFL)
    yield
    signal.signal(signal.SIGHUP, before)


@pytest.fixture
def environment(tmp_path: Path) -> dict[str, str]:
    """A cell of a router alone."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    (tmp_path / "cell.toml").write_text("[process.router]\n")
    places = {"ZSIGHT_CONNECT": endpoint, "ZSIGHT_LISTEN": endpoint, "XDG_RUNTIME_DIR": str(tmp_path)}
    return {**places, "ZSIGHT_NAMESPACE": "hang-up"}


def test_a_recording_is_closed_and_its_cell_goes_down(tmp_path: Path, environment: dict[str, str]) -> None:
    with Command("up", tmp_path / "cell.toml", **environment) as up:
        pids = up.children()
        with Command("bag", "record", "-o", tmp_path / "a.mcap", **environment) as recording:
            recording.wait_for("recording to")
            assert soon(lambda: (tmp_path / "a.mcap").stat().st_size > 2000, DEADLINE)
            recording.process.send_signal(signal.SIGHUP)
            recording.process.send_signal(signal.SIGHUP)
            assert recording.ended().code == 0
        report = check(tmp_path / "a.mcap")
        assert report["sound"], report
        assert report["messages"] > 0
        up.process.send_signal(signal.SIGHUP)
        ended = up.ended()
    assert (ended.code, ended.err.splitlines()[-1]) == (0, "down")
    assert leftovers(pids, set()) == []


def test_a_service_ends_well(environment: dict[str, str]) -> None:
    with Command("run", "router", **environment) as router:
        assert soon(lambda: run("node", "list", **environment).code == 0, DEADLINE)
        router.process.send_signal(signal.SIGHUP)
        assert router.ended().code == 0


def test_a_cell_in_the_background_outlives_its_terminal(tmp_path: Path, environment: dict[str, str]) -> None:
    ended = run("up", tmp_path / "cell.toml", "--detach", **environment)
    assert ended.code == 0
    (pid,) = {int(word) for word in ended.err.replace(",", " ").split() if word.isdigit()}
    try:
        assert os.getsid(pid) == pid  # a session without a terminal, whose end it is not told of
    finally:
        assert run("down", **environment).code == 0
