"""The client: what a program does with a cell of zsight."""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING

from zsight.action_client import GoalCall
from zsight.action_client import cancel as cancel_goal
from zsight.bus import Bus
from zsight.bus.zenoh_link import open_link
from zsight.errors import DeadlinePassed, GoalCancelled, NobodyAnswers, RequestRefused, ServerBusy
from zsight.network import Network
from zsight_protocol.action import GoalState, new_goal_id
from zsight_protocol.channels import Cell as Keys
from zsight_protocol.codec import decode, encode
from zsight_protocol.find_object import Capture, FindObjectGoal, FindObjectResult, ResultCode
from zsight_protocol.geometry import Plane, Region
from zsight_protocol.object_type import CatalogAnswer, CatalogRequest
from zsight_protocol.point_cloud import PointCloud2

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from zsight_protocol.action import CancelResponse, Update
    from zsight_protocol.object_type import ObjectType

__all__ = ["CellClient", "connect"]


def connect(endpoint: str | None = None, *, namespace: str | None = None) -> CellClient:
    """Join a cell.

    Args:
        endpoint: the router's, such as "tcp/192.0.2.7:7447"; left out: ZSIGHT_CONNECT, else this host's.
        namespace: the cell's; left out: ZSIGHT_NAMESPACE, else "zsight".

    Raises:
        ConnectionLost: no router answers there.
    """
    network = Network.from_environment()
    if endpoint is not None:
        network = network.on(endpoint)
    return CellClient(Bus(open_link(network), Keys(namespace or network.namespace)))


class CellClient:
    """A cell as a program sees it; a context manager, no global state."""

    def __init__(self, bus: Bus) -> None:
        """Args: bus, closed with the client."""
        self.bus = bus

    def __enter__(self) -> CellClient:
        """The client itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Leave the cell."""
        self.close()

    def close(self) -> None:
        """Leave the cell."""
        self.bus.close()

    def start_find(
        self,
        object_type: str,
        *,
        finder: str = "finder",
        frame: str = "",
        known_height: float | None = None,
        region: Region | None = None,
        capture: Capture = Capture.LAST,
        maximum: int = 1,
        timeout: float = 10.0,
    ) -> GoalCall[FindObjectResult]:
        """Send a goal and return at once: iterate over its updates, or wait for its result; see ``find``."""
        goal = FindObjectGoal(
            goal_id=new_goal_id(),
            object_type=object_type,
            frame_id=frame,
            known_height=known_height,
            region=region,
            capture=capture,
            maximum=maximum,
            timeout=timeout,
        )
        key = self.bus.cell.find_object(finder)
        return GoalCall(self.bus, key, goal, goal.goal_id, FindObjectResult, timeout)

    def find(
        self,
        object_type: str,
        *,
        finder: str = "finder",
        frame: str = "",
        known_height: float | None = None,
        region: Region | None = None,
        capture: Capture = Capture.LAST,
        maximum: int = 1,
        timeout: float = 10.0,
        on_update: Callable[[Update[FindObjectResult]], None] = lambda _: None,
    ) -> FindObjectResult:
        """Find an object.

        Args:
            object_type: catalogue name, or the book's number as text.
            finder: which finder is asked.
            frame: frame of the answer; empty: the world where it is known, else the camera's.
            known_height: height of the support surface along that frame's z, metres, where it is known.
            region: only what lies inside, in that frame.
            capture: the last cloud, or a new one.
            maximum: most objects; 0 for all.
            timeout: seconds.
            on_update: called with every update.

        Returns:
            The answer: found, not_found or cannot_tell.

        Raises:
            RequestRefused: the type is not known.
            ServerBusy: the finder has no room for another goal.
            GoalCancelled: somebody cancelled it.
            DeadlinePassed: no answer in time.
            NobodyAnswers: no finder of this name is there.
            ServerLost: it died or was cut off meanwhile.
        """
        call = self.start_find(
            object_type,
            finder=finder,
            frame=frame,
            known_height=known_height,
            region=region,
            capture=capture,
            maximum=maximum,
            timeout=timeout,
        )
        return answer_of(call.wait(on_update))

    def cancel(self, goal_id: str | None = None, *, finder: str = "finder") -> CancelResponse:
        """Cancel one goal of a finder, or all."""
        return cancel_goal(self.bus, self.bus.cell.cancel(finder), goal_id)

    def clouds(self, camera: str = "kinect", *, timeout: float | None = None) -> Iterator[PointCloud2]:
        """The newest cloud of a camera, again and again; ends when none came for timeout seconds."""
        with contextlib.closing(self.bus.reader(self.bus.cell.points(camera), PointCloud2)) as reader:
            while (received := reader.take(timeout)) is not None:
                yield received.message

    def select(self, patch: PointCloud2, camera: str = "kinect", *, timeout: float = 5.0) -> Plane:
        """The plane of a patch of a camera's cloud, found by the planes service.

        Raises:
            NobodyAnswers: no planes service reads the patches.
            DeadlinePassed: it published no plane in time, for instance because the patch has none.
        """
        with contextlib.closing(self.bus.reader(self.bus.cell.plane(camera), Plane)) as planes:
            writer = self.bus.writer(self.bus.cell.selected_points(camera), PointCloud2)
            if not _soon(writer.has_readers, timeout):
                raise NobodyAnswers(f"nobody reads {self.bus.cell.selected_points(camera)}: start the planes service")
            writer.send(patch)
            received = planes.take(timeout)
            writer.close()
        if received is None:
            raise DeadlinePassed(f"no plane within {timeout:g} s: see the log of the planes service")
        return received.message

    def catalogue(self) -> list[ObjectType]:
        """All types that the finders know."""
        return list(self._ask_catalogue(CatalogRequest(action="list"), "*").types)

    def object_type(self, name: str) -> ObjectType:
        """One type by name or number.

        Raises:
            RequestRefused: it is not known.
        """
        return self._ask_catalogue(CatalogRequest(action="get", name=name), name).types[0]

    def add_type(self, kind: ObjectType) -> str:
        """Add a type, or change the one of its name; what the finder says."""
        return self._ask_catalogue(CatalogRequest(action="put", type=kind), kind.name).message

    def remove_type(self, name: str) -> str:
        """Remove a type; what the finder says."""
        return self._ask_catalogue(CatalogRequest(action="delete", name=name), name).message

    def _ask_catalogue(self, request: CatalogRequest, name: str, timeout: float = 2.0) -> CatalogAnswer:
        replies = self.bus.ask(self.bus.cell.catalog(name), encode(request), timeout)
        try:
            payload = replies.take(timeout)
        except TimeoutError:
            raise DeadlinePassed(f"the catalogue does not answer within {timeout:g} s") from None
        if payload is None:
            raise NobodyAnswers("nobody serves a catalogue: start a finder with: zsight up")
        reply = decode(CatalogAnswer, payload)
        if not reply.ok:
            raise RequestRefused(reply.message)
        return reply


def answer_of(update: Update[FindObjectResult]) -> FindObjectResult:
    """The result of a final update, or the error that it stands for."""
    result = update.result
    if result is None:
        raise RequestRefused(f"goal {update.goal_id} ended {update.state.name.lower()} without a result")
    if result.code is ResultCode.CODE_NOT_RECOGNISED:
        raise RequestRefused(result.message)
    if result.code is ResultCode.BUSY:
        raise ServerBusy(result.message)
    if update.state is GoalState.CANCELLED or result.code is ResultCode.CANCELLED:
        raise GoalCancelled(result.message)
    if result.deadline_passed:
        raise DeadlinePassed(result.message)
    return result


def _soon(happened: Callable[[], bool], timeout: float) -> bool:
    """Whether something happens within timeout seconds; a matching writer is known at once or after a round trip."""
    import threading
    import time

    pause, deadline = threading.Event(), time.monotonic() + timeout
    while not happened():
        if time.monotonic() >= deadline:
            return False
        pause.wait(0.005)
    return True
