"""What the find-object action costs beyond a bare Zenoh query, and how soon a killed finder is noticed."""

from __future__ import annotations

import socket
import statistics
import subprocess
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from zsight.client import CellClient
from zsight.errors import ServerLost
from zsight.network import Network
from zsight.runtime import join

if TYPE_CHECKING:
    from zsight.action_client import GoalCall

ECHO = Path(__file__).resolve().parent.parent / "tests" / "system" / "echo_server.py"
ROUNDS, KILLS = 400, 20


def run() -> list[dict[str, Any]]:
    """Rows of ``zsight bench action``; router, server and client are three processes on this host."""
    endpoint = f"tcp/127.0.0.1:{_free_port()}"
    router = _start("router", endpoint)
    server = _start("server", endpoint, "1", "16")
    try:
        with CellClient(join(Network().on(endpoint))) as cell:
            bare, action = _interleaved(cell)
        overheads = sorted(a - b for a, b in zip(action, bare, strict=True))
        waits = _kills(endpoint)
    finally:
        for process in (server, router):
            _stop(process)
    p50, p99 = statistics.median(action) - statistics.median(bare), _p99(action) - _p99(bare)
    return [
        _row("action p50", statistics.median(action), "bare query p50", statistics.median(bare), None, None),
        _row("action p99", _p99(action), "bare query p99", _p99(bare), None, None),
        _row("overhead p50", p50, None, None, 1.0, p50 <= 1.0),
        _row("overhead p99", p99, None, None, 3.0, p99 <= 3.0),
        _row("overhead, median of pairs", statistics.median(overheads), None, None, 1.0, None),
        _row(
            "killed finder noticed, median",
            statistics.median(waits),
            None,
            None,
            150.0,
            statistics.median(waits) <= 150,
        ),
        _row("killed finder noticed, worst", max(waits), None, None, 150.0, max(waits) <= 150),
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


def _p99(values: list[float]) -> float:
    return sorted(values)[int(0.99 * (len(values) - 1))]


def _row(
    name: str, value: float, peer: str | None, peer_value: float | None, target: float | None, holds: bool | None
) -> dict[str, Any]:
    ratio = None if peer_value is None else value / peer_value
    return {
        "name": name,
        "value": value,
        "unit": "ms",
        "peer": peer,
        "peer_value": peer_value,
        "ratio": ratio,
        "target": target,
        "holds": holds,
    }


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
