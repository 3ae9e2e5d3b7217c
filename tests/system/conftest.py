"""What the tests with real processes share."""

from __future__ import annotations

import pytest

from zsight_core import warm


@pytest.fixture(scope="session")
def warm_kernels() -> None:
    """Compiled kernels, so that no deadline of a test passes while one is compiled; ``make test`` has done it."""
    if not warm.is_warm():
        warm.warm()
