"""Whatever happens in whatever order, every goal ends exactly once, legally, and with its own answer."""

from __future__ import annotations

import contextlib
import itertools
import os
import random
import threading
import time
from dataclasses import dataclass, field

import pytest

from zsight.action.client import GoalCall, cancel
from zsight.action.server import ActionServer, GoalHandle, Policy
from zsight.bus import Bus, replies
from zsight.bus.memory_link import MemoryLink, MemoryNetwork
from zsight.errors import ConnectionLost, NobodyAnswers, ServerLost
from zsight_protocol.action import ENDED, LEGAL_MOVES, CancelCode, GoalState, Update, new_goal_id
from zsight_protocol.find_object import FindObjectGoal, FindObjectResult, ResultCode, Status
from zsight_protocol.message import Header

SCHEDULES = int(os.environ.get("ZSIGHT_SCHEDULES", "10000"))
PORTIONS = 20
ENOUGH = 20.0  # seconds in which a goal must have ended


class Echo:
    """Work that answers with the goal's own id after some steps, or waits for a gate at each of them."""

    def __init__(self) -> None:
        self.gate = threading.Event()

    def refuse(self, goal: FindObjectGoal) -> FindObjectResult | None:
        return result(goal.goal_id, ResultCode.CODE_NOT_RECOGNISED) if goal.object_type == "unknown" else None

    def busy(self, goal: FindObjectGoal) -> FindObjectResult:
        return result(goal.goal_id, ResultCode.BUSY)

    def execute(self, handle: GoalHandle[FindObjectGoal, FindObjectResult]) -> FindObjectResult:
        if handle.goal.object_type == "broken":
            raise ValueError("broken")
        for step in range(handle.goal.maximum):
            handle.checkpoint(f"step {step}", step / handle.goal.maximum)
            while handle.goal.object_type == "gated" and not self.gate.wait(0.0005):
                handle.checkpoint(f"step {step}", step / handle.goal.maximum)
        return result(handle.goal_id, ResultCode.FOUND)

    def stopped(self, handle: GoalHandle[FindObjectGoal, FindObjectResult]) -> FindObjectResult:
        code = ResultCode.NOT_FOUND if handle.deadline_passed else ResultCode.CANCELLED
        return result(handle.goal_id, code)

    def failed(self, goal: FindObjectGoal, error: Exception) -> FindObjectResult:
        del error
        return result(goal.goal_id, ResultCode.NOT_FOUND)


def result(goal_id: str, code: ResultCode) -> FindObjectResult:
    return FindObjectResult(header=Header(), code=code, status=Status.CANNOT_TELL, message=goal_id)


@dataclass
class Cell:
    """A client and a server that is killed and started again."""

    network: MemoryNetwork = field(default_factory=MemoryNetwork)
    work: Echo = field(default_factory=Echo)
    policy: Policy = field(default_factory=Policy)
    servers: list[ActionServer[FindObjectGoal, FindObjectResult]] = field(default_factory=list)
    calls: list[tuple[str, GoalCall[FindObjectResult]]] = field(default_factory=list)
    cancelled: set[str] = field(default_factory=set)
    server_bus: Bus | None = None

    def __post_init__(self) -> None:
        self.link = MemoryLink(self.network)
        self.client = Bus(self.link)

    def start(self) -> None:
        if self.server_bus is None:
            self.server_bus = Bus(MemoryLink(self.network))
            self.servers.append(ActionServer(self.server_bus, "finder", FindObjectGoal, self.work, self.policy))

    def kill(self) -> None:
        """Gone from one moment to the next: nothing more of it is heard, whatever its threads still do."""
        if self.server_bus is not None:
            self.server_bus.close()
            self.server_bus = None

    def send(self, object_type: str, steps: int, timeout: float, goal_id: str | None = None) -> None:
        goal = FindObjectGoal(goal_id=goal_id or new_goal_id(), object_type=object_type, maximum=steps, timeout=timeout)
        keys = (self.client.cell.find_object("finder"), self.client.cell.cancel("finder"))
        call = GoalCall(self.client, keys, goal, goal.goal_id, FindObjectResult, ENOUGH)
        self.calls.append((goal.goal_id, call))

    def cancel(self, goal_id: str | None) -> None:
        try:
            response = cancel(self.client, self.client.cell.cancel("finder"), goal_id)
        except NobodyAnswers:
            return
        if response.code is CancelCode.NONE:
            self.cancelled.update(response.goals)

    def close(self) -> None:
        self.work.gate.set()
        self.kill()
        for server in self.servers:
            server.close()
        self.client.close()


def play(cell: Cell, draw: random.Random) -> None:
    """Some steps of a schedule."""
    for _ in range(draw.randint(3, 10)):
        match draw.choice(
            [*["goal"] * 6, *["again", "cancel", "cancel all", "kill", "start", "open", "let run"] * 2, "cut"]
        ):
            case "goal":
                kind = draw.choice(["plain", "plain", "gated", "unknown", "broken"])
                cell.send(kind, draw.randint(1, 4), draw.choice([0.001, 0.003, ENOUGH]))
            case "again" if cell.calls:
                cell.send("plain", 1, ENOUGH, draw.choice(cell.calls)[0])
            case "cancel":
                known = [goal_id for goal_id, _ in cell.calls] or [new_goal_id()]
                cell.cancel(draw.choice([*known, new_goal_id()]))
            case "cancel all":
                cell.cancel(None)
            case "kill":
                cell.kill()
            case "start":
                cell.start()
            case "open":
                cell.work.gate.set()
            case "cut":
                cell.link.cut()
            case "let run":
                time.sleep(0)  # gives the other threads a turn


def outcome(goal_id: str, call: GoalCall[FindObjectResult], cancelled: set[str]) -> str:
    """How a goal ended, after all that must hold of its stream was checked."""
    updates: list[Update[FindObjectResult]] = []
    try:
        updates.extend(call)
    except (NobodyAnswers, ServerLost) as error:
        assert not any(update.final for update in updates)
        return type(error).__name__
    assert [update.goal_id for update in updates] == [goal_id] * len(updates)
    assert [update.final for update in updates] == [False] * (len(updates) - 1) + [True]
    last = updates[-1]
    assert last.state in ENDED
    assert last.result is not None
    assert last.result.message == goal_id
    if goal_id in cancelled:
        assert last.state in (GoalState.CANCELLED, GoalState.REJECTED)
    assert (last.result.code is ResultCode.FOUND) == (last.state is GoalState.SUCCEEDED)
    require_end(call)
    require_legal([update.state for update in updates])
    return last.state.name


def require_end(call: GoalCall[FindObjectResult]) -> None:
    """That nothing follows the final update."""
    with contextlib.suppress(ConnectionLost):
        assert call._replies.take(0.5) is None


def require_legal(states: list[GoalState]) -> None:
    """That each state can be reached from the one before it; a reader may miss states between two updates."""
    for before, after in itertools.pairwise(states):
        reached, edge = {before}, {before}
        while edge:
            edge = {target for state in edge for target in LEGAL_MOVES[state]} - reached
            reached |= edge
        assert after in reached, f"{before.name} then {after.name}"


@pytest.mark.parametrize("portion", range(PORTIONS))
def test_every_goal_ends_once_with_its_own_answer(portion: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(replies, "_LOOK", 0.002)  # or each goal of a cut link would take a twentieth of a second
    before = set(threading.enumerate())
    seen: set[str] = set()
    for number in range(portion, SCHEDULES, PORTIONS):
        draw = random.Random(number)
        cell = Cell(policy=Policy(parallel=draw.randint(1, 3), queue=draw.randint(0, 3)))
        cell.start()
        try:
            play(cell, draw)
            cell.work.gate.set()
            for goal_id, call in cell.calls:
                seen.add(outcome(goal_id, call, set() if _was_killed(cell) else cell.cancelled))
        except BaseException as error:
            error.add_note(f"schedule {number}")
            raise
        finally:
            cell.close()
    assert set(threading.enumerate()) <= before
    if SCHEDULES >= 2000:
        assert seen >= {"SUCCEEDED", "CANCELLED", "ABORTED", "REJECTED", "ServerLost", "NobodyAnswers"}


def _was_killed(cell: Cell) -> bool:
    """A goal id that was sent again to a second server may be cancelled at one and succeed at the other."""
    return len(cell.servers) > 1
