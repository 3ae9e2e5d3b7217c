"""The log of goals: who was asked for what, how it went on, how it ended; answers are drawn, whoever asked."""

from __future__ import annotations

import time
from collections import OrderedDict
from dataclasses import dataclass
from html import escape
from typing import TYPE_CHECKING

from zsight_protocol.action import GoalState, GoalStatusList, Update
from zsight_protocol.channels import Delivery
from zsight_protocol.find_object import FindObjectResult, ResultCode

if TYPE_CHECKING:
    import viser

    from zsight.bus import Bus
    from zsight.viewer.found import FoundObjects

__all__ = ["Goals"]

_KEPT = 12  # goals in the log


@dataclass
class _Goal:
    """One line of the log."""

    began: float
    finder: str = ""
    what: str = ""
    state: GoalState = GoalState.ACCEPTED
    stage: str = ""
    words: str = ""


class Goals:
    """What all finders are asked and answer."""

    def __init__(self, server: viser.ViserServer, bus: Bus, found: FoundObjects) -> None:
        """Args: server of the page; bus; found: what is drawn."""
        kind: type[Update[FindObjectResult]] = Update[FindObjectResult]
        self._updates = bus.reader(bus.cell.feedback("*"), kind, delivery=Delivery.EVERY)
        self._statuses = bus.reader(bus.cell.status("*"), GoalStatusList, delivery=Delivery.LATCHED)
        self._found = found
        self._goals: OrderedDict[str, _Goal] = OrderedDict()
        self._html = server.gui.add_html(_table([]))

    def asked(self, goal_id: str, what: str) -> None:
        """A goal of this page: watchers are not told what is sought."""
        self._goal(goal_id).what = what

    def update(self) -> None:
        """Take in what was heard."""
        changed = False
        while (status := self._statuses.take(0)) is not None:
            for entry in status.message.goals:
                goal = self._goal(entry.goal_id)
                goal.finder, goal.stage, goal.state = status.message.server, entry.what, entry.state
            changed = True
        while (update := self._updates.take(0)) is not None:
            self._take(update.message)
            changed = True
        if changed:
            self._html.content = _table(list(self._goals.values()))

    def _goal(self, goal_id: str) -> _Goal:
        goal = self._goals.setdefault(goal_id, _Goal(time.time()))
        while len(self._goals) > _KEPT:
            self._goals.popitem(last=False)
        return goal

    def _take(self, update: Update[FindObjectResult]) -> None:
        goal = self._goal(update.goal_id)
        goal.finder, goal.state = update.server or goal.finder, update.state
        goal.stage = "" if update.final else f"{update.stage} {update.fraction:.0%}"
        if update.result is not None:
            goal.words = outcome(update.result)
            goal.what = goal.what or ", ".join(sorted({found.type for found in update.result.objects}))
            if update.result.code in (ResultCode.FOUND, ResultCode.NOT_FOUND):
                self._found.show(goal.what, update.result)


def outcome(result: FindObjectResult) -> str:
    """How a find ended, in a few words."""
    if result.objects:
        return "found " + ", ".join(f"{found.type} {found.score:.0%}" for found in result.objects)
    words = result.status.value.replace("_", " ")
    if result.message:
        return f"{words}: {result.message}"
    return f"{words} (absent: {result.p_absent:.0%})" if result.p_absent else words


def _table(goals: list[_Goal]) -> str:
    if not goals:
        return "<p class='zs'>No goal was heard of yet.</p>"
    rows = "".join(_row(goal) for goal in reversed(goals))
    return f"<table class='zs'><tr><th>at</th><th>goal</th><th>outcome</th></tr>{rows}</table>"


def _row(goal: _Goal) -> str:
    began = time.strftime("%H:%M:%S", time.localtime(goal.began))
    what = goal.what or f"a find of {goal.finder}"
    words = goal.words or goal.stage or goal.state.name.lower()
    return f"<tr><td>{began}</td><td>{escape(what)}</td><td>{escape(words)}</td></tr>"
