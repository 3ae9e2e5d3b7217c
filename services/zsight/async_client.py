"""The asyncio twin of the client: the same core, its waits in threads."""

from __future__ import annotations

import asyncio
import contextlib
from typing import TYPE_CHECKING, TypeVar, Unpack

from zsight.client import CellClient, answer_of, connect

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Iterator

    from zsight.action_client import GoalCall
    from zsight.client import Cloud, FindOptions
    from zsight.merging import MergedObject
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

    async def __aenter__(self) -> AsyncCellClient:
        """The client itself."""
        return self

    async def __aexit__(self, *_: object) -> None:
        """Leave the cell."""
        await self.close()

    async def close(self) -> None:
        """Leave the cell."""
        await asyncio.to_thread(self.client.close)

    async def start_find(self, object_type: str, **options: Unpack[FindOptions]) -> AsyncGoalCall:
        """Send a goal: iterate over its updates, or await its result."""
        return AsyncGoalCall(await asyncio.to_thread(lambda: self.client.start_find(object_type, **options)))

    async def find(self, object_type: str, **options: Unpack[FindOptions]) -> FindObjectResult:
        """Find an object; a task that is cancelled meanwhile cancels the goal."""
        return await (await self.start_find(object_type, **options)).result()

    async def find_all(self, object_type: str, *, frame: str = "", timeout: float = 10.0) -> list[MergedObject]:
        """Ask every finder."""
        return await asyncio.to_thread(lambda: self.client.find_all(object_type, frame=frame, timeout=timeout))

    async def cancel(self, goal_id: str | None = None, *, finder: str = "*") -> CancelResponse:
        """Cancel one goal or all."""
        return await asyncio.to_thread(lambda: self.client.cancel(goal_id, finder=finder))

    async def select(self, patch: Cloud | PointCloud2, camera: str = "kinect", *, timeout: float = 5.0) -> Plane:
        """The plane of a patch."""
        return await asyncio.to_thread(lambda: self.client.select(patch, camera, timeout=timeout))

    async def clouds(self, key: str = "kinect/points", *, timeout: float | None = None) -> AsyncIterator[Cloud]:
        """The newest cloud on a key, again and again."""
        with contextlib.closing(self.client.clouds(key, timeout=timeout)) as clouds:  # type: ignore[type-var]  # a generator, which has close
            async for cloud in _in_threads(clouds):
                yield cloud


class AsyncGoalCall:
    """A goal that was sent."""

    def __init__(self, call: GoalCall[FindObjectResult]) -> None:
        """Args: the call that does the work."""
        self.call = call

    async def __aiter__(self) -> AsyncIterator[Update[FindObjectResult]]:
        """Updates as they come, the final one last."""
        async for update in _in_threads(iter(self.call)):
            yield update

    async def result(self) -> FindObjectResult:
        """The answer; cancelling this task cancels the goal."""
        try:
            return answer_of(await asyncio.to_thread(self.call.wait))
        except asyncio.CancelledError:
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
