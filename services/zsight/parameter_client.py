"""The settings of the processes of a cell, as a program lists, reads and sets them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from zsight.errors import NobodyAnswers, UsageError
from zsight.question import ask_question
from zsight_protocol.errors import KeyNameError
from zsight_protocol.parameter import ParameterAnswer, ParameterRequest

if TYPE_CHECKING:
    import builtins

    from pydantic import JsonValue

    from zsight.bus import Bus
    from zsight_protocol.parameter import Parameter

__all__ = ["ParameterClient"]

_EVERYONE = "*"


class ParameterClient:
    """The settings of running processes; a process is named by itself or as HOST/NAME."""

    def __init__(self, bus: Bus) -> None:
        """Args: bus of the cell."""
        self._bus = bus

    def list(self, process: str = _EVERYONE) -> builtins.list[ParameterAnswer]:
        """The settings of every process of that name, or of all, by host and process.

        Raises:
            NobodyAnswers: there is none.
        """
        return self._ask(process, ParameterRequest(action="list"))

    def get(self, process: str, name: str) -> Parameter:
        """One setting as it is now.

        Raises:
            NobodyAnswers: there is no such process.
            RequestRefused: it has no such setting.
            UsageError: several hosts have such a process.
        """
        return self._only(process, ParameterRequest(action="get", name=name)).parameters[0]

    def set(self, process: str, name: str, value: JsonValue, *, save: bool = False) -> ParameterAnswer:
        """Change one setting, and keep it over a restart where asked.

        Returns:
            The setting as it is now, and what became of the change in words.

        Raises:
            NobodyAnswers: there is no such process.
            RequestRefused: it has no such setting, the value is out of range, or it is fixed while the process runs.
            UsageError: several hosts have such a process.
        """
        if "/" not in process:
            whose = self._only(process, ParameterRequest(action="get", name=name))
            process = f"{whose.host}/{whose.process}"
        return self._only(process, ParameterRequest(action="set", name=name, value=value, save=save))

    def _only(self, process: str, request: ParameterRequest) -> ParameterAnswer:
        answers = self._ask(process, request)
        if len(answers) > 1:
            several = ", ".join(f"{answer.host}/{answer.process}" for answer in answers)
            raise UsageError(f"there are {several}: name one of them")
        return answers[0]

    def _ask(self, process: str, request: ParameterRequest) -> builtins.list[ParameterAnswer]:
        host, _, name = process.rpartition("/")
        try:
            key = self._bus.cell.parameters(host or _EVERYONE, name)
        except KeyNameError as error:
            raise UsageError(str(error)) from None
        try:
            answers = ask_question(self._bus, key, request, ParameterAnswer, everyone=True)
        except NobodyAnswers:
            raise NobodyAnswers(f"no process {process} is there; see: zsight node list") from None
        return sorted(answers, key=lambda answer: (answer.host, answer.process))
