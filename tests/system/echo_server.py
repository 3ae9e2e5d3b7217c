"""A process that serves find-object goals without looking at clouds: for tests of the protocol."""

from __future__ import annotations

import sys
import threading
import time

from zsight.action.server import ActionServer, GoalHandle, Policy
from zsight.bus import Bus, RawRequest
from zsight.bus.zenoh_link import open_link, open_router
from zsight.network import Network
from zsight_protocol.channels import Cell
from zsight_protocol.find_object import FindObjectGoal, FindObjectResult, ResultCode, Status
from zsight_protocol.message import Header


class Echo:
    """Answers with the goal's id after ``known_height`` seconds."""

    def refuse(self, goal: FindObjectGoal) -> FindObjectResult | None:
        return answer(goal.goal_id, ResultCode.CODE_NOT_RECOGNISED) if goal.object_type == "unknown" else None

    def busy(self, goal: FindObjectGoal) -> FindObjectResult:
        return answer(goal.goal_id, ResultCode.BUSY)

    def execute(self, handle: GoalHandle[FindObjectGoal, FindObjectResult]) -> FindObjectResult:
        begin = time.monotonic()
        duration = handle.goal.known_height or 0.0
        pause = threading.Event()
        while (done := time.monotonic() - begin) < duration:
            handle.checkpoint("echo", min(done / duration, 1.0))
            pause.wait(0.002)
        return answer(handle.goal_id, ResultCode.FOUND)

    def stopped(self, handle: GoalHandle[FindObjectGoal, FindObjectResult]) -> FindObjectResult:
        return answer(handle.goal_id, ResultCode.NOT_FOUND if handle.deadline_passed else ResultCode.CANCELLED)

    def failed(self, goal: FindObjectGoal, error: Exception) -> FindObjectResult:
        del error
        return answer(goal.goal_id, ResultCode.NOT_FOUND)


def answer(goal_id: str, code: ResultCode) -> FindObjectResult:
    return FindObjectResult(header=Header(), code=code, status=Status.CANNOT_TELL, message=goal_id)


def main() -> None:
    """``router ENDPOINT`` or ``server ENDPOINT PARALLEL QUEUE [NAMESPACE]``; says ``ready``, ends with its input."""
    role, endpoint, *policy = sys.argv[1:]
    network = Network().on(endpoint)
    if role == "router":
        link = open_router(network)
        print("ready", flush=True)
        sys.stdin.read()
        link.close()
        return
    parallel, queue = (int(number) for number in policy[:2])
    bus = Bus(open_link(network), Cell(*policy[2:]))
    bare = bus.serve("echo/bare", _answer_at_once)
    server = ActionServer(bus, "finder", FindObjectGoal, Echo(), Policy(parallel, queue))
    bus.link.alive(bus.cell.alive("*", "*"), 1.0)  # a round trip: the router knows all that was declared before it
    print("ready", flush=True)
    sys.stdin.read()
    server.close()
    bare.close()
    bus.close()


def _answer_at_once(request: RawRequest) -> None:
    """What a bare query costs, for comparison."""
    request.reply(request.payload)
    request.close()


if __name__ == "__main__":
    main()
