"""``zsight up`` and ``zsight down``: a table of processes on this host."""

from __future__ import annotations

import os
import signal
import threading
import time
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import IO, TYPE_CHECKING, Annotated

import typer

from zsight.cli.options import Connect, Json, Namespace, Open, network_of
from zsight.cli.output import print_json, print_table, say
from zsight.cli.running import require_warm
from zsight.errors import ConnectionLost, NobodyAnswers, UsageError, ZsightError
from zsight.network import endpoints_given
from zsight.own_files import folder as own_folder
from zsight.own_files import open_own
from zsight.stop_signals import stop_signals

if TYPE_CHECKING:
    from zsight.hosts.cell_file import CellFile
    from zsight.network import Network

__all__ = ["down", "up"]

Listen = Annotated[
    str | None,
    typer.Option("--listen", metavar="ENDPOINT", help="Where the router listens, tcp/127.0.0.1:7447 if not given."),
]


def up(
    file: Annotated[Path | None, typer.Argument(help="Table of processes (TOML); else router to finder.")] = None,
    connect: Connect = None,
    namespace: Namespace = None,
    listen: Listen = None,
    everybody: Open = False,
    hosts: Annotated[bool, typer.Option("--hosts", help="Start nothing; show what is up on all hosts.")] = False,
    json: Json = False,
    detach: Annotated[
        bool, typer.Option("--detach", "-d", help="Come back when all is up; stop with: zsight down")
    ] = False,
    quiet: Annotated[bool, typer.Option("--quiet", help="Do not pass on the services' logs.")] = False,
) -> None:
    """Start the processes of a cell on this host; restart what dies; Ctrl-C stops all."""
    from zsight.hosts import cell_file
    from zsight.hosts.supervisor import Supervisor

    if hosts:
        _show_hosts(network_of(connect, namespace), as_json=json)
        return
    table = cell_file.read(file) if file is not None else cell_file.DEFAULT_TABLE
    if any(entry.service != "router" for entry in table.processes):
        require_warm()
    network = _network(table, connect, namespace, listen)
    network = replace(network, open=network.open or everybody)
    if any(entry.service == "router" for entry in table.processes):
        network.require_guarded()
    if detach:
        _detach(network)
        return
    supervisor = Supervisor(table.processes, network, say=say, echo=not quiet)
    for number in stop_signals():
        signal.signal(number, lambda *_: supervisor.stopping.set())
    with _pid_file(network), supervisor:
        supervisor.wait_ready(60.0)
        if not supervisor.stopping.is_set():
            names = ", ".join(f"{child.entry.name} ({child.pid})" for child in supervisor.children)
            say(f"up: {names}")
        supervisor.watch()
    say("down")


def _show_hosts(network: Network, *, as_json: bool) -> None:
    """Every process of every host: those of supervisors, and those that were started otherwise."""
    from zsight.hosts.beats import ask_health
    from zsight.hosts.reports import ask_hosts
    from zsight.runtime import join

    with join(network) as bus:
        beats, reports = ask_health(bus), ask_hosts(bus)
    if not beats and not reports:
        raise NobodyAnswers(f"a router answers, but cell {network.namespace} is empty: start it with: zsight up")
    supervised = {(report.host, one.process): one for report in reports for one in report.processes}
    alone = {(b.host, b.process): b for b in beats if (b.host, b.process) not in supervised}
    rows = [
        (host, o.process, o.service, o.state, o.pid, o.starts, o.crash.reason if o.crash else "")
        for (host, _), o in supervised.items()
    ]
    rows += [(host, b.process, b.service, "running", b.pid, 1, "") for (host, _), b in alone.items()]
    names = ("host", "process", "service", "state", "pid", "starts", "last_end")
    if as_json:
        print_json({"processes": [dict(zip(names, row, strict=True)) for row in sorted(rows)]})
    else:
        print_table(
            [name.replace("_", " ") for name in names], [tuple(cell or "-" for cell in row) for row in sorted(rows)]
        )


def down(connect: Connect = None, namespace: Namespace = None) -> None:
    """Stop what "zsight up" started on this host."""
    network = network_of(connect, namespace)
    path = _running(network)
    with open_own(path) as file:
        pid = int(file.read())
    os.kill(pid, signal.SIGTERM)
    deadline = time.monotonic() + 5.0
    pause = threading.Event()
    while _is_held(path):
        if time.monotonic() > deadline:
            raise ZsightError(f"process {pid} does not stop within 5 s")
        pause.wait(0.02)
    say("down")


def _network(table: CellFile, connect: str | None, namespace: str | None, listen: str | None) -> Network:
    """Options before the file, the file before the environment; a router of ours is the one that ours join."""
    network = network_of(None)
    network = replace(network, namespace=namespace or table.namespace or network.namespace)
    if table.connect:
        network = replace(network, connect=table.connect)
    if listen is not None or table.listen:
        endpoints = endpoints_given(listen, "--listen") if listen is not None else table.listen or ()
        network = replace(network, listen=endpoints, connect=tuple(_reachable(e) for e in endpoints[:1]))
    return network if connect is None else replace(network, connect=endpoints_given(connect, "--connect"))


def _reachable(endpoint: str) -> str:
    """How this host reaches a router that listens on any address."""
    return endpoint.replace("0.0.0.0", "127.0.0.1").replace("[::]", "[::1]")  # noqa: S104  compared, not bound


def _pid_path(network: Network, endpoint: str | None = None) -> Path:
    """Where the number of the process that holds a cell is noted: one file a namespace and router."""
    user = os.getuid() if hasattr(os, "getuid") else "user"
    router = (endpoint or network.connect[0]).replace("/", "_")
    return own_folder() / f"zsight-{user}-{network.namespace}@{router}.pid"


def _running(network: Network) -> Path:
    """The pid file of the cell that is meant: the one on the router that the options name, else the only one.

    Raises:
        NobodyAnswers: there is none.
        UsageError: there are several on other routers.
    """
    own = _pid_path(network)
    pattern = _pid_path(network, "*").name
    running = [path for path in sorted(own.parent.glob(pattern)) if _is_held(path)]
    if own in running:
        return own
    if not running:
        raise NobodyAnswers(f"no cell {network.namespace} was started on this host by this user")
    if len(running) > 1:
        routers = ", ".join(path.stem.partition("@")[2].replace("_", "/") for path in running)
        raise UsageError(f"cells {network.namespace} are up at {routers}: name one with --connect")
    return running[0]


def _is_held(path: Path) -> bool:
    """Whether the process that a pid file names still holds its lock; its number may be another process's by now."""
    import fcntl

    with suppress(FileNotFoundError), open_own(path) as file:
        return not _lock(file, fcntl.LOCK_SH)
    return False


def _lock(file: IO[bytes], kind: int) -> bool:
    """Take a lock on a file, for as long as it is open; false where somebody else has one that excludes it."""
    import fcntl

    try:
        fcntl.flock(file, kind | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


def _held(path: Path) -> IO[bytes] | None:
    """The file at a path, with the lock on it that a cell holds; none where another cell does."""
    import fcntl

    while True:
        file = open_own(path, os.O_CREAT)
        if _lock(file, fcntl.LOCK_EX):
            with suppress(FileNotFoundError):
                if os.path.samestat(os.fstat(file.fileno()), path.lstat()):  # not what a cell that ended took away
                    return file
        elif not _lock(file, fcntl.LOCK_SH):  # who only looks shares the lock, a cell does not
            file.close()
            return None
        file.close()


class _pid_file:  # noqa: N801  reads as the action it is
    """Notes this process for ``zsight down`` until its cell is down."""

    def __init__(self, network: Network) -> None:
        self._network = network
        self._path = _pid_path(network)

    def __enter__(self) -> None:
        file = _held(self._path)
        if file is None:
            raise _is_up(self._network)
        self._file = file
        self._file.truncate(0)
        self._file.write(str(os.getpid()).encode())

    def __exit__(self, *_: object) -> None:
        self._path.unlink(missing_ok=True)
        self._file.close()


def _is_up(network: Network) -> ConnectionLost:
    cell = f"cell {network.namespace} on {network.connect[0]}"
    return ConnectionLost(f"{cell} is up already; stop it with: zsight down; or give --listen or --namespace")


def _detach(network: Network) -> None:
    """Start the same command in the background, and wait until its cell is up."""
    import subprocess
    import sys
    import tempfile

    pid_path = _pid_path(network)
    if _is_held(pid_path):
        raise _is_up(network)
    path = pid_path.with_suffix(".log")
    with suppress(FileNotFoundError):
        open_own(path).close()
    arguments = [argument for argument in sys.argv[1:] if argument not in ("-d", "--detach")]
    # Others may start the same cell now: the log is this start's own until the cell is up.
    handle, name = tempfile.mkstemp(prefix=f"{path.stem}-", suffix=".log", dir=path.parent)
    own = Path(name)
    with os.fdopen(handle) as log:
        process = subprocess.Popen(
            [sys.executable, "-m", "zsight", *arguments],
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=log,
            start_new_session=True,
        )
    pause = threading.Event()
    try:
        while process.poll() is None:
            if "\nup: " in "\n" + own.read_text(encoding="utf-8", errors="replace"):
                own.replace(path)
                say(f"up as process {process.pid}, log in {path}; stop with: zsight down")
                return
            pause.wait(0.05)
        words = own.read_text(encoding="utf-8", errors="replace").strip().splitlines()
    except KeyboardInterrupt:
        process.terminate()
        process.wait()
        raise
    finally:
        own.unlink(missing_ok=True)
    last = "\n".join(words[-8:]).removeprefix("zsight: ")
    kind = UsageError if process.returncode == UsageError.exit_code else NobodyAnswers
    raise kind(last if len(words) == 1 else f"the cell did not come up; its last words:\n{last}")
