"""Catalogue, settings, recorders and players as an asyncio program asks them: each wait in a thread."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Unpack

if TYPE_CHECKING:
    import builtins

    from pydantic import JsonValue

    from zsight.catalogue.client import Catalog, Lesson
    from zsight.parameter_client import ParameterClient
    from zsight.recording_client import PlayerClient, RecorderClient
    from zsight_protocol.object_type import Derived, ObjectType, Taught
    from zsight_protocol.parameter import Parameter, ParameterAnswer
    from zsight_protocol.recording import PlayerState, RecorderState

__all__ = ["AsyncCatalog", "AsyncParameters", "AsyncPlayer", "AsyncRecorder"]


class AsyncCatalog:
    """The object types that the finders of a cell know."""

    def __init__(self, catalog: Catalog) -> None:
        """Args: the catalogue that does the work."""
        self._catalog = catalog

    async def list(self) -> list[ObjectType]:
        """All types."""
        return await asyncio.to_thread(self._catalog.list)

    async def get(self, name: str, version: int | None = None) -> ObjectType:
        """One type by name or number, as it is or as it was in some version."""
        return await asyncio.to_thread(self._catalog.get, name, version)

    async def derived(self, name: str) -> Derived:
        """What follows from the shape of a type."""
        return await asyncio.to_thread(self._catalog.derived, name)

    async def add(self, kind: ObjectType, mesh: bytes = b"") -> str:
        """Add a type to every finder, or change the one of its name; what they say."""
        return await asyncio.to_thread(self._catalog.add, kind, mesh)

    async def teach(self, name: str, **lesson: Unpack[Lesson]) -> tuple[ObjectType, Taught]:
        """Make a type of a thing that stands before a camera, and add it to every finder."""
        return await asyncio.to_thread(lambda: self._catalog.teach(name, **lesson))

    async def remove(self, name: str) -> str:
        """Remove a type from every finder that knows it; what they say."""
        return await asyncio.to_thread(self._catalog.remove, name)


class AsyncParameters:
    """The settings of running processes; ParameterClient tells arguments and errors."""

    def __init__(self, parameters: ParameterClient) -> None:
        """Args: the client that does the work."""
        self._parameters = parameters

    async def list(self, process: str = "*") -> builtins.list[ParameterAnswer]:
        """The settings of every process of that name, or of all."""
        return await asyncio.to_thread(self._parameters.list, process)

    async def get(self, process: str, name: str) -> Parameter:
        """One setting as it is now."""
        return await asyncio.to_thread(self._parameters.get, process, name)

    async def set(self, process: str, name: str, value: JsonValue, *, save: bool = False) -> ParameterAnswer:
        """Change one setting, and keep it over a restart where asked."""
        return await asyncio.to_thread(lambda: self._parameters.set(process, name, value, save=save))


class AsyncRecorder:
    """A recorder; RecorderClient tells arguments and errors."""

    def __init__(self, recorder: RecorderClient) -> None:
        """Args: the client that does the work."""
        self._recorder = recorder

    async def start(self, path: str = "", keys: tuple[str, ...] = ()) -> RecorderState:
        """Begin a recording on the recorder's host."""
        return await asyncio.to_thread(self._recorder.start, path, keys)

    async def stop(self) -> RecorderState:
        """End the recording; once this returns, the file is whole."""
        return await asyncio.to_thread(self._recorder.stop)

    async def trigger(self) -> RecorderState:
        """Write the seconds that are kept in memory, and those that follow."""
        return await asyncio.to_thread(self._recorder.trigger)

    async def status(self) -> RecorderState:
        """How it stands."""
        return await asyncio.to_thread(self._recorder.status)


class AsyncPlayer:
    """A player; PlayerClient tells arguments and errors."""

    def __init__(self, player: PlayerClient) -> None:
        """Args: the client that does the work."""
        self._player = player

    async def open(self, path: str) -> PlayerState:
        """Open a recording on the player's host."""
        return await asyncio.to_thread(self._player.open, path)

    async def play(self) -> PlayerState:
        """Go on."""
        return await asyncio.to_thread(self._player.play)

    async def pause(self) -> PlayerState:
        """Stand still."""
        return await asyncio.to_thread(self._player.pause)

    async def step(self) -> PlayerState:
        """Send the next message, and stand still."""
        return await asyncio.to_thread(self._player.step)

    async def seek(self, position: float) -> PlayerState:
        """Go to a place, seconds from the beginning: what was in force there has been sent when this returns."""
        return await asyncio.to_thread(self._player.seek, position)

    async def set_rate(self, rate: float) -> PlayerState:
        """Play so many times as fast as it was recorded."""
        return await asyncio.to_thread(self._player.set_rate, rate)

    async def set_loop(self, loop: bool) -> PlayerState:
        """Begin again after the end, or not."""
        return await asyncio.to_thread(self._player.set_loop, loop)

    async def status(self) -> PlayerState:
        """How it stands."""
        return await asyncio.to_thread(self._player.status)
