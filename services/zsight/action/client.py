"""The client half of an action: send a goal, read its updates, get its answer or a reason why there is none."""

from __future__ import annotations

import threading
import time
from typing import TYPE_CHECKING, Generic, TypeVar

from zsight.errors import ConnectionLost, DeadlinePassed, ServerLost, ZsightError
from zsight.question import ask_question, nobody
from zsight_protocol.action import CancelCode, CancelRequest, CancelResponse, Update
from zsight_protocol.codec import decode, encode
from zsight_protocol.errors import ProtocolError
from zsight_protocol.message import Message

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from zsight.bus import Bus

__all__ = ["GoalCall", "cancel"]

Result = TypeVar("Result", bound=Message)

_MARGIN = 0.5  # seconds beyond the goal's own deadline, in which the server's word on it may arrive


class GoalCall(Generic[Result]):
    """A goal that was sent: iterate over its updates, or wait for its result."""

    def __init__(
        self, bus: Bus, keys: tuple[str, str], goal: Message, goal_id: str, result: type[Result], timeout: float
    ) -> None:
        """Args: bus; keys of the server's goals and cancels; goal and its id; kind of its result; seconds it allows."""
        self.goal_id = goal_id
        self.server = ""
        self._bus = bus
        self._key, self._cancel_key = keys
        self._kind: type[Update[Result]] = Update[result]  # type: ignore[valid-type]  # a class made at run time
        self._deadline = time.monotonic() + timeout + _MARGIN
        self._timeout = timeout
        self._replies = bus.ask(self._key, encode(goal), timeout + 2 * _MARGIN)
        self._final: Update[Result] | None = None
        self._heard = False
        self._lock = threading.Lock()

    def __iter__(self) -> Iterator[Update[Result]]:
        """Updates as they come, the final one last.

        Raises:
            NobodyAnswers: no server took the goal.
            ServerLost: the server took the goal, and died or was cut off before it answered.
            DeadlinePassed: neither happened in time.
        """
        while self._final is None:
            yield self._next()

    def _next(self) -> Update[Result]:
        with self._lock:
            if self._final is not None:  # another thread took it while this one waited for the lock
                return self._final
            payload = self._payload()
            if payload is None:
                raise self._loss()
            self._heard = True
            try:
                update = decode(self._kind, payload)
            except ProtocolError as error:
                self._replies.close()
                raise ServerLost(f"{self._key} answered with something else than an update: {error}") from None
            self.server = update.server
            if update.final:
                self._final = update
            return update

    def cancel(self) -> CancelResponse:
        """Ask the server to stop working on the goal; its answer still comes, as cancelled."""
        return cancel(self._bus, self._cancel_key, self.goal_id)

    def _payload(self) -> bytes | None:
        """The next reply, while there is time and a network."""
        try:
            return self._replies.take(self._deadline - time.monotonic())
        except TimeoutError:
            self._replies.close()
            raise DeadlinePassed(f"no answer from {self._key} within {self._timeout:g} s") from None
        except ConnectionLost:
            words = f"cut off from the network while {self._key} worked on goal {self.goal_id}: ask again"
            raise ServerLost(words) from None

    def _loss(self) -> ZsightError:
        if not self._heard:
            return nobody(self._bus, self._key)
        return ServerLost(f"the server on {self._key} went away while it worked on goal {self.goal_id}: ask again")

    def wait(self, on_update: Callable[[Update[Result]], None] = lambda _: None) -> Update[Result]:
        """The final update; every update before it is handed to on_update. Raises as iterating does."""
        for update in self:
            on_update(update)
        if self._final is None:
            raise ServerLost(f"goal {self.goal_id} ended without an answer")
        return self._final


def cancel(bus: Bus, key: str, goal_id: str | None) -> CancelResponse:
    """Ask the servers on a key to cancel one goal, or all; key is that of cancel requests and may hold a wildcard.

    Returns:
        The server's word; of several servers' the one that knows the goal, with the goals of all.

    Raises:
        NobodyAnswers: no server is there.
        DeadlinePassed: none answers.
    """
    responses = ask_question(bus, key, CancelRequest(goal_id=goal_id), CancelResponse, everyone="*" in key)
    known = [response for response in responses if response.code is not CancelCode.UNKNOWN_GOAL] or responses
    best = min(known, key=lambda response: response.code)
    return CancelResponse(code=best.code, goals=tuple(goal for response in responses for goal in response.goals))
