"""A re-run of a recording in a process of its own, which may be stopped and holds nothing else up."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from zsight.catalogue import type_files
from zsight.errors import ZsightError
from zsight.recording.rerun import rerun
from zsight_core.errors import CoreError

if TYPE_CHECKING:
    from multiprocessing.connection import Connection
    from pathlib import Path

    from zsight_core.scene_limits import SceneLimits

__all__ = ["RerunProcess"]

_NICE = 10  # a live finder on this host goes first
_PATIENCE = 5.0  # seconds that a stopped process may take to end


@dataclass
class RerunProcess:
    """What is known of a re-run: ``rows`` as of `zsight.recording.rerun.rerun`, the share that is done, how it ended.

    ``error`` says why it failed; ``ended`` is true once no more rows come.
    """

    path: Path
    rows: list[dict[str, Any]] = field(default_factory=list)
    share: float = 0.0
    error: str = ""
    ended: bool = False

    def start(self, folders: tuple[Path, ...], limits: SceneLimits) -> None:
        """Begin.

        Args:
            folders: of object types beside those that come with zsight.
            limits: what counts as a thing.
        """
        context = multiprocessing.get_context("spawn")  # this process has threads, which a fork would break
        self._words, theirs = context.Pipe(duplex=False)
        self._process = context.Process(target=_run, args=(self.path, folders, limits, theirs), daemon=True)
        self._process.start()
        theirs.close()

    def look(self) -> bool:
        """Take in what the process told since; whether that was anything."""
        changed = False
        while not self.ended and self._words.poll():
            changed = True
            try:
                kind, *told = self._words.recv()
            except EOFError:  # it ended without a word
                self._end(f"the process ended with exit code {self._code()}")
                break
            if kind == "row":
                self.rows.append(told[0])
                self.share = told[1]
            else:
                self._end(*told)
        return changed

    def cancel(self) -> None:
        """Stop it; what is done so far stays."""
        if not self.ended:
            self._process.terminate()
            self._end("cancelled")

    def _end(self, error: str) -> None:
        self.ended, self.error = True, error
        self._code()
        self._words.close()

    def _code(self) -> int | None:
        self._process.join(_PATIENCE)
        return self._process.exitcode


def _run(path: Path, folders: tuple[Path, ...], limits: SceneLimits, words: Connection) -> None:
    """What the process does."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # Ctrl-C ends it without a traceback
    with contextlib.suppress(OSError):
        os.nice(_NICE)
    try:
        types = type_files.load(type_files.shipped_folder(), *folders)
        rerun(path, types, limits=limits, say=lambda row, share: words.send(("row", row, share)))
    except (ZsightError, CoreError, OSError) as error:
        words.send(("end", str(error)))
    else:
        words.send(("end", ""))
