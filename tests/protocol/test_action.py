"""The life of a goal, move by move."""

from __future__ import annotations

import itertools

import pytest
from pydantic import TypeAdapter

from zsight_protocol.action import ENDED, LEGAL_MOVES, CancelCode, GoalId, GoalState, move, new_goal_id
from zsight_protocol.errors import ProtocolError

S = GoalState
# Written out once more on purpose: the table of the package is what is tested.
EXPECTED = {
    (S.ACCEPTED, S.EXECUTING),
    (S.ACCEPTED, S.CANCELLING),
    (S.ACCEPTED, S.ABORTED),
    (S.EXECUTING, S.CANCELLING),
    (S.EXECUTING, S.SUCCEEDED),
    (S.EXECUTING, S.ABORTED),
    (S.CANCELLING, S.CANCELLED),
    (S.CANCELLING, S.ABORTED),
}
PAIRS = list(itertools.product(S, S))


def test_the_table_has_a_row_for_every_state() -> None:
    assert set(LEGAL_MOVES) == set(S)


@pytest.mark.parametrize(("state", "target"), sorted(EXPECTED))
def test_a_legal_move_gives_the_target(state: GoalState, target: GoalState) -> None:
    assert move(state, target) is target


@pytest.mark.parametrize(("state", "target"), sorted(set(PAIRS) - EXPECTED))
def test_an_illegal_move_raises_and_names_both_states(state: GoalState, target: GoalState) -> None:
    with pytest.raises(ProtocolError) as caught:
        move(state, target)
    assert f"a goal that is {state.name.lower()} cannot become {target.name.lower()}" in str(caught.value)


def test_ended_are_the_states_that_no_move_leaves() -> None:
    assert {state for state in S if not any(pair[0] is state for pair in EXPECTED)} == ENDED


def test_every_state_but_rejected_is_reached_from_accepted() -> None:
    reached = {S.ACCEPTED}
    for _ in S:
        reached |= {target for state, target in EXPECTED if state in reached}
    assert reached == set(S) - {S.REJECTED}


def test_a_goal_whose_cancel_was_accepted_never_succeeds() -> None:
    with pytest.raises(ProtocolError):
        move(S.CANCELLING, S.SUCCEEDED)


def test_numbers_are_those_of_ros() -> None:
    assert {state.name: state.value for state in S} == {
        "REJECTED": 0,
        "ACCEPTED": 1,
        "EXECUTING": 2,
        "CANCELLING": 3,
        "SUCCEEDED": 4,
        "CANCELLED": 5,
        "ABORTED": 6,
    }
    assert [code.value for code in CancelCode] == [0, 1, 2, 3]


def test_new_goal_ids_are_legal_and_differ() -> None:
    ids = {new_goal_id() for _ in range(100)}
    assert len(ids) == 100
    for goal_id in ids:
        TypeAdapter(GoalId).validate_python(goal_id)
