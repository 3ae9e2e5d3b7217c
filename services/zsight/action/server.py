"""The server half of an action: goals in, updates out, each goal ended exactly once.

Goals run on worker threads while new ones arrive; what finds neither a free worker nor room in the queue is refused as
busy at once. A result is kept for a while, so that the same goal asked again is answered and not run again.
"""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Generic, Protocol, TypeVar

from zsight.action.status_board import StatusBoard
from zsight.bus.request_queue import RequestQueue
from zsight.errors import ConnectionLost, ZsightError
from zsight_core.errors import Cancelled, CoreError
from zsight_protocol.action import (
    ENDED,
    CancelCode,
    CancelRequest,
    CancelResponse,
    GoalState,
    GoalStatus,
    GoalStatusList,
    ResultRequest,
    Update,
    UpdateList,
    move,
)
from zsight_protocol.channels import ANY_FINDER
from zsight_protocol.codec import decode, encode
from zsight_protocol.errors import ProtocolError
from zsight_protocol.message import Message, Time

if TYPE_CHECKING:
    from collections.abc import Callable

    from pydantic import JsonValue

    from zsight.bus import Bus, RawRequest

__all__ = ["ActionServer", "GoalHandle", "Policy", "Work"]

log = logging.getLogger(__name__)

_KEEP = 60.0  # seconds that an ended goal's result is kept
_MOST_KEPT = 1000  # ended goals; a client that sends them without end must not fill the memory
_A_LIST = 32  # updates in one reply to who asks for results, so that others get a word in between
_LISTED = 64  # goals in the list for watchers
_FEEDBACK_EVERY = 0.02  # seconds between two feedback messages of one stage


class GoalMessage(Protocol):
    """What the server needs to know of a goal."""

    @property
    def goal_id(self) -> str:
        """UUID made by the client."""

    @property
    def timeout(self) -> float:
        """Seconds from its arrival."""


Goal = TypeVar("Goal", bound=Message)
Result = TypeVar("Result", bound=Message)


@dataclass(frozen=True)
class Policy:
    """How many goals run at once, and how many may wait."""

    parallel: int = 1
    queue: int = 16


class HasPolicy(Protocol):
    """A policy, or settings with the same names: how many may wait is read anew for every goal."""

    @property
    def parallel(self) -> int: ...

    @property
    def queue(self) -> int: ...


class Work(Protocol[Goal, Result]):
    """What an action does; one instance serves all goals, from several threads."""

    def refuse(self, goal: Goal) -> Result | None:
        """The answer to a goal that must not even begin, or none; quick."""
        ...

    def busy(self, goal: Goal) -> Result:
        """The answer to a goal that there is no room for."""
        ...

    def execute(self, handle: GoalHandle[Goal, Result]) -> Result:
        """Do it; call handle.checkpoint often.

        Raises:
            Cancelled: passed on from the checkpoint.
        """
        ...

    def stopped(self, handle: GoalHandle[Goal, Result]) -> Result:
        """The answer to a goal that was cancelled, or whose deadline has passed: see handle.deadline_passed."""
        ...

    def failed(self, goal: Goal, error: Exception) -> Result:
        """The answer to a goal that met an error."""
        ...


@dataclass(eq=False)
class GoalHandle(Generic[Goal, Result]):
    """A goal on the server.

    ``notes`` and ``known`` are what is known so far, for an answer that must be given early.
    """

    goal: Goal
    goal_id: str
    deadline: float
    state: GoalState = GoalState.ACCEPTED
    accepted: Time = field(default_factory=Time.now)
    started: float = field(default_factory=time.monotonic)
    ended: float | None = None
    stage: str = ""
    fraction: float = 0.0
    notes: dict[str, JsonValue] = field(default_factory=dict)
    known: Result | None = None
    result: Result | None = None
    deadline_passed: bool = False
    requests: list[RawRequest] = field(default_factory=list)
    report: Callable[[GoalHandle[Goal, Result]], None] = lambda _: None
    last_report: float = 0.0
    stopping: threading.Event = field(default_factory=threading.Event)
    voice: threading.Lock = field(
        default_factory=threading.Lock
    )  # held while an update is told: none overtakes another

    def checkpoint(self, stage: str, fraction: float) -> None:
        """Report where the work stands.

        Raises:
            Cancelled: the goal was cancelled, its deadline has passed, or the server is stopping.
        """
        now = time.monotonic()
        if now >= self.deadline:
            self.deadline_passed = True
        if self.state is GoalState.CANCELLING or self.deadline_passed or self.stopping.is_set():
            raise Cancelled(f"goal {self.goal_id} stopped at {stage}")
        new_stage = stage != self.stage
        self.stage, self.fraction = stage, min(max(fraction, 0.0), 1.0)
        if new_stage or now - self.last_report >= _FEEDBACK_EVERY:
            self.last_report = now
            self.report(self)

    def seconds_left(self) -> float:
        """Until the deadline."""
        return max(self.deadline - time.monotonic(), 0.0)


class ActionServer(Generic[Goal, Result]):
    """Serves one action on the bus until it is closed."""

    def __init__(self, bus: Bus, name: str, goal: type[Goal], work: Work[Goal, Result], policy: HasPolicy) -> None:
        """Args: bus; name of this server in the keys; kind of its goals; what it does; how many at once."""
        self._name = name
        self._goal = goal
        self._work = work
        self._policy = policy
        self._goals: dict[str, GoalHandle[Goal, Result]] = {}
        self._waiting: deque[GoalHandle[Goal, Result]] = deque()
        self._ended: deque[tuple[float, str]] = deque()  # when, and which goal; the first that ended comes first
        self._curious = RequestQueue("results")
        self._running = 0
        self._changed = threading.Condition()
        self._closed = threading.Event()
        self._status = StatusBoard(bus.writer(bus.cell.status(name), GoalStatusList), self._present)
        self._feedback = bus.writer(bus.cell.feedback(name), Update[Message])
        self._taken = bus.writer(bus.cell.goal(name), goal)
        self._workers = [
            threading.Thread(target=self._run_goals, name=f"worker-{number}", daemon=True)
            for number in range(policy.parallel)
        ]
        self._threads = [
            *self._workers,
            threading.Thread(target=self._end_late_goals, name="deadlines", daemon=True),
        ]
        for thread in self._threads:
            thread.start()
        self._servers = [
            bus.serve(bus.cell.cancel(name), self._cancel_asked),
            bus.serve(bus.cell.result(name), lambda request: self._curious.put(request, self._tell_results)),
            bus.serve(bus.cell.find_object(name), self._goal_asked),
            bus.serve(bus.cell.find_object(ANY_FINDER), self._goal_asked),
        ]

    def close(self) -> None:
        """Take no more goals, stop those that run, and wait until their clients were told."""
        for server in self._servers:
            server.close()
        with self._changed:
            self._closed.set()
            for handle in self._goals.values():
                handle.stopping.set()
            self._changed.notify_all()
        self._curious.close()
        for thread in self._threads:
            thread.join()
        self._status.close()

    def rest(self, patience: float) -> bool:
        """Wait up to patience seconds until no goal is at work or waits, which is true then: for work that can wait."""
        with self._changed:
            return self._changed.wait_for(lambda: not self._running and not self._waiting, patience)

    # A goal arrives: on the link's thread, so all of this is quick.

    def _goal_asked(self, request: RawRequest) -> None:
        try:
            goal = decode(self._goal, request.payload)
        except ProtocolError as error:
            log.warning("refused a goal: %s", error)
            request.refuse(str(error))
            return
        known = self._admit(goal, request)
        if known is not None:
            self._attach(known, request)

    def _admit(self, goal: Goal, request: RawRequest) -> GoalHandle[Goal, Result] | None:
        """Queue a new goal, or refuse it; the handle where the goal is known already."""
        goal_id: str = goal.goal_id  # type: ignore[attr-defined]  # GoalMessage cannot be intersected with Message
        timeout: float = goal.timeout  # type: ignore[attr-defined]  # as above
        refusal = self._work.refuse(goal)
        with self._changed:
            self._forget_old()
            if goal_id in self._goals:
                return self._goals[goal_id]
            full = self._running + len(self._waiting) >= self._policy.parallel + self._policy.queue
            if refusal is None and full:
                refusal = self._work.busy(goal)
            handle = GoalHandle[Goal, Result](goal, goal_id, time.monotonic() + timeout, report=self._tell)
            handle.requests.append(request)
            if refusal is not None:
                handle.state = GoalState.REJECTED
                handle.result = refusal
            else:
                self._goals[goal_id] = handle
                self._waiting.append(handle)
                self._changed.notify_all()
        self._publish_goal(goal)
        self._tell(handle)
        if handle.state is GoalState.REJECTED:
            request.close()
        return None

    def _attach(self, handle: GoalHandle[Goal, Result], request: RawRequest) -> None:
        with self._changed:
            running = handle.state not in ENDED
            if running:
                handle.requests.append(request)
        if not running:
            self._reply(request, encode(self._update(handle)))
            request.close()

    def _forget_old(self) -> None:
        now = time.monotonic()
        while self._ended and (len(self._ended) > _MOST_KEPT or now - self._ended[0][0] > _KEEP):
            del self._goals[self._ended.popleft()[1]]

    # A cancel arrives.

    def _cancel_asked(self, request: RawRequest) -> None:
        try:
            wanted = decode(CancelRequest, request.payload).goal_id
            response = self._cancel(wanted)
        except ProtocolError as error:
            log.warning("refused a cancel: %s", error)
            response = CancelResponse(code=CancelCode.REJECTED)
        self._reply(request, encode(response))
        request.close()

    def _cancel(self, wanted: str | None) -> CancelResponse:
        with self._changed:
            if wanted is not None and wanted not in self._goals:
                return CancelResponse(code=CancelCode.UNKNOWN_GOAL)
            meant = list(self._goals.values()) if wanted is None else [self._goals[wanted]]
            stopped = [handle for handle in meant if handle.state not in ENDED]
            for handle in stopped:
                if handle.state is not GoalState.CANCELLING:
                    handle.state = move(handle.state, GoalState.CANCELLING)
            if wanted is not None and not stopped:
                return CancelResponse(code=CancelCode.ALREADY_ENDED)
            # What no worker has begun ends here and makes room; the rest at its next checkpoint.
            never_begun = [handle for handle in stopped if handle in self._waiting]
            for handle in never_begun:
                self._waiting.remove(handle)
        for handle in stopped:
            self._tell(handle)
        for handle in never_begun:
            self._end(handle, self._work.stopped(handle), GoalState.CANCELLED)
        return CancelResponse(code=CancelCode.NONE, goals=tuple(handle.goal_id for handle in stopped))

    # Somebody asks for results that are kept: on a thread of its own, since they may be many.

    def _tell_results(self, request: RawRequest) -> None:
        try:
            wanted = decode(ResultRequest, request.payload).goal_id
        except ProtocolError as error:
            log.warning("refused a request for results: %s", error)
            request.refuse(str(error))
            return
        with self._changed:
            self._forget_old()
            updates = [self._update(h) for h in self._goals.values() if wanted in (None, h.goal_id)]
        for start in range(0, max(len(updates), 1), _A_LIST):
            self._reply(request, encode(UpdateList(updates=tuple(updates[start : start + _A_LIST]))))
        request.close()

    # Goals whose time is over before a worker is free.

    def _end_late_goals(self) -> None:
        while not self._closed.is_set():
            with self._changed:
                first = min((handle.deadline for handle in self._waiting), default=None)
                now = time.monotonic()
                if first is None or first > now:
                    self._changed.wait(None if first is None else first - now)
                    continue
                late = [handle for handle in self._waiting if handle.deadline <= now]
                for handle in late:
                    self._waiting.remove(handle)
                    handle.deadline_passed = True
            for handle in late:
                self._end(handle, self._work.stopped(handle), GoalState.ABORTED)

    # The workers.

    def _run_goals(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._waiting or self._closed.is_set())
                if not self._waiting:
                    return
                handle = self._waiting.popleft()
                self._running += 1
                if self._closed.is_set():
                    handle.stopping.set()
                if handle.state is GoalState.ACCEPTED:
                    handle.state = move(handle.state, GoalState.EXECUTING)
            result, state = self._execute(handle)
            with self._changed:
                self._running -= 1
                self._changed.notify_all()
            self._end(handle, result, state)

    def _execute(self, handle: GoalHandle[Goal, Result]) -> tuple[Result, GoalState]:
        try:
            handle.checkpoint("started", 0.0)
            return self._work.execute(handle), GoalState.SUCCEEDED
        except Cancelled:
            return self._work.stopped(handle), GoalState.ABORTED
        except (ZsightError, CoreError) as error:
            log.warning("goal %s failed: %s", handle.goal_id, error)
            return self._work.failed(handle.goal, error), GoalState.ABORTED
        except Exception as error:
            log.exception("goal %s failed", handle.goal_id)
            return self._work.failed(handle.goal, error), GoalState.ABORTED

    def _end(self, handle: GoalHandle[Goal, Result], result: Result, state: GoalState) -> None:
        with handle.voice:
            with self._changed:
                if handle.state is GoalState.CANCELLING:
                    # The cancel was accepted, perhaps after the last checkpoint: what was found since is no answer.
                    result, state = self._work.stopped(handle), GoalState.CANCELLED
                handle.result = result
                handle.fraction = 1.0
                handle.state = move(handle.state, state)
                handle.ended = time.monotonic()
                self._ended.append((handle.ended, handle.goal_id))
                requests, handle.requests = handle.requests, []
            self._say(self._update(handle), requests)
        for request in requests:
            request.close()
        self._status.changed()

    # Words to clients and watchers.

    def _update(self, handle: GoalHandle[Goal, Result]) -> Update[Result]:
        return Update(
            goal_id=handle.goal_id,
            state=handle.state,
            final=handle.state in ENDED,
            stage=handle.stage,
            fraction=handle.fraction,
            server=self._name,
            result=handle.result,
        )

    def _tell(self, handle: GoalHandle[Goal, Result]) -> None:
        with handle.voice:
            with self._changed:
                update = self._update(handle)
                requests = list(handle.requests)
            if handle.ended is not None:
                return
            self._say(update, requests)
        if update.stage in ("", "started"):
            self._status.changed()

    def _say(self, update: Update[Result], requests: list[RawRequest]) -> None:
        payload = encode(update)
        for request in requests:
            self._reply(request, payload)
        if self._feedback.has_readers():
            self._publish(update)

    def _reply(self, request: RawRequest, payload: bytes) -> None:
        try:
            request.reply(payload)
        except Exception as error:  # noqa: BLE001  a client that has gone must not stop the work for others
            log.debug("a client has gone: %s", error)

    def _publish(self, update: Update[Result]) -> None:
        try:
            self._feedback.send(update)  # type: ignore[arg-type]  # Update of any result is an Update of a Message
        except ConnectionLost as error:
            log.debug("no feedback sent: %s", error)

    def _publish_goal(self, goal: Goal) -> None:
        """For watchers and recorders: requests themselves are seen by nobody else."""
        try:
            if self._taken.has_readers():
                self._taken.send(goal)
        except ConnectionLost as error:
            log.debug("no goal sent: %s", error)

    def _present(self) -> GoalStatusList:
        """The newest goals, for watchers."""
        with self._changed:
            handles = list(self._goals.values())[-_LISTED:]
            goals = tuple(
                GoalStatus(goal_id=h.goal_id, state=h.state, accepted=h.accepted, what=h.stage) for h in handles
            )
        return GoalStatusList(server=self._name, goals=goals)
