"""Whether the finder answers the same after a seek as in a straight run: 200 random places of a recording of 60 s.

A camera that turns slowly sees the block at another place each second; player and finder are those that users run, on a
bus in memory. The straight run goes through the recording message by message.
"""

from __future__ import annotations

import random
import tempfile
import threading
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from bench_row import row
from progress import tell

from zsight import finder
from zsight.bus import Bus
from zsight.bus.attachment import Attachment
from zsight.bus.memory_link import MemoryLink, MemoryNetwork
from zsight.client import CellClient
from zsight.convert import cloud_from_points, stamped
from zsight.recording.player import Player
from zsight.recording.player import Settings as PlayerSettings
from zsight.recording.recording_file import RecordingFile
from zsight.recording.sample import Sample
from zsight_core.model import Box, ObjectModel, Surface
from zsight_core.pinhole import Pinhole
from zsight_core.simulation.camera import capture
from zsight_core.simulation.world import Body, Camera, World
from zsight_core.transform import from_quaternion, from_rpy
from zsight_protocol.channels import Cell
from zsight_protocol.codec import encode
from zsight_protocol.geometry import TransformList
from zsight_protocol.message import Time
from zsight_protocol.recording import PlayerRequest

if TYPE_CHECKING:
    from collections.abc import Iterator

    from zsight_protocol.find_object import FindObjectResult
    from zsight_protocol.message import Message

CELL = Cell("cell")
SECONDS, SEEKS = 60, 200
BEGIN = 1_700_000_000_000_000_000
TABLE_HEIGHT = 0.7747
FRAME = "optical"
PATIENCE = 60.0


def run() -> list[dict[str, Any]]:
    """All rows."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "minute.mcap"
        record(path)
        same, found = compare(path)
    return [
        row("straight run: answers with the block", found, f"of {SECONDS}", SECONDS, least=True),
        row("seeks after which the finder answers the same", same, f"of {SEEKS}", SEEKS, least=True),
    ]


def record(path: Path) -> None:
    """A cloud and the camera's pose each second."""
    file = RecordingFile(path, CELL.namespace, {})
    for number in range(SECONDS):
        at = BEGIN + number * 1_000_000_000
        T, points = view(number)
        pose = TransformList(transforms=(stamped(T, "world", FRAME, Time.from_ns(at)),))
        write(file, CELL.tf, pose, 1, number, at)
        write(file, CELL.points("kinect"), cloud_from_points(points, Time.from_ns(at), FRAME), 2, number, at + 1000)
        file.mcap.close_chunk("lz4")
    file.finish()


def write(file: RecordingFile, key: str, message: Message, writer: int, number: int, at: int) -> None:
    file.write(Sample(key, encode(message), Attachment(writer, number + 1, at), at))


def view(number: int) -> tuple[Any, Any]:
    """Where the camera stands at a second, and what it sees."""
    T_world_camera = from_rpy((0.027, 0.002 * number, 1.81), (0, 1.2, 0)) @ from_quaternion(
        (0, 0, 0), (-0.5, 0.5, -0.5, 0.5)
    )
    block = ObjectModel("toy_block", Box((0.035, 0.2, 0.035)))
    table = from_rpy((0.756, -0.289, TABLE_HEIGHT - 0.02), (0, 0, 0))
    place = from_rpy((0.45 + 0.004 * number, -0.3, TABLE_HEIGHT + 0.0175), (0, 0, 0.1 * number))
    world = World((
        Body("ground", ObjectModel("ground", Surface()), np.eye(4)),
        Body("top", ObjectModel("top", Box((0.9, 0.9, 0.04))), table),
        Body("toy_block", block, place),
    ))  # fmt: skip
    camera = Camera(Pinhole(640, 480, 554.38, 554.38, 319.5, 239.5), T_world_camera)
    return T_world_camera, capture(world, camera, None, number)


def compare(path: Path) -> tuple[int, int]:
    """After how many seeks the answer was that of the straight run, and in how many of its answers the block was."""
    network = MemoryNetwork()

    def join() -> Bus:
        return Bus(MemoryLink(network), CELL)

    player, client = Player(join(), PlayerSettings(paused=True)), CellClient(join())
    with finding(join()):
        player.open(str(path))
        straight: dict[int, FindObjectResult] = {}
        for number in range(SECONDS):
            player.do(PlayerRequest(action="step"))
            player.do(PlayerRequest(action="step"))
            straight[number] = answer(client, number)
            if number % 20 == 0:
                tell(f"straight run: {number} of {SECONDS}")
        chance, same = random.Random(1), 0  # noqa: S311
        for seek in range(SEEKS):
            position = chance.uniform(0.001, SECONDS - 1)
            player.do(PlayerRequest(action="seek", position=position))
            same += seen(answer(client, int(position))) == seen(straight[int(position)])
            if seek % 50 == 0:
                tell(f"seeks: {seek} of {SEEKS}")
    player.close()
    return same, sum(bool(result.objects) for result in straight.values())


def answer(client: CellClient, number: int) -> FindObjectResult:
    """The answer from the cloud of a second, which the finder may not have taken yet."""
    wanted = BEGIN + number * 1_000_000_000
    for _ in range(1000):
        result = client.find("toy_block", timeout=PATIENCE)
        if result.header.stamp.ns == wanted:
            return result
    raise TimeoutError(f"the finder did not take the cloud of second {number}")


def seen(result: FindObjectResult) -> list[Any]:
    """What was found, without the names that tell a thing from others in the finder's memory."""
    return [found.model_copy(update={"id": ""}) for found in result.objects]


@contextmanager
def finding(bus: Bus) -> Iterator[None]:
    """A finder at work until the end of the block."""
    ready = threading.Event()
    bus.on_ready = ready.set
    thread = threading.Thread(target=finder.run, args=(bus, finder.Settings(oldest=30.0)))
    thread.start()
    try:
        ready.wait(PATIENCE)
        yield
    finally:
        bus.stop()
        thread.join()
