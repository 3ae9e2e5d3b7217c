"""Commands of zsight as processes of their own, and what they leave behind."""

from __future__ import annotations

import contextlib
import json
import os
import re
import signal
import socket
import subprocess
import sys
import threading
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from types import TracebackType

__all__ = [
    "DEADLINE",
    "Command",
    "Ended",
    "children_of",
    "free_port",
    "is_alive",
    "leftovers",
    "run",
    "shared_memory_of",
]

DEADLINE = 60.0  # seconds; far more than anything here takes

_OWN = {name: value for name, value in os.environ.items() if not name.startswith(("ZSIGHT", "ZENOH"))}


@dataclass(frozen=True)
class Ended:
    """How a command ended."""

    code: int
    out: str
    err: str

    @property
    def json(self) -> Any:
        """The one JSON object on stdout."""
        (line,) = self.out.splitlines()
        return json.loads(line)


class Command:
    """A command that runs, and what it says on stderr; the end of the block ends it."""

    def __init__(self, *arguments: object, **environment: str) -> None:
        self.process = subprocess.Popen(
            [sys.executable, "-m", "zsight", *map(str, arguments)],
            env={**_OWN, **environment},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )
        self.lines: list[str] = []
        self._said = threading.Condition()
        self._listener = threading.Thread(target=self._listen)
        self._listener.start()

    def _listen(self) -> None:
        for line in self.process.stderr or ():
            with self._said:
                self.lines.append(line.rstrip("\n"))
                self._said.notify_all()
        with self._said:
            self._said.notify_all()

    def wait_for(self, words: str, *, after: int = 0) -> re.Match[str]:
        """The first line with these words (a pattern), among those after the first so many."""

        def heard() -> re.Match[str] | None:
            return next((found for line in self.lines[after:] if (found := re.search(words, line))), None)

        with self._said:
            self._said.wait_for(lambda: heard() or not self._listener.is_alive(), DEADLINE)
            found = heard()
            assert found, f"{words!r} was not said:\n" + "\n".join(self.lines)
            return found

    def children(self) -> dict[str, int]:
        """The processes of a cell that said it is up."""
        names = self.wait_for("^up: (.*)").group(1)
        return {name: int(pid) for name, pid in re.findall(r"(\S+) \((\d+)\)", names)}

    def interrupt(self) -> None:
        """Ctrl-C."""
        self.process.send_signal(signal.SIGINT)

    def ended(self) -> Ended:
        """Wait for the end."""
        out = self.process.stdout.read() if self.process.stdout else ""
        code = self.process.wait(DEADLINE)
        self._listener.join(DEADLINE)
        err = "\n".join(self.lines)
        assert "Traceback" not in err, err
        return Ended(code, out, err)

    def __enter__(self) -> Command:
        """Itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End it, if it still runs."""
        if self.process.poll() is None:
            self.process.terminate()
            try:
                self.process.wait(10)
            except subprocess.TimeoutExpired:
                self.process.kill()
                self.process.wait()
        self._listener.join(DEADLINE)
        for pipe in (self.process.stdout, self.process.stderr):
            if pipe is not None:
                pipe.close()


def run(*arguments: object, **environment: str) -> Ended:
    """A command from its start to its end."""
    with Command(*arguments, **environment) as command:
        return command.ended()


def free_port() -> int:
    """A port of this host that nobody listens on."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


def is_alive(pid: int) -> bool:
    """Whether a process runs; one that has ended and waits to be reaped does not."""
    try:
        state = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()[0]
    except OSError:
        return False
    return state != "Z"


def children_of(parent: int) -> list[int]:
    """The processes that a process started."""
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):  # it has ended meanwhile
            if int(stat.read_text(encoding="utf-8").rpartition(")")[2].split()[1]) == parent:
                found.append(int(stat.parent.name))
    return found


def leftovers(pids: dict[str, int], held: set[Path]) -> list[str]:
    """Processes that still run, and shared memory that is still there."""
    return [f"{name} ({pid})" for name, pid in pids.items() if is_alive(pid)] + [str(p) for p in held if p.exists()]


def shared_memory_of(pids: dict[str, int]) -> set[Path]:
    """Zenoh's shared memory that these processes use."""
    maps = [Path(f"/proc/{pid}/maps").read_text(encoding="utf-8") for pid in pids.values()]
    return {Path(word) for text in maps for word in re.findall(r"/dev/shm/\S+\.zenoh", text)}  # noqa: S108  read, not written
