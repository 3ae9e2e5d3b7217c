"""Starts a table of processes, starts again what dies, and stops them all."""

from __future__ import annotations

import contextlib
import logging
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections import deque
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from zsight import shared_memory
from zsight.errors import ConnectionLost, UsageError, ZsightError
from zsight.runtime import SUPERVISED, host_name, join, version
from zsight.settings import variable
from zsight_protocol.codec import encode
from zsight_protocol.host_report import Crash, HostReport, ProcessReport
from zsight_protocol.message import Header, Time

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from zsight.bus import Bus, RawRequest
    from zsight.hosts.cell_file import ProcessEntry
    from zsight.network import Network

__all__ = ["Child", "Supervisor"]

log = logging.getLogger(__name__)

_PATIENCE = 1.5  # seconds that a process has to stop before it is killed
_FIRST_PAUSE, _LONGEST_PAUSE = 0.2, 10.0  # seconds before a dead process is started again
_STEADY = 10.0  # seconds after which a process counts as healthy again
_LAST_LINES, _LONGEST_LINE = 12, 500  # of its log that a crash report keeps
_NO_USE = 2  # exit code of a process whose settings make no sense: starting it again would not help


@dataclass(eq=False)
class Child:
    """A process of the table and its present incarnation: ``alive`` while it is heard of, ``ready`` once it was."""

    entry: ProcessEntry
    process: subprocess.Popen[bytes] | None = None
    started: float = 0.0
    pause: float = _FIRST_PAUSE
    starts: int = 0
    start_at: float = 0.0
    finished: bool = False
    crash: Crash | None = None
    last_words: deque[str] = field(default_factory=lambda: deque(maxlen=40))
    alive: threading.Event = field(default_factory=threading.Event)
    ready: bool = False

    @property
    def pid(self) -> int | None:
        """Its number while it runs."""
        return self.process.pid if self.process is not None else None

    def report(self) -> ProcessReport:
        """How it is, and how it ended the last time."""
        unheard = "silent" if self.ready else "starting"
        running = "running" if self.alive.is_set() else unheard
        resting = "ended" if self.finished else "waiting"
        return ProcessReport(
            process=self.entry.name,
            service=self.entry.service,
            state=resting if self.process is None else running,
            pid=self.pid or 0,
            starts=self.starts,
            crash=self.crash,
        )

    def note_end(self, code: int) -> None:
        """Keep why it ended, with the last lines of its log."""
        words = tuple(line[:_LONGEST_LINE] for line in list(self.last_words)[-_LAST_LINES:])
        self.crash = Crash(stamp=Time.now(), reason=_reason(code), last_words=words)
        self.last_words.clear()


class Supervisor:
    """The processes of one host; a context manager that leaves none behind."""

    def __init__(
        self, table: tuple[ProcessEntry, ...], network: Network, *, say: Callable[[str], None], echo: bool = True
    ) -> None:
        """Args: table of processes; network they join; say: told every event; echo: pass their logs to stderr."""
        self.children = [Child(entry) for entry in table]
        self._network = network
        self._say = say
        self._echo = echo
        self._changed = threading.Event()
        self.stopping = threading.Event()
        self._bus: Bus | None = None

    def __enter__(self) -> Supervisor:
        """Start everything; on failure nothing is left running."""
        try:
            self.start()
        except BaseException:
            self.stop()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        """Stop everything."""
        self.stop()

    def start(self) -> None:
        """Start all processes and join their network.

        Raises:
            ConnectionLost: the router's port is taken, or the router does not come up.
        """
        if any(child.entry.service == "router" for child in self.children):
            _require_free(self._network)
        with _uninterrupted():
            for child in self.children:
                self._launch(child)
        try:
            self._bus = join(self._network, wait=20.0, stopping=self.stopping)
        except ConnectionLost:
            if self.stopping.is_set():
                return
            raise
        self._bus.serve(self._bus.cell.host(host_name()), self._asked)
        self._bus.link.watch_alive(self._bus.cell.alive(host_name(), "*"), self._alive_changed)

    def wait_ready(self, timeout: float) -> None:
        """Wait until every process has its liveliness token; what dies meanwhile is not started again.

        Raises:
            ZsightError: a process ended; with its last words.
            ConnectionLost: they were not all ready in time; says which.
        """
        deadline = time.monotonic() + timeout
        for child in self.children:
            while not child.alive.wait(0.02):
                code = child.process.poll() if child.process is not None else None
                if code is not None:
                    raise self._ended(child, code)
                if self.stopping.is_set():
                    return
                if time.monotonic() > deadline:
                    late = ", ".join(c.entry.name for c in self.children if not c.alive.is_set())
                    raise ConnectionLost(f"not ready within {timeout:g} s: {late}")

    def _ended(self, child: Child, code: int) -> ZsightError:
        words = "" if self._echo else "; its last words:\n" + "\n".join(list(child.last_words)[-8:])
        kind = UsageError if code == _NO_USE else ZsightError
        return kind(f"{child.entry.name} ended at its start ({_reason(code)}){words}")

    def watch(self) -> None:
        """Start again what dies, until stopping is set or nothing is left to watch."""
        while not self.stopping.is_set() and not all(child.finished for child in self.children):
            for child in self.children:
                self._look_after(child)
            self._changed.wait(0.05)
            self._changed.clear()

    def _look_after(self, child: Child) -> None:
        now = time.monotonic()
        if child.finished:
            return
        if child.process is None:
            if now >= child.start_at:
                self._launch(child)
            return
        code = child.process.poll()
        if code is None:
            if now - child.started > _STEADY:
                child.pause = _FIRST_PAUSE
            return
        if child.process.stdin is not None:
            child.process.stdin.close()
        child.process = None
        child.alive.clear()
        child.ready = False
        child.note_end(code)
        if code in (0, _NO_USE):
            child.finished = True
            self._say(f"{child.entry.name} ended ({_reason(code)})")
            return
        self._say(f"{child.entry.name} died ({_reason(code)}); starting it again in {child.pause:g} s")
        child.start_at = now + child.pause
        child.pause = min(child.pause * 2, _LONGEST_PAUSE)

    def _launch(self, child: Child) -> None:
        entry = child.entry
        command = [sys.executable, "-m", "zsight", "run", entry.service, "--process", entry.name]
        table = {variable(entry.name, name): str(value) for name, value in entry.settings.items()}
        child.process = subprocess.Popen(
            command,
            env={**table, **os.environ, **self._network.environment(), SUPERVISED: "1"},
            stdin=subprocess.PIPE,  # its end tells the process that its supervisor is gone
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            start_new_session=True,  # Ctrl-C at the terminal reaches the supervisor alone, which stops all in order
        )
        child.started = time.monotonic()
        child.starts += 1
        threading.Thread(target=self._listen, args=(child, child.process), daemon=True).start()
        if child.starts > 1:
            self._say(f"{entry.name} started again as process {child.process.pid}")

    def _listen(self, child: Child, process: subprocess.Popen[bytes]) -> None:
        if process.stderr is None:
            return
        with contextlib.suppress(ValueError), process.stderr:  # the pipe is closed when the supervisor stops
            for line in process.stderr:
                text = line.decode("utf-8", "replace").rstrip()
                child.last_words.append(text)
                if self._echo:
                    print(text, file=sys.stderr, flush=True)
        self._changed.set()

    def _asked(self, request: RawRequest) -> None:
        reports = tuple(child.report() for child in self.children)
        report = HostReport(header=Header(stamp=Time.now()), host=host_name(), version=version(), processes=reports)
        request.reply(encode(report))
        request.close()

    def _alive_changed(self, key: str, alive: bool) -> None:
        name = key.rsplit("/", 1)[-1]
        for child in self.children:
            if child.entry.name == name:
                if alive:
                    child.alive.set()
                    child.ready = True
                else:
                    child.alive.clear()

    def stop(self) -> None:
        """Stop all processes, the router last; kill what does not stop."""
        self.stopping.set()
        if self._bus is not None:
            self._bus.close()
            self._bus = None
        running = [child.process for child in self.children if child.process is not None]
        others = [c.process for c in self.children if c.process is not None and c.entry.service != "router"]
        for group in (others, running):
            for process in group:
                with contextlib.suppress(OSError):
                    process.terminate()
            deadline = time.monotonic() + _PATIENCE
            for process in group:
                _wait_or_kill(process, deadline)
        shared_memory.remove_orphans()


@contextlib.contextmanager
def _uninterrupted() -> Iterator[None]:
    """Put Ctrl-C off to the end of the block: a process half started would be forgotten."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    came: list[int] = []
    before = signal.signal(signal.SIGINT, lambda number, _: came.append(number))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
    if came and callable(before):
        before(signal.SIGINT, None)


def _wait_or_kill(process: subprocess.Popen[bytes], deadline: float) -> None:
    try:
        process.wait(max(deadline - time.monotonic(), 0.01))
    except subprocess.TimeoutExpired:
        log.warning("process %d does not stop: killed", process.pid)
        process.kill()
        process.wait()
    for pipe in (process.stdin, process.stderr):
        if pipe is not None:
            pipe.close()


def _reason(code: int) -> str:
    if code >= 0:
        return f"exit code {code}"
    try:
        return f"killed by {signal.Signals(-code).name}"
    except ValueError:
        return f"killed by signal {-code}"


def _require_free(network: Network) -> None:
    """That nobody listens yet where the router will.

    Raises:
        ConnectionLost: somebody does.
    """
    for endpoint in network.listen:
        address = endpoint.partition("/")[2].partition("#")[0].partition("?")[0]
        host, _, port = address.rpartition(":")
        if not port.isdigit():
            continue
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        with socket.socket(family, socket.SOCK_STREAM) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind((host.strip("[]"), int(port)))
            except OSError as error:
                raise ConnectionLost(
                    f"port {port} on {host} is taken ({error.strerror}): is a cell up there already? "
                    "Stop it with: zsight down; or choose another port with: --listen"
                ) from None
