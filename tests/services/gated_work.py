"""Work of an action server that goes on until the test lets it end."""

from __future__ import annotations

import threading

from zsight.action.server import GoalHandle
from zsight_protocol.find_object import FindObjectGoal, FindObjectResult, ResultCode, Status
from zsight_protocol.message import Header

__all__ = ["Gated", "result"]

Handle = GoalHandle[FindObjectGoal, FindObjectResult]


def result(message: str, code: ResultCode = ResultCode.FOUND) -> FindObjectResult:
    return FindObjectResult(header=Header(), code=code, status=Status.CANNOT_TELL, message=message)


class Gated:
    """Work that goes on until its gate is opened, and counts how often it was done."""

    def __init__(self) -> None:
        self.gate = threading.Event()
        self.runs: list[str] = []
        self.error: Exception | None = None
        self.answer = result("done")

    def refuse(self, goal: FindObjectGoal) -> FindObjectResult | None:
        return result("no", ResultCode.CODE_NOT_RECOGNISED) if goal.object_type == "unknown" else None

    def busy(self, goal: FindObjectGoal) -> FindObjectResult:
        del goal
        return result("busy", ResultCode.BUSY)

    def execute(self, handle: Handle) -> FindObjectResult:
        self.runs.append(handle.goal_id)
        if self.error is not None:
            raise self.error
        handle.checkpoint("waiting", 0.5)
        while not self.gate.wait(0.002):
            handle.checkpoint("waiting", 0.5)
        return self.answer

    def stopped(self, handle: Handle) -> FindObjectResult:
        if handle.deadline_passed:
            return result("deadline", ResultCode.NOT_FOUND).model_copy(update={"deadline_passed": True})
        return result("stopped", ResultCode.CANCELLED)

    def failed(self, goal: FindObjectGoal, error: Exception) -> FindObjectResult:
        del goal
        return result(str(error), ResultCode.NOT_FOUND)
