"""The client: what a program does with a cell of zsight."""

from __future__ import annotations

import contextlib
import threading
import time
from typing import TYPE_CHECKING, Any, TypedDict, Unpack

import numpy as np
from pydantic import ValidationError

from zsight.action.client import GoalCall
from zsight.action.client import cancel as cancel_goal
from zsight.bus import Bus
from zsight.bus.zenoh_link import open_link
from zsight.catalogue.client import Catalog
from zsight.convert import cloud_from_points, points_of
from zsight.errors import (
    DeadlinePassed,
    GoalCancelled,
    NobodyAnswers,
    RequestRefused,
    ServerBusy,
    ServerLost,
    UsageError,
    ZsightError,
)
from zsight.hosts.beats import ask_health, present
from zsight.levelling import CameraLevel, await_level, measure_level, process_of
from zsight.merging import MergedAnswer, merge
from zsight.network import Network
from zsight.parameter_client import ParameterClient
from zsight.question import ask_question
from zsight.recording_client import PlayerClient, RecorderClient
from zsight_protocol.action import GoalState, ResultRequest, Update, UpdateList, new_goal_id
from zsight_protocol.channels import ANY_FINDER
from zsight_protocol.channels import Cell as Keys
from zsight_protocol.errors import DecodeError, KeyNameError
from zsight_protocol.find_object import Capture, FindObjectGoal, FindObjectResult, ResultCode
from zsight_protocol.geometry import Plane, Region
from zsight_protocol.message import Time
from zsight_protocol.point_cloud import PointCloud2

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from zsight.bus import Reader
    from zsight_protocol.action import CancelResponse

__all__ = ["CellClient", "Cloud", "FindOptions", "answer_of", "cloud_reader", "connect"]

ALL = "*"
_LEAST_OF_A_PLANE = 3  # points
LOST_OR_BUSY = (NobodyAnswers, ServerLost, ServerBusy)
"""What another finder may help with."""


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


class FindOptions(TypedDict, total=False):
    """What a find may be asked beside the object type.

    finder: which finder is asked; left out: the best match.
    frame: frame of the answer; empty: the world where it is known, else the camera's.
    known_height: height of the support surface along that frame's z, which must be up, metres, where it is known.
    region: only what lies inside, in that frame.
    capture: the last cloud, or a new one.
    maximum: most objects, 0 for all; 1 if not given.
    timeout: seconds; 10 if not given.
    """

    finder: str
    frame: str
    known_height: float | None
    region: Region | None
    capture: Capture
    maximum: int
    timeout: float


class Cloud(np.ndarray[Any, np.dtype[np.void]]):
    """A cloud as a numpy view: one record a point, shape (height, width), fields ``x y z`` in metres and others.

    Attributes:
        stamp_ns: when the sensor measured it, nanoseconds since the epoch.
        frame_id: the frame of its coordinates.
    """

    stamp_ns: int
    frame_id: str

    @classmethod
    def of(cls, message: PointCloud2) -> Cloud:
        """A view of a message; nothing is copied."""
        cloud = points_of(message).view(cls)
        cloud.stamp_ns, cloud.frame_id = message.header.stamp.ns, message.header.frame_id
        return cloud

    def message(self) -> PointCloud2:
        """The same points as a message; of a selection ``cloud[mask]``, which has no rows, a single row.

        Raises:
            UsageError: there are no points.
        """
        points = np.atleast_2d(np.asarray(self))
        return cloud_from_points(points, Time.from_ns(self.stamp_ns), self.frame_id)

    def __array_finalize__(self, source: object) -> None:
        """Slices keep the stamp and the frame."""
        self.stamp_ns = getattr(source, "stamp_ns", 0)
        self.frame_id = getattr(source, "frame_id", "")


class CellClient:
    """A cell as a program sees it; a context manager, no global state, usable from several threads."""

    def __init__(self, bus: Bus) -> None:
        """Args: bus, closed with the client."""
        self.bus = bus
        self.catalog = Catalog(bus)
        self.parameters = ParameterClient(bus)

    def __enter__(self) -> CellClient:
        """The client itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Leave the cell."""
        self.close()

    def close(self) -> None:
        """Leave the cell."""
        self.bus.close()

    def start_find(self, object_type: str | int, **options: Unpack[FindOptions]) -> GoalCall[FindObjectResult]:
        """Send a goal and return at once: iterate over its updates, or wait for its result; see ``find``.

        Raises:
            UsageError: an option makes no sense.
        """
        finder = options.get("finder", ANY_FINDER)
        timeout = options.get("timeout", 10.0)
        try:
            goal = FindObjectGoal(
                goal_id=new_goal_id(),
                object_type=str(object_type),
                frame_id=options.get("frame", ""),
                known_height=options.get("known_height"),
                region=options.get("region"),
                capture=options.get("capture", Capture.LAST),
                maximum=options.get("maximum", 1),
                timeout=timeout,
            )
        except ValidationError as error:
            raise UsageError(str(DecodeError.from_validation("goal", error))) from None
        cell = self.bus.cell
        try:
            keys = (cell.find_object(finder), cell.cancel(finder if finder != ANY_FINDER else ALL))
        except KeyNameError as error:
            raise UsageError(str(error)) from None
        return GoalCall(self.bus, keys, goal, goal.goal_id, FindObjectResult, timeout)

    def find(
        self,
        object_type: str | int,
        *,
        on_update: Callable[[Update[FindObjectResult]], None] = lambda _: None,
        retry: bool = False,
        **options: Unpack[FindOptions],
    ) -> FindObjectResult:
        """Find an object.

        Args:
            object_type: catalogue name, or the book's number.
            on_update: called with every update.
            retry: ask another finder once where the first one is not there, dies or is busy.
            options: see FindOptions.

        Returns:
            The answer: found, not_found or cannot_tell.

        Raises:
            RequestRefused: the type is not known.
            ServerBusy: the finder has no room for another goal.
            GoalCancelled: somebody cancelled it.
            DeadlinePassed: no answer in time; its ``known`` is what the finder knew by then.
            NobodyAnswers: no finder of this name is there.
            ServerLost: it died or was cut off meanwhile.
            UsageError: an option makes no sense.
        """
        started = time.monotonic()
        call = self.start_find(object_type, **options)
        try:
            return answer_of(call.wait(on_update))
        except LOST_OR_BUSY:
            left = options.get("timeout", 10.0) - (time.monotonic() - started)
            again = self.elsewhere(call, options, left) if retry else None
            if again is None:
                raise
        return self.find(object_type, on_update=on_update, **again)

    def elsewhere(
        self, call: GoalCall[FindObjectResult], options: FindOptions, seconds_left: float
    ) -> FindOptions | None:
        """The options for asking another finder than a call did; none where no time or no finder is left."""
        others = [name for name in self.finders() if name != call.server] if seconds_left > 0 else []
        return {**options, "finder": others[0], "timeout": seconds_left} if others else None

    def find_all(self, object_type: str | int, **options: Unpack[FindOptions]) -> MergedAnswer:
        """Ask every finder for all instances, and join what they say of the same physical object.

        Args:
            object_type: as for ``find``.
            options: see FindOptions; finder means nothing here, and maximum is 0 if not given. With several cameras
                give a frame that all know, such as the world's: answers in different frames are not joined.

        Returns:
            Objects, the most probable first, each with who found it, what others say of its place and who saw none.

        Raises:
            NobodyAnswers: no finder is there.
            ZsightError: no finder gave an answer; the first one's reason.
        """
        names = self.finders()
        if not names:
            raise NobodyAnswers(f"no finder is there: {present(self.bus)}")
        calls: dict[str, GoalCall[FindObjectResult]] = {}
        for name in names:
            wanted: FindOptions = {"maximum": 0, **options, "finder": name}
            calls[name] = self.start_find(object_type, **wanted)
        results: list[FindObjectResult] = []
        failures: dict[str, ZsightError] = {}
        for name, call in calls.items():
            try:
                results.append(answer_of(call.wait()))
            except ZsightError as error:
                failures[name] = error
        if not results:
            raise next(iter(failures.values()))
        return MergedAnswer(merge(results), tuple(results), {name: str(error) for name, error in failures.items()})

    def finders(self) -> list[str]:
        """Names of all finders that are there."""
        prefix, suffix = self.bus.cell.status(ALL).split(ALL)
        keys = {writer.key for beat in ask_health(self.bus) for writer in beat.writers}
        return sorted(k[len(prefix) : -len(suffix)] for k in keys if k.startswith(prefix) and k.endswith(suffix))

    def recorder(self, name: str = ALL) -> RecorderClient:
        """A recorder of the cell: start, stop and trigger recordings."""
        return RecorderClient(self.bus, name)

    def player(self, name: str = ALL) -> PlayerClient:
        """A player of the cell: play, pause, step, seek."""
        return PlayerClient(self.bus, name)

    def cancel(self, goal_id: str | None = None, *, finder: str = ALL) -> CancelResponse:
        """Cancel one goal, or all goals, of a finder or of all.

        Raises:
            UsageError: no goal can have that id.
        """
        with _goal_named(goal_id):
            return cancel_goal(self.bus, self.bus.cell.cancel(finder), goal_id)

    def results(self, goal_id: str | None = None, *, finder: str = ALL) -> list[Update[FindObjectResult]]:
        """How goals of the last minute stand or ended: one, or all of them, oldest first.

        Raises:
            UsageError: no goal can have that id.
        """
        with _goal_named(goal_id):
            request = ResultRequest(goal_id=goal_id)
        kind: type[UpdateList[FindObjectResult]] = UpdateList[FindObjectResult]
        key = self.bus.cell.result(finder)
        answers = ask_question(self.bus, key, request, kind, everyone=True)
        return [update for answer in answers for update in answer.updates]

    def clouds(self, key: str = "kinect/points", *, timeout: float | None = None) -> Iterator[Cloud]:
        """The newest cloud on a key of the cell, again and again; ends when none came for timeout seconds.

        ``next`` then raises StopIteration, as of any iterator that has ended.
        """
        with contextlib.closing(cloud_reader(self.bus, key)) as reader:
            while (received := reader.take(timeout)) is not None:
                yield Cloud.of(received.message)

    def level_camera(
        self,
        camera: str = "kinect",
        *,
        surface_height: float = 0.0,
        timeout: float = 5.0,
        apply: bool = True,
        save: bool = False,
    ) -> CameraLevel:
        """Measure roll, pitch and height of a camera by the table or floor it sees, and let it stand there.

        The camera tells its new pose to all (``tf_static``); every answer from its next cloud on is in it. Place and
        yaw, which a surface does not tell, stay what they were. Needs the kernels (zsight[perception]).

        Args:
            camera: which one.
            surface_height: of the largest surface in view, metres in the world: 0 for the floor.
            timeout: seconds to wait for a cloud.
            apply: set the pose of the running camera; otherwise only measure.
            save: keep it over restarts of the camera's process too.

        Raises:
            DeadlinePassed: no cloud came, or the camera does not tell its new pose.
            NobodyAnswers: nobody publishes its clouds.
            RequestRefused: whoever publishes its clouds is no camera service, and cannot be moved.
            ZsightError: no surface is in view.
        """
        level = measure_level(self.bus, camera, surface_height, timeout)
        if apply:
            self.parameters.set(process_of(self.bus, camera), "pose", level.setting, save=save)
            await_level(self.bus, level, timeout)
        return level

    def select(self, patch: Cloud | PointCloud2, camera: str = "kinect", *, timeout: float = 5.0) -> Plane:
        """The plane of a patch of a camera's cloud, found by the planes service.

        Args:
            patch: points of one of its clouds, such as ``cloud[v0:v1, u0:u1]``.
            camera: whose cloud it is.
            timeout: seconds.

        Raises:
            UsageError: the patch has fewer points than a plane needs.
            NobodyAnswers: no planes service reads the patches.
            DeadlinePassed: it published no plane in time, for instance because the patch has none.
        """
        message = patch.message() if isinstance(patch, Cloud) else patch
        if message.width * message.height < _LEAST_OF_A_PLANE:
            raise UsageError(f"the patch is {message.width} x {message.height} points; a plane needs at least three")
        with (
            contextlib.closing(self.bus.reader(self.bus.cell.plane(camera), Plane)) as planes,
            contextlib.closing(self.bus.writer(self.bus.cell.selected_points(camera), PointCloud2)) as writer,
        ):
            if not _soon(writer.has_readers, timeout):
                raise NobodyAnswers(f"nobody reads {self.bus.cell.selected_points(camera)}: start the planes service")
            writer.send(message)
            received = planes.take(timeout)
        if received is None:
            raise DeadlinePassed(f"no plane within {timeout:g} s: see the log of the planes service")
        return received.message


def cloud_reader(bus: Bus, key: str) -> Reader[PointCloud2]:
    """A reader of the clouds on a key of the cell."""
    return bus.reader(f"{bus.cell.namespace}/{key}", PointCloud2)


@contextlib.contextmanager
def _goal_named(goal_id: str | None) -> Iterator[None]:
    """Say of an id that makes no sense that no goal has it."""
    try:
        yield
    except ValidationError:
        raise UsageError(f"no goal is called {goal_id}; expected the id of a goal") from None


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
        raise DeadlinePassed(result.message, result)
    return result


def _soon(happened: Callable[[], bool], timeout: float) -> bool:
    """Whether something happens within timeout seconds; a matching reader is known at once or after a round trip."""
    pause, deadline = threading.Event(), time.monotonic() + timeout
    while not happened():
        if time.monotonic() >= deadline:
            return False
        pause.wait(0.005)
    return True
