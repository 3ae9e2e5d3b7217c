"""A service's loop on a thread of the test."""

from __future__ import annotations

import threading
from contextlib import contextmanager
from typing import TYPE_CHECKING, TypeVar

from tests.services.waiting import DEADLINE

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from zsight.bus import Bus
    from zsight.settings import Settings

    S = TypeVar("S", bound=Settings)

__all__ = ["running"]

_COMPILING = 100.0  # seconds that a service may take to be ready where its kernels are not compiled yet


@contextmanager
def running(run: Callable[[Bus, S], None], bus: Bus, settings: S) -> Iterator[None]:
    """Run a service until the end of the block, from the moment it says that it is ready."""
    ready, ended = threading.Event(), threading.Event()
    errors: list[Exception] = []
    bus.on_ready = ready.set

    def loop() -> None:
        try:
            run(bus, settings)
        except Exception as error:  # noqa: BLE001  raised again below
            errors.append(error)
        finally:
            ended.set()
            ready.set()

    thread = threading.Thread(target=loop)
    thread.start()
    try:
        assert ready.wait(_COMPILING)
        if not errors:
            yield
    finally:
        bus.stop()
        assert ended.wait(DEADLINE), "the service does not stop"
        thread.join()
    if errors:
        raise errors[0]
