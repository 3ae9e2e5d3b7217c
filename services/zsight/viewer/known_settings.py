"""The settings of all processes of the cell, as they were told last."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING, Any

from zsight.client import CellClient
from zsight.errors import ZsightError

if TYPE_CHECKING:
    from zsight.bus import Bus
    from zsight_protocol.parameter import ParameterAnswer

__all__ = ["KnownSettings", "values_of"]

_LOOK = 2.0  # seconds between two looks at who is there


def values_of(answer: ParameterAnswer) -> dict[str, Any]:
    """Names and values."""
    return {parameter.name: parameter.value for parameter in answer.parameters}


class KnownSettings:
    """Asks all processes every other second, on a thread that ends with the bus."""

    def __init__(self, bus: Bus) -> None:
        """Args: bus."""
        self._bus = bus
        self._client = CellClient(bus).parameters
        self._answers: dict[str, ParameterAnswer] = {}
        self._sets = 0
        self._lock = threading.Lock()
        threading.Thread(target=self._look, name="settings", daemon=True).start()

    def answers(self) -> dict[str, ParameterAnswer]:
        """By HOST/PROCESS, of all that have settings."""
        with self._lock:
            return dict(self._answers)

    def set(self, process: str, name: str, value: Any, *, save: bool = False) -> str:
        """Change one, and keep it over a restart where asked; what became of it, in words.

        Raises:
            ZsightError: the process is gone, or it refuses.
        """
        told = self._client.set(process, name, value, save=save)
        with self._lock:
            self._sets += 1
            before = self._answers.get(process)
            if before is not None:
                fresh = {parameter.name: parameter for parameter in told.parameters}
                changed = tuple(fresh.get(parameter.name, parameter) for parameter in before.parameters)
                self._answers[process] = before.model_copy(update={"parameters": changed})
        return told.message

    def _look(self) -> None:
        while not self._bus.stopping.is_set():
            sets = self._sets
            try:
                found = {f"{a.host}/{a.process}": a for a in self._client.list() if a.parameters}
            except ZsightError:
                found = {}
            with self._lock:
                if sets == self._sets:  # else it may be from before something was set
                    self._answers = found
            self._bus.stopping.wait(_LOOK)
