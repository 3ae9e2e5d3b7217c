"""What a command says and how it ends where its output goes nowhere, and when it is interrupted as it starts."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import IO

import numpy as np
import pytest
from tests.system.commands import DEADLINE

from zsight_core.files import pcd
from zsight_core.points import from_xyz

pytestmark = pytest.mark.system

ZSIGHT = [sys.executable, "-m", "zsight"]


def end(*arguments: str, out: IO[bytes] | int, **environment: str) -> tuple[int, str]:
    """Exit code and last words of a command that writes to a file."""
    command, surroundings = [*ZSIGHT, *arguments], {**os.environ, **environment}
    ended = subprocess.run(command, stdout=out, stderr=subprocess.PIPE, env=surroundings, timeout=DEADLINE, check=False)
    return ended.returncode, ended.stderr.decode()


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no file that is always full")
def test_a_full_disk_is_told() -> None:
    with Path("/dev/full").open("wb") as full:
        code, words = end("version", out=full)
    assert (code, words) == (2, "zsight: No space left on device: make room where the output goes\n")


@pytest.mark.parametrize("arguments", [["version"], ["--help"], ["find", "--help"]], ids=" ".join)
def test_who_reads_no_further_has_what_was_wanted(arguments: list[str]) -> None:
    read, write = os.pipe()
    os.close(read)
    with os.fdopen(write, "wb") as nobody_reads:
        assert end(*arguments, out=nobody_reads) == (0, "")


@pytest.mark.parametrize("closed", ["1", "2"], ids=["stdout", "stderr"])
@pytest.mark.parametrize("form", [["--json"], []], ids=["json", "words"])
def test_a_closed_stream_is_one_that_nobody_wants(closed: str, form: list[str], tmp_path: Path) -> None:
    path = tmp_path / "a.pcd"
    pcd.write(path, from_xyz(np.ones((2, 2, 3))))
    command = ["sh", "-c", f'exec "$@" {closed}>&-', "sh", *ZSIGHT, "cloud", "info", str(path), *form]
    ended = subprocess.run(command, capture_output=True, timeout=DEADLINE, check=False)
    assert ended.returncode == 0
    assert b"Traceback" not in ended.stderr


def test_an_interrupt_while_the_command_is_imported(tmp_path: Path) -> None:
    (tmp_path / "typer.py").write_text("raise KeyboardInterrupt\n")
    path = os.pathsep.join([str(tmp_path), *filter(None, [os.environ.get("PYTHONPATH")])])
    assert end("version", out=subprocess.DEVNULL, PYTHONPATH=path) == (130, "")
