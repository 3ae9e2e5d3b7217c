"""What all tests share."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest
from hypothesis import settings

from zsight_core import warm

# The same examples on every run, and no verdict on how fast a shared machine is.
settings.register_profile("zsight", derandomize=True, deadline=None, max_examples=30)
settings.load_profile("zsight")

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    # A shell starts what runs in the background so, and commands that tests interrupt would inherit it.
    signal.signal(signal.SIGINT, signal.default_int_handler)

REPOSITORY = Path(__file__).resolve().parent.parent


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of real recordings; tests that need it are skipped where it is absent."""
    folder = Path(os.environ.get("ZSIGHT_DATA", REPOSITORY.parent / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip(f"no real recordings at {folder}: set ZSIGHT_DATA to their folder")
    return folder


@pytest.fixture(scope="session")
def warm_kernels() -> None:
    """Compiled kernels, so that no deadline of a test passes while one is compiled; ``make test`` has done it."""
    if not warm.is_warm():
        warm.warm()
