"""The life of a goal, step by step: what client, server and watchers see of it."""

from __future__ import annotations

import logging
import threading
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING

import pytest
from tests.services.gated_work import Gated
from tests.services.waiting import DEADLINE, Arrivals, soon

from zsight.action import server as action_server
from zsight.action import status_board
from zsight.action.client import GoalCall, cancel
from zsight.action.server import ActionServer, Policy
from zsight.client import CellClient
from zsight.errors import DeadlinePassed, NobodyAnswers, RequestRefused, ServerLost, UsageError
from zsight.finder import Settings
from zsight_protocol.action import (
    CancelCode,
    CancelRequest,
    GoalState,
    GoalStatusList,
    ResultRequest,
    Update,
    UpdateList,
    new_goal_id,
)
from zsight_protocol.codec import decode, encode
from zsight_protocol.find_object import FindObjectGoal, FindObjectResult

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from zsight.action.server import HasPolicy
    from zsight.bus import Bus, RawRequest, Reader

    Join = Callable[[], Bus]


class Bench:
    """One server and its clients."""

    def __init__(self, join: Join, policy: HasPolicy) -> None:
        self.work = Gated()
        self.server_bus, self.client, self.watcher = join(), join(), join()
        self.feedback: Arrivals[Update[FindObjectResult]] = Arrivals()
        reader = self.watcher.reader(self.watcher.cell.feedback("finder"), Update[FindObjectResult])
        threading.Thread(target=self._watch, args=(reader,), daemon=True).start()
        self.server = ActionServer(self.server_bus, "finder", FindObjectGoal, self.work, policy)

    def _watch(self, reader: Reader[Update[FindObjectResult]]) -> None:
        for update in reader:
            self.feedback.add(update)

    def send(
        self, goal_id: str | None = None, object_type: str = "cube", timeout: float = DEADLINE
    ) -> GoalCall[FindObjectResult]:
        goal = FindObjectGoal(goal_id=goal_id or new_goal_id(), object_type=object_type, timeout=timeout)
        cell = self.client.cell
        keys = (cell.find_object("finder"), cell.cancel("finder"))
        return GoalCall(self.client, keys, goal, goal.goal_id, FindObjectResult, timeout)

    def executing(self) -> GoalCall[FindObjectResult]:
        """A goal that is being worked on."""
        call = self.send()
        assert any(update.stage == "waiting" for update in call)
        return call

    def close(self) -> None:
        self.work.gate.set()
        self.server.close()


@pytest.fixture
def bench(join_memory: Join) -> Iterator[Bench]:
    """One goal at a time, two may wait."""
    bench = Bench(join_memory, Policy(parallel=1, queue=2))
    yield bench
    bench.close()


def words(update: Update[FindObjectResult]) -> tuple[GoalState, str]:
    assert update.final
    assert update.result is not None
    return update.state, update.result.message


# Ends.


def test_how_many_may_wait_is_read_anew_for_every_goal(join_memory: Join) -> None:
    settings = Settings(queue=0)
    bench = Bench(join_memory, settings)
    bench.executing()
    assert words(bench.send().wait()) == (GoalState.REJECTED, "busy")
    settings.queue = 1
    waits = bench.send()
    bench.work.gate.set()
    assert waits.wait().state is GoalState.SUCCEEDED
    bench.close()


def test_a_goal_is_accepted_executed_and_answered(bench: Bench) -> None:
    call = bench.send()
    updates = iter(call)
    assert next(updates).state is GoalState.ACCEPTED
    bench.work.gate.set()
    rest = list(updates)
    assert {update.state for update in rest[:-1]} <= {GoalState.ACCEPTED, GoalState.EXECUTING}
    assert words(rest[-1]) == (GoalState.SUCCEEDED, "done")
    assert rest[-1].server == "finder"


def test_what_can_wait_is_done_while_no_goal_is_at_work(bench: Bench) -> None:
    assert bench.server.rest(0)
    bench.executing()
    waits = bench.send()
    assert not bench.server.rest(0)
    bench.work.gate.set()
    waits.wait()
    assert bench.server.rest(DEADLINE)


def test_watchers_see_each_goal_end_once_and_nothing_after(bench: Bench) -> None:
    bench.work.gate.set()
    ids = []
    for _ in range(60):
        call = bench.send()
        call.wait()
        ids.append(call.goal_id)
    assert soon(lambda: sum(update.final for update in bench.feedback.all) >= len(ids))
    for goal_id in ids:
        finals = [update.final for update in bench.feedback.all if update.goal_id == goal_id]
        assert finals == [False] * (len(finals) - 1) + [True]


def test_an_unknown_type_is_rejected_and_never_begins(bench: Bench) -> None:
    assert words(bench.send(object_type="unknown").wait()) == (GoalState.REJECTED, "no")
    assert bench.work.runs == []


def test_expected_failures_are_answered_and_logged_in_one_line(bench: Bench, caplog: pytest.LogCaptureFixture) -> None:
    bench.work.error = UsageError("no such frame")
    with caplog.at_level(logging.WARNING):
        assert words(bench.send().wait()) == (GoalState.ABORTED, "no such frame")
    (record,) = caplog.records
    assert record.exc_info is None
    assert "no such frame" in record.getMessage()


def test_a_bug_is_answered_logged_and_survived(bench: Bench, caplog: pytest.LogCaptureFixture) -> None:
    bench.work.error = ZeroDivisionError("division by zero")
    assert words(bench.send().wait()) == (GoalState.ABORTED, "division by zero")
    assert caplog.records[-1].exc_info is not None
    bench.work.error = None
    bench.work.gate.set()
    assert words(bench.send().wait()) == (GoalState.SUCCEEDED, "done")


def test_bad_bytes_are_refused_with_the_reason(bench: Bench) -> None:
    replies = bench.client.ask(bench.client.cell.find_object("finder"), b"\xc1", DEADLINE)
    with pytest.raises(RequestRefused, match="not a FindObjectGoal"):
        replies.take(DEADLINE)


class NotedLock:
    """A lock that tells which threads asked for it."""

    def __init__(self) -> None:
        self.askers: set[int] = set()
        self._lock = threading.Lock()

    def __enter__(self) -> None:
        self.askers.add(threading.get_ident())
        self._lock.acquire()

    def __exit__(self, *_: object) -> None:
        self._lock.release()


def test_all_who_wait_for_an_answer_get_it(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    call, lock = bench.executing(), NotedLock()
    monkeypatch.setattr(call, "_lock", lock)
    with ThreadPoolExecutor() as threads:
        waiting = [threads.submit(call.wait) for _ in range(4)]
        assert soon(lambda: len(lock.askers) == 4)
        bench.work.gate.set()
        assert {words(each.result()) for each in waiting} == {(GoalState.SUCCEEDED, "done")}


# Cancelling.


def test_cancel_while_it_is_worked_on(bench: Bench) -> None:
    call = bench.executing()
    response = call.cancel()
    assert (response.code, response.goals) == (CancelCode.NONE, (call.goal_id,))
    assert words(call.wait()) == (GoalState.CANCELLED, "stopped")


def test_cancel_while_it_waits_ends_it_at_once(bench: Bench) -> None:
    working, waiting = bench.executing(), bench.send()
    assert waiting.cancel().code is CancelCode.NONE
    assert words(waiting.wait()) == (GoalState.CANCELLED, "stopped")
    bench.work.gate.set()
    assert words(working.wait()) == (GoalState.SUCCEEDED, "done")
    assert bench.work.runs == [working.goal_id]


def test_cancel_after_its_end(bench: Bench) -> None:
    bench.work.gate.set()
    call = bench.send()
    call.wait()
    assert call.cancel().code is CancelCode.ALREADY_ENDED


def test_cancel_of_a_goal_that_nobody_sent(bench: Bench) -> None:
    key = bench.client.cell.cancel("finder")
    assert cancel(bench.client, key, new_goal_id()).code is CancelCode.UNKNOWN_GOAL
    with pytest.raises(NobodyAnswers, match="is the service running"):
        cancel(bench.client, bench.client.cell.cancel("elsewhere"), None)


def test_cancel_all(bench: Bench) -> None:
    calls = [bench.executing(), bench.send(), bench.send()]
    response = cancel(bench.client, bench.client.cell.cancel("finder"), None)
    assert set(response.goals) == {call.goal_id for call in calls}
    assert {words(call.wait()) for call in calls} == {(GoalState.CANCELLED, "stopped")}
    assert cancel(bench.client, bench.client.cell.cancel("finder"), None).goals == ()


def test_a_bad_cancel_is_rejected(bench: Bench) -> None:
    replies = bench.client.ask(bench.client.cell.cancel("finder"), b"\xc1", DEADLINE)
    reply = replies.take(DEADLINE)
    assert reply is not None
    assert b"\xa4code\x01" in reply


class Gone:
    """A request of a client that has gone."""

    key = "test/find_object/finder/cancel"
    payload = encode(CancelRequest())

    def __init__(self) -> None:
        self.closed = False

    def reply(self, payload: bytes) -> None:
        raise ConnectionError(f"nobody reads {len(payload)} bytes")

    def refuse(self, words: str) -> None:
        raise ConnectionError(words)

    def close(self) -> None:
        self.closed = True


def test_a_cancel_whose_client_has_gone_is_closed_and_done(bench: Bench) -> None:
    call, request = bench.executing(), Gone()
    bench.server._cancel_asked(request)
    assert request.closed
    assert words(call.wait()) == (GoalState.CANCELLED, "stopped")


# Room and time.


def test_no_room_is_said_at_once_and_a_cancel_makes_some(bench: Bench) -> None:
    bench.executing()
    waiting = [bench.send(), bench.send()]
    assert words(bench.send().wait()) == (GoalState.REJECTED, "busy")
    waiting[0].cancel()
    waiting[0].wait()
    late = bench.send()
    assert next(iter(late)).state is GoalState.ACCEPTED


def test_several_goals_at_once(join_memory: Join) -> None:
    bench = Bench(join_memory, Policy(parallel=3, queue=0))
    calls = [bench.executing() for _ in range(3)]
    assert words(bench.send().wait()) == (GoalState.REJECTED, "busy")
    bench.work.gate.set()
    assert {words(call.wait()) for call in calls} == {(GoalState.SUCCEEDED, "done")}
    bench.close()


def test_the_deadline_stops_the_work(bench: Bench) -> None:
    assert words(bench.send(timeout=0.05).wait()) == (GoalState.ABORTED, "deadline")


def test_a_goal_that_waits_past_its_deadline_never_begins(bench: Bench) -> None:
    working, waiting = bench.executing(), bench.send(timeout=0.01)
    assert words(waiting.wait()) == (GoalState.ABORTED, "deadline")
    late = bench.send()  # it made room
    bench.work.gate.set()
    assert {words(call.wait()) for call in (working, late)} == {(GoalState.SUCCEEDED, "done")}
    assert bench.work.runs == [working.goal_id, late.goal_id]


def test_goals_that_wait_end_each_at_its_own_deadline(bench: Bench) -> None:
    bench.executing()
    patient, hasty = bench.send(timeout=DEADLINE), bench.send(timeout=0.02)
    assert words(hasty.wait()) == (GoalState.ABORTED, "deadline")
    bench.work.gate.set()
    assert words(patient.wait()) == (GoalState.SUCCEEDED, "done")


def test_a_server_that_says_nothing_is_not_waited_for_longer_than_asked(join_memory: Join) -> None:
    server, client = join_memory(), join_memory()
    kept: list[RawRequest] = []
    server.serve(server.cell.find_object("finder"), kept.append)
    goal = FindObjectGoal(goal_id=new_goal_id(), object_type="cube", timeout=0.01)
    keys = (client.cell.find_object("finder"), client.cell.cancel("finder"))
    with pytest.raises(DeadlinePassed, match=r"within 0\.01 s"):
        GoalCall(client, keys, goal, goal.goal_id, FindObjectResult, 0.01).wait()


# The same goal again.


def test_the_same_goal_runs_once_and_is_answered_twice(bench: Bench) -> None:
    first = bench.executing()
    second = bench.send(first.goal_id)
    bench.work.gate.set()
    assert words(first.wait()) == words(second.wait()) == (GoalState.SUCCEEDED, "done")
    assert words(bench.send(first.goal_id).wait()) == (GoalState.SUCCEEDED, "done")
    assert bench.work.runs == [first.goal_id]


def test_results_are_kept(bench: Bench) -> None:
    running = bench.executing()
    key, kind = bench.client.cell.result("finder"), UpdateList[FindObjectResult]

    def kept(goal_id: str | None) -> list[GoalState]:
        reply = bench.client.ask(key, encode(ResultRequest(goal_id=goal_id)), DEADLINE).take(DEADLINE)
        assert reply is not None
        return [update.state for update in decode(kind, reply).updates]

    assert kept(running.goal_id) == [GoalState.EXECUTING]
    bench.work.gate.set()
    running.wait()
    assert kept(running.goal_id) == kept(None) == [GoalState.SUCCEEDED]
    assert kept(new_goal_id()) == []


def test_only_so_many_results_are_kept(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(action_server, "_MOST_KEPT", 70)
    bench.work.gate.set()
    ids = []
    for _ in range(80):
        call = bench.send()
        call.wait()
        ids.append(call.goal_id)
    kept = [update.goal_id for update in CellClient(bench.client).results()]
    assert len(kept) in (70, 71)  # the oldest goes when the next goal comes
    assert kept == ids[-len(kept) :]


def test_results_are_forgotten_after_a_while(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(action_server, "_KEEP", 0.0)
    bench.work.gate.set()
    bench.send().wait()
    assert soon(lambda: CellClient(bench.client).results() == [])


def test_a_late_watcher_sees_who_is_at_work(bench: Bench) -> None:
    call = bench.executing()
    reader = bench.watcher.reader(bench.watcher.cell.status("finder"), GoalStatusList)
    expected = [(call.goal_id, GoalState.EXECUTING)]
    lists: list[list[tuple[str, GoalState]]] = []
    while expected not in lists and (received := reader.take(DEADLINE)) is not None:
        lists.append([(goal.goal_id, goal.state) for goal in received.message.goals])
    assert expected in lists


# Servers that go.


def test_the_last_list_of_a_server_tells_how_its_goals_ended(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(status_board, "_PAUSE", DEADLINE)  # the server goes before the next list is due
    call = bench.executing()
    bench.work.gate.set()
    call.wait()
    bench.server.close()
    reader = bench.watcher.reader(bench.watcher.cell.status("finder"), GoalStatusList)
    received = reader.take(DEADLINE)
    assert received is not None
    assert [(goal.goal_id, goal.state) for goal in received.message.goals] == [(call.goal_id, GoalState.SUCCEEDED)]


def test_a_server_that_closes_answers_what_it_has(bench: Bench) -> None:
    calls = [bench.executing(), bench.send()]
    bench.server.close()
    assert {words(call.wait())[0] for call in calls} <= {GoalState.ABORTED, GoalState.CANCELLED}
    with pytest.raises(NobodyAnswers):
        bench.send().wait()


def test_a_lost_server_is_told_from_a_missing_one(bench: Bench) -> None:
    call = bench.executing()
    bench.server_bus.link.close()
    with pytest.raises(ServerLost, match=call.goal_id):
        call.wait()
    with pytest.raises(NobodyAnswers, match="is the service running"):
        bench.send().wait()


def test_an_answer_that_is_none(join_memory: Join) -> None:
    server, client = join_memory(), join_memory()

    def babble(request: RawRequest) -> None:
        request.reply(b"\xc1")
        request.close()

    server.serve(server.cell.find_object("finder"), babble)
    with pytest.raises(ServerLost, match="something else than an update"):
        CellClient(client).find("cube", finder="finder")
