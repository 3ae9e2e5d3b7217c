"""``zsight up`` and ``zsight down``: a table of processes on this host."""

from __future__ import annotations

import os
import signal
import threading
import time
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from zsight.cli.options import Connect, Namespace, network_of
from zsight.cli.output import say
from zsight.errors import NobodyAnswers, ZsightError

if TYPE_CHECKING:
    from zsight.cell_file import CellFile
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
    detach: Annotated[
        bool, typer.Option("--detach", "-d", help="Come back when all is up; stop with: zsight down")
    ] = False,
    quiet: Annotated[bool, typer.Option("--quiet", help="Do not pass on the services' logs.")] = False,
) -> None:
    """Start the processes of a cell on this host; restart what dies; Ctrl-C stops all."""
    from zsight import cell_file
    from zsight.supervisor import Supervisor

    table = cell_file.read(file) if file is not None else cell_file.DEFAULT_TABLE
    network = _network(table, connect, namespace, listen)
    if detach:
        _detach(network)
        return
    supervisor = Supervisor(table.processes, network, say=say, echo=not quiet)
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: supervisor.stopping.set())
    with supervisor, _pid_file(network):
        supervisor.wait_ready(60.0)
        if not supervisor.stopping.is_set():
            names = ", ".join(f"{child.entry.name} ({child.pid})" for child in supervisor.children)
            say(f"up: {names}")
        supervisor.watch()
    say("down")


def down(connect: Connect = None, namespace: Namespace = None) -> None:
    """Stop what ``zsight up`` started on this host."""
    network = network_of(connect, namespace)
    path = _pid_path(network)
    try:
        pid = int(path.read_text(encoding="ascii"))
        os.kill(pid, signal.SIGTERM)
    except (OSError, ValueError):
        path.unlink(missing_ok=True)
        raise NobodyAnswers(f"no cell {network.namespace} was started on this host by this user") from None
    deadline = time.monotonic() + 5.0
    pause = threading.Event()
    while _runs(pid):
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
    if listen or table.listen:
        endpoints = tuple(part.strip() for part in listen.split(",")) if listen else table.listen or ()
        network = replace(network, listen=endpoints, connect=tuple(_reachable(e) for e in endpoints[:1]))
    return network if connect is None else replace(network, connect=tuple(part.strip() for part in connect.split(",")))


def _reachable(endpoint: str) -> str:
    """How this host reaches a router that listens on any address."""
    return endpoint.replace("0.0.0.0", "127.0.0.1").replace("[::]", "[::1]")  # noqa: S104  compared, not bound


def _pid_path(network: Network) -> Path:
    import tempfile

    folder = os.environ.get("XDG_RUNTIME_DIR") or tempfile.gettempdir()
    return Path(folder) / f"zsight-{os.getuid() if hasattr(os, 'getuid') else 'user'}-{network.namespace}.pid"


class _pid_file:  # noqa: N801  reads as the action it is
    """Notes this process for ``zsight down`` while the cell is up."""

    def __init__(self, network: Network) -> None:
        self._path = _pid_path(network)

    def __enter__(self) -> None:
        self._path.write_text(str(os.getpid()), encoding="ascii")

    def __exit__(self, *_: object) -> None:
        with suppress(OSError):
            if self._path.read_text(encoding="ascii") == str(os.getpid()):
                self._path.unlink()


def _runs(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return True


def _detach(network: Network) -> None:
    """Start the same command in the background, and wait until its cell is up."""
    import subprocess
    import sys
    import tempfile

    arguments = [argument for argument in sys.argv[1:] if argument not in ("-d", "--detach")]
    with tempfile.NamedTemporaryFile(prefix="zsight-up-", suffix=".log", delete=False) as log:
        process = subprocess.Popen(
            [sys.executable, "-m", "zsight", *arguments],
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=log,
            start_new_session=True,
        )
    path = _pid_path(network)
    pause = threading.Event()
    while process.poll() is None:
        if "up: " in Path(log.name).read_text(encoding="utf-8", errors="replace"):
            say(f"up as process {process.pid}, log in {log.name}; stop with: zsight down")
            return
        pause.wait(0.05)
    words = Path(log.name).read_text(encoding="utf-8", errors="replace").strip().splitlines()
    path.unlink(missing_ok=True)
    raise NobodyAnswers("the cell did not come up; its last words:\n" + "\n".join(words[-8:]))
