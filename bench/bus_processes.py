"""A cell of processes that write and read clouds and tell what they saw, for soaking and stalling the bus."""

from __future__ import annotations

import multiprocessing
import threading
import time
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from one_hop import free_endpoint

if TYPE_CHECKING:
    from collections.abc import Iterator
    from multiprocessing.connection import Connection
    from multiprocessing.process import BaseProcess

    from zsight.bus import RawRequest
    from zsight.network import Network

CAMERA = "kinect"
_START = 60.0  # seconds for a process to start on a busy machine
_ANSWER = 30.0  # seconds for a process to tell its figures
_PATIENCE = 10.0  # seconds within which a request must end


@dataclass(frozen=True)
class Member:
    """One process of the cell."""

    process: BaseProcess
    pipe: Connection

    @property
    def pid(self) -> int:
        """Its number."""
        return int(self.process.pid or 0)

    def resident(self) -> int:
        """Its own memory in use, bytes: without what it shares, such as clouds in shared memory."""
        words = Path(f"/proc/{self.pid}/statm").read_text(encoding="ascii").split()
        return (int(words[1]) - int(words[2])) * 4096

    def shared(self) -> int:
        """Shared memory that it maps and has touched, bytes."""
        for line in Path(f"/proc/{self.pid}/status").read_text(encoding="ascii").splitlines():
            if line.startswith("RssShmem:"):
                return int(line.split()[1]) * 1024
        return 0

    def figures(self) -> Any:
        """What it saw since it was asked last."""
        self.pipe.send("figures")
        if not self.pipe.poll(_ANSWER):
            raise TimeoutError(f"process {self.pid} does not tell its figures within {_ANSWER:g} s")
        return self.pipe.recv()


def cell() -> Network:
    """A network of its own."""
    from zsight.network import Network

    return Network(namespace="bench").on(free_endpoint())


@contextmanager
def member(target: Any, *arguments: Any) -> Iterator[Member]:
    """A process that has said that it is ready; it is killed with the block."""
    context = multiprocessing.get_context("spawn")
    here, there = context.Pipe()
    process = context.Process(target=target, args=(there, *arguments), daemon=True)
    process.start()
    try:
        if not here.poll(_START):
            raise TimeoutError(f"{target.__name__} did not start within {_START:g} s")
        here.recv()
        yield Member(process, here)
    finally:
        process.kill()
        process.join()


def router(pipe: Connection, network: Network) -> None:
    """The router of the cell."""
    from zsight.bus.zenoh_link import open_router

    _router = open_router(network)
    pipe.send("ready")
    time.sleep(1e6)


def writer(pipe: Connection, network: Network, rate: float, height: int, width: int) -> None:
    """Sends clouds at a rate; tells how many, and how long each send took (ms)."""
    from zsight.convert import cloud_from_points
    from zsight.runtime import join
    from zsight_core.points import XYZRGB
    from zsight_protocol.message import Time
    from zsight_protocol.point_cloud import PointCloud2

    points = np.zeros((height, width), XYZRGB)
    puts: list[float] = []
    bus = join(network)
    sender = bus.writer(bus.cell.points(CAMERA), PointCloud2)
    _tell(pipe, lambda: (sender.counter.sent, [puts.pop(0) for _ in range(len(puts))]))
    due = time.monotonic()
    while True:
        time.sleep(max(due - time.monotonic(), 0.0))
        due = max(due + 1 / rate, time.monotonic())
        begin = time.perf_counter()
        sender.send(cloud_from_points(points, Time.now(), "camera"))
        puts.append((time.perf_counter() - begin) * 1e3)


def reader(pipe: Connection, network: Network, work: float) -> None:
    """Takes clouds, works seconds on each; tells its counts, and of each cloud when it was taken, its age and surplus.

    Times are in seconds, ages in milliseconds. The surplus is what was counted so far less the cloud's number. It stays
    as it is, unless something goes by uncounted: then it falls.
    """
    from zsight.convert import points_of
    from zsight.runtime import join
    from zsight_protocol.point_cloud import PointCloud2

    seen: list[tuple[float, float, int]] = []
    bus = join(network)
    clouds = bus.reader(bus.cell.points(CAMERA), PointCloud2)
    _tell(pipe, lambda: (clouds.counter.health().model_dump(), [seen.pop(0) for _ in range(len(seen))]))
    while (received := clouds.take()) is not None:
        counter = clouds.counter
        counted = counter.received + counter.superseded + counter.lost + counter.refused
        points_of(received.message)
        now = time.time_ns()
        number = received.attachment.sequence if received.attachment is not None else 0
        seen.append((now / 1e9, (now - received.message.header.stamp.ns) / 1e6, counted - number))
        if work:
            time.sleep(work)


def server(pipe: Connection, network: Network) -> None:
    """Answers requests with what was asked."""
    from zsight.runtime import join

    def answer(request: RawRequest) -> None:
        request.reply(request.payload)
        request.close()

    bus = join(network)
    bus.serve(bus.cell.find_object("bench"), answer)
    pipe.send("ready")
    threading.Event().wait()


def asker(pipe: Connection, network: Network) -> None:
    """Asks ten times a second; tells how often, how many had no end or no answer, how long each took (ms)."""
    from zsight.runtime import join

    times: list[float] = []
    asked = hung = unanswered = 0
    bus = join(network)
    _tell(pipe, lambda: (asked, hung, unanswered, [times.pop(0) for _ in range(len(times))]))
    while True:
        begin = time.perf_counter()
        asked += 1
        replies = bus.ask(bus.cell.find_object("bench"), b"ping", _PATIENCE)
        try:
            unanswered += replies.take(_PATIENCE + 1) != b"ping"
        except TimeoutError:
            hung += 1
        replies.close()
        times.append((time.perf_counter() - begin) * 1e3)
        time.sleep(0.1)


def burner(pipe: Connection) -> None:
    """Burns processor time."""
    pipe.send("ready")
    while True:
        pass


def _tell(pipe: Connection, figures: Any) -> None:
    """Answer on a thread of its own, whenever asked."""

    def answer() -> None:
        while True:
            pipe.recv()
            pipe.send(figures())

    threading.Thread(target=answer, daemon=True).start()
    pipe.send("ready")
