"""The asyncio twins of the clients of services: the same methods, and they do the same."""

from __future__ import annotations

import asyncio
import inspect
from typing import TYPE_CHECKING

import pytest
from tests.services.recordings import START, cloud, sample
from tests.services.running import running

from zsight import voxel
from zsight.async_client import AsyncCellClient
from zsight.async_services import AsyncCatalog, AsyncParameters, AsyncPlayer, AsyncRecorder
from zsight.catalogue.client import Catalog
from zsight.client import CellClient
from zsight.errors import NobodyAnswers, RequestRefused
from zsight.parameter_client import ParameterClient
from zsight.parameters import Parameters, Saved, serve_parameters
from zsight.recording import player, recorder
from zsight.recording.recording_file import RecordingFile
from zsight.recording_client import PlayerClient, RecorderClient
from zsight_protocol.recording import Playing, Recording

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from zsight.bus import Bus

    Join = Callable[[], Bus]

TWINS = [
    (CellClient, AsyncCellClient),
    (Catalog, AsyncCatalog),
    (ParameterClient, AsyncParameters),
    (RecorderClient, AsyncRecorder),
    (PlayerClient, AsyncPlayer),
]
NOT_FOR_USERS = {"elsewhere"}  # what ``find`` of both twins needs


def methods(kind: type) -> dict[str, list[str]]:
    """The public methods of a class, each with the names of its arguments."""
    return {
        name: list(inspect.signature(method).parameters)
        for name, method in vars(kind).items()
        if inspect.isfunction(method) and not name.startswith("_") and name not in NOT_FOR_USERS
    }


@pytest.mark.parametrize(("kind", "twin"), TWINS)
def test_a_twin_has_the_same_methods_and_arguments(kind: type, twin: type) -> None:
    assert methods(twin) == methods(kind)


def test_the_twin_records_and_plays(join_memory: Join, tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    file = RecordingFile(path, "lab", {})
    for number in range(3):
        file.write(sample("lab/kinect/points", cloud(number), START + number * 1_000_000_000, writer=1))
    file.finish()

    async def use(client: AsyncCellClient) -> None:
        play, record = client.player(), client.recorder()
        assert (await play.open(str(path))).state is Playing.PAUSED
        assert (await play.seek(1.0)).position == 1.0
        assert (await play.set_rate(4.0)).rate == 4.0
        assert (await play.set_loop(True)).loop
        assert (await play.step()).sent > 0
        assert (await play.play()).state is Playing.PLAYING
        assert (await play.pause()).state is Playing.PAUSED
        assert (await play.status()).path == str(path)
        assert (await record.status()).state is Recording.IDLE
        assert (await record.start(str(tmp_path / "b.mcap"))).state is Recording.RECORDING
        with pytest.raises(RequestRefused):
            await record.trigger()
        assert (await record.stop()).state is Recording.IDLE

    playing, recording, test = join_memory(), join_memory(), join_memory()
    with (
        running(player.run, playing, player.Settings(paused=True)),
        running(recorder.run, recording, recorder.Settings(folder=str(tmp_path))),
    ):
        asyncio.run(use(AsyncCellClient(CellClient(test))))


def test_the_twin_reads_and_sets_settings(join_memory: Join) -> None:
    service, test = join_memory(), join_memory()
    settings = voxel.Settings()
    serve_parameters(service, "here", "voxel", "voxel", Parameters(settings, Saved("test", "voxel")))

    async def use(client: AsyncCellClient) -> None:
        (told,) = await client.parameters.list()
        assert (told.host, told.process) == ("here", "voxel")
        assert (await client.parameters.get("voxel", "leaf")).value == settings.leaf != 0.25
        answer = await client.parameters.set("voxel", "leaf", 0.25)
        assert answer.parameters[0].value == settings.leaf == 0.25
        with pytest.raises(NobodyAnswers):
            await client.parameters.get("nobody", "leaf")

    asyncio.run(use(AsyncCellClient(CellClient(test))))
