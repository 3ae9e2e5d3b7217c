"""What the find-object action costs beyond a bare Zenoh query, and whether it keeps its word in time.

How soon a killed finder is noticed, how soon a cancelled find has stopped, and how fairly many clients are served.
"""

from __future__ import annotations

import socket
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bench_row import row
from cancelling import cancel_waits

from zsight.client import CellClient
from zsight.errors import ServerLost
from zsight.network import Network
from zsight.runtime import join
from zsight_protocol.action import GoalState

if TYPE_CHECKING:
    from zsight.action.client import GoalCall

ECHO = Path(__file__).resolve().parent.parent / "tests" / "system" / "echo_server.py"
ROUNDS, KILLS = 400, 20
CLIENTS, GOALS_EACH = 20, 50


def run() -> list[dict[str, Any]]:
    """Rows of ``zsight bench action``; router, server and client are three processes on this host."""
    endpoint = f"tcp/127.0.0.1:{_free_port()}"
    router = _start("router", endpoint)
    server = _start("server", endpoint, "1", "16")
    try:
        with CellClient(join(Network().on(endpoint))) as cell:
            bare, action = _interleaved(cell)
        _stop(server)
        kills = _kills(endpoint)
        ends = _crowd(endpoint)
        with tempfile.TemporaryDirectory() as folder:
            cancels = cancel_waits(endpoint, Path(folder))
    finally:
        for process in (server, router):
            _stop(process)
    return [*_overhead_rows(bare, action), *_kill_rows(kills), *_crowd_rows(ends), *_cancel_rows(cancels)]


def _overhead_rows(bare: list[float], action: list[float]) -> list[dict[str, Any]]:
    pairs = statistics.median(a - b for a, b in zip(action, bare, strict=True))
    return [
        row("action p50", statistics.median(action), peer="bare query p50", peer_value=statistics.median(bare)),
        row("action p99", _p99(action), peer="bare query p99", peer_value=_p99(bare)),
        row("overhead p50", statistics.median(action) - statistics.median(bare), target=1.0),
        row("overhead p99", _p99(action) - _p99(bare), target=3.0),
        row("overhead, median of pairs", pairs, target=1.0),
    ]


def _interleaved(cell: CellClient) -> tuple[list[float], list[float]]:
    """Milliseconds of a bare query and of a goal that is done at once, taking turns."""
    bare: list[float] = []
    action: list[float] = []
    for number in range(ROUNDS + 20):
        begin = time.perf_counter()
        replies = cell.bus.ask("echo/bare", b"?", 5.0)
        while replies.take(5.0) is not None:
            pass
        middle = time.perf_counter()
        cell.start_find("anything", finder="finder").wait()
        if number >= 20:  # the first rounds warm both up
            bare.append((middle - begin) * 1e3)
            action.append((time.perf_counter() - middle) * 1e3)
    return bare, action


def _kill_rows(waits: list[float]) -> list[dict[str, Any]]:
    return [
        row("killed finder noticed, median", statistics.median(waits), target=150.0),
        row("killed finder noticed, worst", max(waits), target=150.0),
    ]


def _kills(endpoint: str) -> list[float]:
    """Milliseconds from the kill of a finder at work to the error at its client."""
    waits: list[float] = []
    with CellClient(join(Network(namespace="kills").on(endpoint))) as cell:
        for _ in range(KILLS):
            server = _start("server", endpoint, "1", "1", "kills")
            call: GoalCall[Any] = cell.start_find("anything", finder="finder", known_height=60.0, timeout=120.0)
            next(iter(call))
            begin = time.perf_counter()
            server.kill()
            try:
                call.wait()
            except ServerLost:
                waits.append((time.perf_counter() - begin) * 1e3)
            _stop(server)
    return waits


def _crowd_rows(ends: list[list[float]]) -> list[dict[str, Any]]:
    """Fairness is that of Jain, Chiu and Hawe (1984): 1 where all clients have as much done, 1/20 where one has all."""
    every = sorted(end for client in ends for end in client)
    half = every[len(every) // 2]
    done = [sum(end <= half for end in client) for client in ends]
    fairness = sum(done) ** 2 / (len(done) * sum(count**2 for count in done))
    return [
        row("goals of 20 clients at once that succeeded", len(every), "of 1000", target=1000, least=True),
        row("the last of them ended after", every[-1] * 1e3),
        row("fairness when half were done (Jain)", fairness, "", target=None),
        row("first client ready / last client ready", min(map(max, ends)) / max(map(max, ends)), ""),
    ]


def _crowd(endpoint: str) -> list[list[float]]:
    """Seconds from the start to the end of each client's goals, all sent at once, of about 1 ms of work each."""
    server = _start("server", endpoint, "4", "1000", "crowd")
    ends: list[list[float]] = [[] for _ in range(CLIENTS)]
    start = threading.Barrier(CLIENTS)

    def ask(number: int) -> None:
        with CellClient(join(Network(namespace="crowd").on(endpoint))) as cell:
            start.wait()
            begin = time.perf_counter()
            calls = [
                cell.start_find("anything", finder="finder", known_height=1e-3, timeout=120.0)
                for _ in range(GOALS_EACH)
            ]
            for call in calls:
                if call.wait().state is GoalState.SUCCEEDED:
                    ends[number].append(time.perf_counter() - begin)

    clients = [threading.Thread(target=ask, args=(number,)) for number in range(CLIENTS)]
    for client in clients:
        client.start()
    for client in clients:
        client.join()
    _stop(server)
    return ends


def _cancel_rows(waits: list[float]) -> list[dict[str, Any]]:
    within = sum(wait <= 50.0 for wait in waits) / len(waits)
    return [
        row("cancelled find has stopped, median", statistics.median(waits), target=50.0),
        row("cancelled find has stopped, p99", _p99(waits), target=50.0),
        row("cancelled find has stopped, worst", max(waits), target=None),
        row("cancelled finds stopped within 50 ms", within * 100, "%"),
    ]


def _p99(values: list[float]) -> float:
    return sorted(values)[int(0.99 * (len(values) - 1))]


def _start(*arguments: str) -> subprocess.Popen[bytes]:
    process = subprocess.Popen([sys.executable, str(ECHO), *arguments], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    if process.stdout is None or process.stdout.readline() != b"ready\n":
        raise RuntimeError(f"{arguments[0]} does not start")
    return process


def _stop(process: subprocess.Popen[bytes]) -> None:
    if process.stdin is not None:
        process.stdin.close()
    process.wait(10)
    if process.stdout is not None:
        process.stdout.close()


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port
