"""The keys of a keyboard that control a player."""

from __future__ import annotations

import contextlib
import os
import re
import select
import sys
import threading
from typing import TYPE_CHECKING, Self

from zsight.errors import ZsightError
from zsight_protocol.recording import PlayerRequest

if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import TextIO

    from zsight.recording.player import Player

__all__ = ["PlayerKeys"]


_KEYS = re.compile(r"\x1b\[[A-D]|.", re.DOTALL)  # an arrow, or one sign; several may have come at once


class PlayerKeys:
    """Reads keys at a terminal while the block lasts; elsewhere does nothing."""

    def __init__(self, player: Player, terminal: TextIO | None = None) -> None:
        """Args: the player that they control; where the keys come from, standard input if not given."""
        self._player = player
        self._terminal = terminal or sys.stdin
        self._closed = False
        self.ended = False
        self.is_on = self._terminal.isatty() and (terminal is not None or sys.stderr.isatty())
        self._thread = threading.Thread(target=self._read, name="keys", daemon=True)

    def __enter__(self) -> Self:
        """Let keys come one by one, unseen."""
        if self.is_on:
            import termios
            import tty

            self._before = termios.tcgetattr(self._terminal)
            tty.setcbreak(self._terminal)
            self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Let the terminal be as it was."""
        self._closed = True
        if self.is_on:
            import termios

            self._thread.join()
            termios.tcsetattr(self._terminal, termios.TCSADRAIN, self._before)

    def _read(self) -> None:
        while not self._closed:
            if select.select([self._terminal], [], [], 0.1)[0]:
                for key in _KEYS.findall(os.read(self._terminal.fileno(), 64).decode("ascii", "replace")):
                    self.press(key)

    def press(self, key: str) -> None:
        """What a key does; an unknown one nothing."""
        meaning = self._meanings().get(key)
        if meaning is not None:
            with contextlib.suppress(ZsightError):
                meaning()

    def _meanings(self) -> dict[str, Callable[[], object]]:
        return {
            " ": lambda: self._player.do(PlayerRequest(action="toggle")),
            ".": lambda: self._player.do(PlayerRequest(action="step")),
            "\x1b[C": lambda: self._seek(1),
            "\x1b[D": lambda: self._seek(-1),
            "\x1b[A": lambda: self._seek(10),
            "\x1b[B": lambda: self._seek(-10),
            "+": lambda: self._rate(2),
            "-": lambda: self._rate(0.5),
            "q": self._end,
        }

    def _seek(self, by: float) -> None:
        position = max(self._player.state().position + by, 0.0)
        self._player.do(PlayerRequest(action="seek", position=position))

    def _rate(self, factor: float) -> None:
        rate = min(max(self._player.state().rate * factor, 1 / 64), 64)
        self._player.do(PlayerRequest(action="rate", rate=rate))

    def _end(self) -> None:
        self.ended = True
