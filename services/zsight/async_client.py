"""The asyncio twin of the client: the same core, its waits in threads."""

from __future__ import annotations

import asyncio
import contextlib
import functools
import time
from typing import TYPE_CHECKING, TypeVar, Unpack

from zsight.async_services import AsyncCatalog, AsyncParameters, AsyncPlayer, AsyncRecorder
from zsight.client import LOST_OR_BUSY, CellClient, Cloud, answer_of, cloud_reader, connect
from zsight.errors import ZsightError

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Callable, Iterator

    from zsight.action.client import GoalCall
    from zsight.client import FindOptions
    from zsight.levelling import CameraLevel
    from zsight.merging import MergedAnswer
    from zsight_protocol.action import CancelResponse, Update
    from zsight_protocol.find_object import FindObjectResult
    from zsight_protocol.geometry import Plane
    from zsight_protocol.point_cloud import PointCloud2

__all__ = ["AsyncCellClient", "AsyncGoalCall", "connect_async"]

T = TypeVar("T")


async def connect_async(endpoint: str | None = None, *, namespace: str | None = None) -> AsyncCellClient:
    """Join a cell; see ``zsight.connect``."""
    return AsyncCellClient(await asyncio.to_thread(connect, endpoint, namespace=namespace))


class AsyncCellClient:
    """A cell as an asyncio program sees it; a context manager. CellClient tells arguments and errors."""

    def __init__(self, client: CellClient) -> None:
        """Args: client, closed with this one."""
        self.client = client
        self.catalog = AsyncCatalog(client.catalog)
        self.parameters = AsyncParameters(client.parameters)

    async def __aenter__(self) -> AsyncCellClient:
        """The client itself."""
        return self

    async def __aexit__(self, *_: object) -> None:
        """Leave the cell."""
        await self.close()

    async def close(self) -> None:
        """Leave the cell."""
        await asyncio.to_thread(self.client.close)

    async def start_find(self, object_type: str | int, **options: Unpack[FindOptions]) -> AsyncGoalCall:
        """Send a goal: iterate over its updates, or await its result."""
        return AsyncGoalCall(await asyncio.to_thread(lambda: self.client.start_find(object_type, **options)))

    async def find(
        self,
        object_type: str | int,
        *,
        on_update: Callable[[Update[FindObjectResult]], None] = lambda _: None,
        retry: bool = False,
        **options: Unpack[FindOptions],
    ) -> FindObjectResult:
        """Find an object; a task that is cancelled meanwhile cancels the goal. ``on_update`` runs in another thread."""
        started = time.monotonic()
        goal = await self.start_find(object_type, **options)
        try:
            return await goal.result(on_update)
        except LOST_OR_BUSY:
            left = options.get("timeout", 10.0) - (time.monotonic() - started)
            again = await asyncio.to_thread(self.client.elsewhere, goal.call, options, left) if retry else None
            if again is None:
                raise
        return await self.find(object_type, on_update=on_update, **again)

    async def find_all(self, object_type: str | int, **options: Unpack[FindOptions]) -> MergedAnswer:
        """Ask every finder for all instances."""
        return await asyncio.to_thread(lambda: self.client.find_all(object_type, **options))

    async def finders(self) -> list[str]:
        """Names of all finders that are there."""
        return await asyncio.to_thread(self.client.finders)

    def recorder(self, name: str = "*") -> AsyncRecorder:
        """A recorder of the cell: start, stop and trigger recordings."""
        return AsyncRecorder(self.client.recorder(name))

    def player(self, name: str = "*") -> AsyncPlayer:
        """A player of the cell: play, pause, step, seek."""
        return AsyncPlayer(self.client.player(name))

    async def results(self, goal_id: str | None = None, *, finder: str = "*") -> list[Update[FindObjectResult]]:
        """How goals of the last minute stand or ended."""
        return await asyncio.to_thread(lambda: self.client.results(goal_id, finder=finder))

    async def level_camera(
        self,
        camera: str = "kinect",
        *,
        surface_height: float = 0.0,
        timeout: float = 5.0,
        apply: bool = True,
        save: bool = False,
    ) -> CameraLevel:
        """Level a camera by the surface it sees, and let it stand there."""
        level = functools.partial(self.client.level_camera, camera, surface_height=surface_height, timeout=timeout)
        return await asyncio.to_thread(level, apply=apply, save=save)

    async def cancel(self, goal_id: str | None = None, *, finder: str = "*") -> CancelResponse:
        """Cancel one goal or all."""
        return await asyncio.to_thread(lambda: self.client.cancel(goal_id, finder=finder))

    async def select(self, patch: Cloud | PointCloud2, camera: str = "kinect", *, timeout: float = 5.0) -> Plane:
        """The plane of a patch."""
        return await asyncio.to_thread(lambda: self.client.select(patch, camera, timeout=timeout))

    async def clouds(self, key: str = "kinect/points", *, timeout: float | None = None) -> AsyncIterator[Cloud]:
        """The newest cloud on a key, again and again."""
        # Closing the reader ends a take that a cancelled task has left in its thread.
        with contextlib.closing(cloud_reader(self.client.bus, key)) as reader:
            while (received := await asyncio.to_thread(reader.take, timeout)) is not None:
                yield Cloud.of(received.message)


class AsyncGoalCall:
    """A goal that was sent."""

    def __init__(self, call: GoalCall[FindObjectResult]) -> None:
        """Args: the call that does the work."""
        self.call = call

    async def __aiter__(self) -> AsyncIterator[Update[FindObjectResult]]:
        """Updates as they come, the final one last."""
        async for update in _in_threads(iter(self.call)):
            yield update

    async def result(self, on_update: Callable[[Update[FindObjectResult]], None] = lambda _: None) -> FindObjectResult:
        """The answer; cancelling this task cancels the goal."""
        try:
            return answer_of(await asyncio.to_thread(self.call.wait, on_update))
        except asyncio.CancelledError:
            with contextlib.suppress(ZsightError):  # the finder has gone, and its goal with it
                await asyncio.to_thread(self.call.cancel)
            raise

    async def cancel(self) -> CancelResponse:
        """Ask the server to stop working on the goal."""
        return await asyncio.to_thread(self.call.cancel)


async def _in_threads(iterator: Iterator[T]) -> AsyncIterator[T]:
    """A blocking iterator, each step of it in a thread."""
    end = object()
    while True:
        entry = await asyncio.to_thread(next, iterator, end)
        if entry is end:
            return
        yield entry  # type: ignore[misc]  # it is no end, so it is a T
