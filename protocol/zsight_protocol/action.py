"""The life of a goal: states, legal moves, cancel codes and the messages that carry them.

The numbers are those of ROS 2 actions (action_msgs/GoalStatus, action_msgs/CancelGoal). A client sends a goal as a
request and gets a stream of updates; only the update marked ``final`` is the answer.
"""

from __future__ import annotations

import uuid
from enum import IntEnum
from typing import Annotated, Generic, TypeVar

from pydantic import Field, Strict, StringConstraints

from zsight_protocol.errors import ProtocolError
from zsight_protocol.message import Bare, Float64, Message, Time

__all__ = [
    "ENDED",
    "LEGAL_MOVES",
    "CancelCode",
    "CancelRequest",
    "CancelResponse",
    "GoalId",
    "GoalState",
    "GoalStatus",
    "GoalStatusList",
    "ResultRequest",
    "Update",
    "UpdateList",
    "move",
    "new_goal_id",
]

GoalId = Annotated[str, StringConstraints(pattern=r"^[0-9a-f]{8}-[0-9a-f]{4}-[0-9a-f]{4}-[0-9a-f]{4}-[0-9a-f]{12}$")]


def new_goal_id() -> str:
    """A random UUID, made by the client."""
    return str(uuid.uuid4())


class GoalState(IntEnum):
    """Where a goal stands."""

    REJECTED = 0  # never began; ROS 2 reports such a goal as unknown
    ACCEPTED = 1
    EXECUTING = 2
    CANCELLING = 3
    SUCCEEDED = 4
    CANCELLED = 5
    ABORTED = 6


ENDED = frozenset({GoalState.REJECTED, GoalState.SUCCEEDED, GoalState.CANCELLED, GoalState.ABORTED})

LEGAL_MOVES: dict[GoalState, frozenset[GoalState]] = {
    GoalState.ACCEPTED: frozenset({GoalState.EXECUTING, GoalState.CANCELLING, GoalState.ABORTED}),
    GoalState.EXECUTING: frozenset({GoalState.CANCELLING, GoalState.SUCCEEDED, GoalState.ABORTED}),
    # A goal whose cancel was accepted never succeeds after all: the client has been promised that.
    GoalState.CANCELLING: frozenset({GoalState.CANCELLED, GoalState.ABORTED}),
    **dict.fromkeys(ENDED, frozenset()),
}


def move(state: GoalState, target: GoalState) -> GoalState:
    """The target, where the move to it is legal.

    Raises:
        ProtocolError: it is not.
    """
    if target not in LEGAL_MOVES[state]:
        legal = ", ".join(s.name.lower() for s in sorted(LEGAL_MOVES[state])) or "nothing: it has ended"
        raise ProtocolError(f"a goal that is {state.name.lower()} cannot become {target.name.lower()}; legal: {legal}")
    return target


class CancelCode(IntEnum):
    """What became of a cancel request."""

    NONE = 0  # no error: the goal is being cancelled
    REJECTED = 1
    UNKNOWN_GOAL = 2
    ALREADY_ENDED = 3


State = Annotated[GoalState, Bare()]
Result = TypeVar("Result", bound=Message)


class Update(Message, Generic[Result]):
    """One message of the stream that answers a goal; the last one is final and carries the result.

    ``stage`` is what is being done, ``fraction`` how far the whole is.
    """

    goal_id: GoalId
    state: State
    final: bool
    stage: str = ""
    fraction: Annotated[Float64, Field(ge=0, le=1)] = 0.0
    server: str = ""
    result: Result | None = None


class ResultRequest(Message):
    """Ask how one goal stands or ended, or all goals that the server remembers where goal_id is none."""

    goal_id: GoalId | None = None


class UpdateList(Message, Generic[Result]):
    """The last update of each goal asked for, oldest first."""

    updates: Annotated[tuple[Update[Result], ...], Strict(False)] = ()


class CancelRequest(Message):
    """Cancel one goal, or all goals of a server where goal_id is none."""

    goal_id: GoalId | None = None


class CancelResponse(Message):
    """What became of it, and which goals are being cancelled."""

    code: Annotated[CancelCode, Bare()]
    goals: Annotated[tuple[GoalId, ...], Strict(False)] = ()


class GoalStatus(Message):
    """Where one goal stands, for watchers."""

    goal_id: GoalId
    state: State
    accepted: Time
    what: str = ""


class GoalStatusList(Message):
    """All goals that a server holds."""

    server: str
    goals: Annotated[tuple[GoalStatus, ...], Strict(False)] = ()
