"""kill -9 at any moment: the file is recovered, and nothing is missing that was said to be safe."""

from __future__ import annotations

import itertools
import os
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from zsight.recording.checking import check
from zsight.recording.mcap_copy import copy
from zsight.recording.mcap_file import McapFile

REPOSITORY = Path(__file__).resolve().parents[2]


def record_and_kill(path: Path, compression: str, after: float) -> list[int]:
    """Record in a process of its own, kill it after its first word and some seconds; the times (ns) it called safe."""
    command = [sys.executable, "-m", "tests.services.crashing_writer", str(path), compression, "48"]
    process = subprocess.Popen(command, cwd=REPOSITORY, stdout=subprocess.PIPE, env=os.environ, text=True)
    assert process.stdout is not None
    words: list[str] = []
    first = threading.Event()

    def listen(stream: object) -> None:
        for line in stream:  # type: ignore[attr-defined]  # a text stream
            words.append(line)
            first.set()

    listener = threading.Thread(target=listen, args=(process.stdout,))
    listener.start()
    assert first.wait(60), "the recorder never said that anything is safe"
    threading.Event().wait(after)  # the moment at which it is killed
    process.kill()
    process.wait(60)
    listener.join(60)
    process.stdout.close()
    return [int(line.split()[0]) for line in words if line.endswith("\n")]


@pytest.mark.parametrize(("compression", "after"), [("none", 0.3), ("lz4", 0.11), ("auto", 0.57)])
def test_what_was_safe_is_there_after_kill_9(tmp_path: Path, compression: str, after: float) -> None:
    path, mended = tmp_path / "killed.mcap", tmp_path / "mended.mcap"
    safe = record_and_kill(path, compression, after)
    with McapFile.open(path) as torn:
        assert "its writer did not close it" in torn.damage
    assert copy([path], mended, walk=True).messages > 0
    assert check(mended)["sound"]
    assert check(mended)["gaps"] == {}
    with McapFile.open(mended) as file:
        times = [entry.log_time for entry in file.messages()]
    assert times[-1] >= safe[-1]
    assert safe[-1] in times


def test_what_is_safe_is_never_far_behind(tmp_path: Path) -> None:
    """While it records; by the recorder's own word, so that a machine that stands still is not the recorder's fault."""
    safe = record_and_kill(tmp_path / "a.mcap", "none", 2.0)
    gaps = [(b - a) / 1e9 for a, b in itertools.pairwise(safe)]
    assert len(safe) >= 3
    assert sorted(gaps)[len(gaps) // 2] < 0.9
