"""Recorders and players as a program sees them."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeVar

from zsight.errors import RequestRefused
from zsight.question import ask_question
from zsight_protocol.recording import PlayerRequest, PlayerState, RecorderRequest, RecorderState

if TYPE_CHECKING:
    from zsight.bus import Bus
    from zsight_protocol.message import Message

__all__ = ["PlayerClient", "RecorderClient"]

_TIMEOUT = 15.0  # seconds; closing a file and seeking wait for the disk

S = TypeVar("S", RecorderState, PlayerState)


class RecorderClient:
    """One recorder of a cell, or whichever is there. Every method returns how it stands afterwards.

    All raise NobodyAnswers where no recorder is there, and RequestRefused where it says no.
    """

    def __init__(self, bus: Bus, name: str = "*") -> None:
        """Args: bus of the cell; name of the recorder, '*' for any."""
        self._bus = bus
        self._key = bus.cell.recorder(name)

    def start(self, path: str = "", keys: tuple[str, ...] = ()) -> RecorderState:
        """Begin a recording at a path in the recorder's folder or one of its choice, of its keys or of these."""
        return self._ask(RecorderRequest(action="start", path=path, keys=keys))

    def stop(self) -> RecorderState:
        """End the recording; once this returns, the file is whole."""
        return self._ask(RecorderRequest(action="stop"))

    def trigger(self) -> RecorderState:
        """Write the seconds that are kept in memory, and those that follow."""
        return self._ask(RecorderRequest(action="trigger"))

    def status(self) -> RecorderState:
        """How it stands."""
        return self._ask(RecorderRequest(action="status"))

    def _ask(self, request: RecorderRequest) -> RecorderState:
        return _ask(self._bus, self._key, request, RecorderState)


class PlayerClient:
    """One player of a cell, or whichever is there. Every method returns how it stands afterwards.

    All raise NobodyAnswers where no player is there, and RequestRefused where it says no.
    """

    def __init__(self, bus: Bus, name: str = "*") -> None:
        """Args: bus of the cell; name of the player, '*' for any."""
        self._bus = bus
        self._key = bus.cell.player(name)

    def open(self, path: str) -> PlayerState:
        """Open a recording on the player's host."""
        return self._ask(PlayerRequest(action="open", path=path))

    def play(self) -> PlayerState:
        """Go on."""
        return self._ask(PlayerRequest(action="play"))

    def pause(self) -> PlayerState:
        """Stand still."""
        return self._ask(PlayerRequest(action="pause"))

    def step(self) -> PlayerState:
        """Send the next message, and stand still."""
        return self._ask(PlayerRequest(action="step"))

    def seek(self, position: float) -> PlayerState:
        """Go to a place, seconds from the beginning: what was in force there has been sent when this returns."""
        return self._ask(PlayerRequest(action="seek", position=position))

    def set_rate(self, rate: float) -> PlayerState:
        """Play so many times as fast as it was recorded."""
        return self._ask(PlayerRequest(action="rate", rate=rate))

    def set_loop(self, loop: bool) -> PlayerState:
        """Begin again after the end, or not."""
        return self._ask(PlayerRequest(action="loop", loop=loop))

    def status(self) -> PlayerState:
        """How it stands."""
        return self._ask(PlayerRequest(action="status"))

    def _ask(self, request: PlayerRequest) -> PlayerState:
        return _ask(self._bus, self._key, request, PlayerState)


def _ask(bus: Bus, key: str, request: Message, kind: type[S]) -> S:
    (state,) = ask_question(bus, key, request, kind, everyone=False, timeout=_TIMEOUT)
    if not state.ok:
        raise RequestRefused(state.message)
    return state
