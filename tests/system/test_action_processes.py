"""The action between real processes: kills, restarts, cut links, many clients, and what it costs."""

from __future__ import annotations

import os
import random
import signal
import socket
import statistics
import subprocess
import sys
import threading
import time
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from zsight.action.client import GoalCall
from zsight.bus import Bus
from zsight.bus.zenoh_link import open_link
from zsight.client import CellClient
from zsight.errors import ConnectionLost, DeadlinePassed, NobodyAnswers, ServerLost
from zsight.network import Network
from zsight_protocol.action import ENDED, CancelCode, GoalState, Update, new_goal_id
from zsight_protocol.find_object import FindObjectGoal, FindObjectResult, ResultCode

if TYPE_CHECKING:
    from collections.abc import Iterator

pytestmark = pytest.mark.system

SCHEDULES = int(os.environ.get("ZSIGHT_PROCESS_SCHEDULES", "200"))
SCRIPT = Path(__file__).with_name("echo_server.py")
SOON = 20.0


class Process:
    """One process of the cell: started, killed, started again."""

    def __init__(self, *arguments: str) -> None:
        self._arguments = arguments
        self.start()

    def start(self) -> None:
        self.process = subprocess.Popen(
            [sys.executable, str(SCRIPT), *self._arguments], stdin=subprocess.PIPE, stdout=subprocess.PIPE
        )
        assert self.process.stdout is not None
        assert self.process.stdout.readline() == b"ready\n"

    def kill(self) -> None:
        self.process.kill()
        self.close()

    def close(self) -> None:
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self.process.stdin.close()
        self.process.wait(SOON)
        self.process.stdout.close()


@pytest.fixture
def endpoint() -> str:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


@pytest.fixture
def router(endpoint: str) -> Iterator[Process]:
    process = Process("router", endpoint)
    yield process
    process.close()


@pytest.fixture
def client(endpoint: str, router: Process) -> Iterator[CellClient]:
    del router
    with CellClient(Bus(open_link(Network().on(endpoint)))) as cell:
        yield cell


def send(cell: CellClient, milliseconds: int, timeout: float = SOON) -> GoalCall[FindObjectResult]:
    return cell.start_find("anything", finder="finder", known_height=milliseconds / 1e3, timeout=timeout)


def outcome(call: GoalCall[FindObjectResult]) -> str:
    updates: list[Update[FindObjectResult]] = []
    try:
        updates.extend(call)
    except (NobodyAnswers, ServerLost) as error:
        return type(error).__name__
    last = updates[-1]
    assert all(update.goal_id == call.goal_id for update in updates)
    assert [update.final for update in updates] == [False] * (len(updates) - 1) + [True]
    assert last.state in ENDED
    assert last.result is not None
    assert last.result.message == call.goal_id
    assert (last.result.code is ResultCode.FOUND) == (last.state is GoalState.SUCCEEDED)
    return last.state.name


@contextmanager
def kill(server: Process, router: Process) -> Iterator[None]:
    del router
    server.kill()
    yield
    server.start()


@contextmanager
def stop(server: Process, router: Process) -> Iterator[None]:
    """It stands still for less time than a link is given up after."""
    del router
    server.process.send_signal(signal.SIGSTOP)
    go_on = threading.Timer(0.2, server.process.send_signal, [signal.SIGCONT])
    go_on.start()
    yield
    go_on.join()


@contextmanager
def cut(server: Process, router: Process) -> Iterator[None]:
    """No way leads from anybody to anybody."""
    del server
    router.kill()
    yield
    router.start()


@contextmanager
def nothing(server: Process, router: Process) -> Iterator[None]:
    del server, router
    yield


def test_every_goal_ends_once_whatever_happens(client: CellClient, endpoint: str, router: Process) -> None:
    draw = random.Random(1)
    server = Process("server", endpoint, "2", "2")
    seen: set[str] = set()
    try:
        for _ in range(SCHEDULES):
            calls = [
                send(client, draw.choice([1, 5, 30]), draw.choice([0.004, SOON])) for _ in range(draw.randint(1, 6))
            ]
            if draw.random() < 0.4:
                with suppress(NobodyAnswers, ConnectionLost):  # the links of a new router come back by themselves
                    response = client.cancel(draw.choice(calls).goal_id, finder="finder")
                    assert response.code in (CancelCode.NONE, CancelCode.ALREADY_ENDED, CancelCode.UNKNOWN_GOAL)
            trouble = draw.choices([kill, stop, cut, nothing], [10, 10, 2, 78])[0]
            with trouble(server, router):
                seen |= {outcome(call) for call in calls}
    finally:
        server.close()
    if SCHEDULES >= 200:
        assert seen >= {"SUCCEEDED", "CANCELLED", "ABORTED", "REJECTED", "ServerLost"}


def test_a_killed_server_is_noticed_at_once(client: CellClient, endpoint: str) -> None:
    waits = []
    for _ in range(5):
        server = Process("server", endpoint, "1", "1")
        call = send(client, 60_000)
        assert next(iter(call)).state in (GoalState.ACCEPTED, GoalState.EXECUTING)
        killed = time.monotonic()
        server.kill()
        with pytest.raises(ServerLost, match="went away"):
            call.wait()
        waits.append(time.monotonic() - killed)
    assert statistics.median(waits) < 0.15, waits


def test_a_router_that_dies_and_comes_back_is_lived_through(client: CellClient, endpoint: str, router: Process) -> None:
    server = Process("server", endpoint, "1", "1")
    try:
        call = send(client, 60_000)
        assert next(iter(call)).state in (GoalState.ACCEPTED, GoalState.EXECUTING)
        router.kill()
        killed = time.monotonic()
        with pytest.raises(ServerLost):
            call.wait()
        assert time.monotonic() - killed < 2.0
        router.start()
        deadline = time.monotonic() + SOON
        while (found := _try(client)) != "SUCCEEDED":  # links and declarations come back by themselves
            assert time.monotonic() < deadline, found
    finally:
        server.close()


def _try(client: CellClient) -> str:
    try:
        client.cancel(finder="finder")  # of the goal whose client was cut off
        return outcome(send(client, 1, 1.0))
    except (NobodyAnswers, DeadlinePassed, ConnectionLost) as error:
        return str(error)


def test_a_thousand_goals_of_twenty_clients_all_end(endpoint: str, router: Process) -> None:
    del router
    server = Process("server", endpoint, "4", "1000")
    ended: dict[int, list[str]] = {number: [] for number in range(20)}

    def ask(number: int) -> None:
        with CellClient(Bus(open_link(Network().on(endpoint)))) as cell:
            calls = [send(cell, 1, 60.0) for _ in range(50)]
            ended[number] = [outcome(call) for call in calls]

    threads = [threading.Thread(target=ask, args=(number,)) for number in ended]
    try:
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join(90)
    finally:
        server.close()
    assert {number: len(states) for number, states in ended.items()} == dict.fromkeys(ended, 50)
    assert {state for states in ended.values() for state in states} == {"SUCCEEDED"}


def test_the_same_goal_twice_runs_once_and_is_answered_twice(client: CellClient, endpoint: str) -> None:
    server = Process("server", endpoint, "1", "1")
    try:
        goal = FindObjectGoal(goal_id=new_goal_id(), object_type="anything", known_height=0.02, timeout=SOON)
        keys = (client.bus.cell.find_object("finder"), client.bus.cell.cancel("finder"))
        calls = [GoalCall(client.bus, keys, goal, goal.goal_id, FindObjectResult, SOON) for _ in range(2)]
        assert [outcome(call) for call in calls] == ["SUCCEEDED", "SUCCEEDED"]
        assert [update.goal_id for update in client.results(finder="finder")] == [goal.goal_id]
    finally:
        server.close()
