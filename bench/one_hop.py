"""One hop of a cloud from process to process until its array can be used: our bus and bare Zenoh, taking turns.

One process writes through all, a cloud here, a cloud there, so that all meet the same disturbances. Ours goes the way
of every deployment, through a router process; the bare one has a direct link. Both begin with an array and end with
one; the floor is the bare one once more, given bytes prepared beforehand, which spares it one of its three copies.
"""

from __future__ import annotations

import multiprocessing
import socket
import time
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterator
    from multiprocessing.connection import Connection

    from numpy.typing import NDArray

    from zsight.network import Network
    from zsight_core.points import Points

_START = 20.0  # seconds for a process to start
_WAIT = 1.0  # seconds for a cloud to come; one that does not is lost


def free_endpoint() -> str:
    """An endpoint of this host that nobody listens on."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


def measure(
    points: Points, clouds: int, *, readers: int = 1, writers: int = 1, gap: float = 1 / 60
) -> dict[str, NDArray[np.float64]]:
    """Latencies in milliseconds by system, shape (clouds, readers); NaN where a cloud did not come.

    Args:
        points: what travels.
        clouds: how many go through each system, after ten that do not count.
        readers: processes that read each cloud.
        writers: sessions that write in turn, to one key of the bus each.
        gap: seconds between two clouds.
    """
    from zsight.network import Network

    network = Network(namespace="bench").on(free_endpoint())
    with ExitStack() as stack:
        stack.enter_context(_process(_router, network))
        ours = _Ours(network, points, writers)
        stack.callback(ours.close)
        mine = [stack.enter_context(_process(_our_reader, network, writers)) for _ in range(readers)]
        systems: dict[str, Any] = {"zsight": (ours.send, mine)}
        for name in ("bare zenoh", "floor"):  # each with all its own: what one leaves warm is no help to another
            bare = _Bare(points, writers)
            stack.callback(bare.close)
            read = [_process(_bare_reader, bare.endpoint, points.dtype, writers) for _ in range(readers)]
            send = bare.send_array if name == "bare zenoh" else bare.send
            systems[name] = send, [stack.enter_context(reader) for reader in read]
        ours.wait_for_readers()
        time.sleep(0.3)
        times: dict[str, list[list[float]]] = {name: [] for name in systems}
        for number in range(clouds + 10):
            for name, (send, receivers) in systems.items():
                stamp = send(number % writers)
                arrived = [_arrival(pipe, stamp) for pipe in receivers]
                if number >= 10:
                    times[name].append([(there - stamp) / 1e6 for there in arrived])
                time.sleep(gap)
    return {name: np.array(rows) for name, rows in times.items()}


def _arrival(pipe: Connection, stamp: int) -> float:
    deadline = time.monotonic() + _WAIT
    while pipe.poll(max(deadline - time.monotonic(), 0)):
        came, there = pipe.recv()
        if came == stamp:
            return float(there)
    return float("nan")


@contextmanager
def _process(target: Any, *arguments: Any) -> Iterator[Connection]:
    """A spawned process that has said that it is ready; ends with the block."""
    context = multiprocessing.get_context("spawn")
    here, there = context.Pipe()
    process = context.Process(target=target, args=(there, *arguments), daemon=True)
    process.start()
    try:
        if not here.poll(_START):
            raise TimeoutError(f"{target.__name__} did not start within {_START:g} s")
        here.recv()
        yield here
    finally:
        process.kill()
        process.join()


def _router(pipe: Connection, network: Network) -> None:
    from zsight.bus.zenoh_link import open_router

    _router = open_router(network)
    pipe.send("ready")
    time.sleep(3600)


def _our_reader(pipe: Connection, network: Network, writers: int) -> None:
    from zsight.convert import points_of
    from zsight.runtime import join
    from zsight_protocol.channels import Delivery
    from zsight_protocol.point_cloud import PointCloud2

    with join(network) as bus:
        if writers == 1:
            reader = bus.reader(bus.cell.points("camera0"), PointCloud2)
        else:
            reader = bus.reader(f"{network.namespace}/*/points", PointCloud2, delivery=Delivery.LATEST)

        def usable(cloud: PointCloud2) -> tuple[int, int]:
            points = points_of(cloud)
            now = time.time_ns()
            assert points.size
            return cloud.header.stamp.ns, now

        pipe.send("ready")
        for times in map(usable, reader):  # like the bare one's callback it lets go of a cloud before the next comes
            pipe.send(times)


def _bare_reader(pipe: Connection, endpoint: str, dtype: np.dtype[Any], writers: int) -> None:
    from bare_zenoh import open_session, reader

    session = open_session(connect=endpoint)
    key = "camera0" if writers == 1 else "*"
    _reader = reader(session, key, dtype, lambda _, stamp: pipe.send((stamp, time.time_ns())))
    pipe.send("ready")
    time.sleep(3600)


class _Ours:
    def __init__(self, network: Network, points: Points, writers: int) -> None:
        from zsight.runtime import join
        from zsight_protocol.point_cloud import PointCloud2

        self._points = points
        self._buses = [join(network) for _ in range(writers)]
        self._writers = [bus.writer(bus.cell.points(f"camera{n}"), PointCloud2) for n, bus in enumerate(self._buses)]

    def wait_for_readers(self) -> None:
        while not all(writer.has_readers() for writer in self._writers):
            time.sleep(0.01)

    def send(self, writer: int) -> int:
        from zsight.convert import cloud_from_points
        from zsight_protocol.message import Time

        stamp = Time.now()
        self._writers[writer].send(cloud_from_points(self._points, stamp, "camera"))
        return stamp.ns

    def close(self) -> None:
        for bus in self._buses:
            bus.close()


class _Bare:
    def __init__(self, points: Points, writers: int) -> None:
        from bare_zenoh import open_session, writer

        self.endpoint = free_endpoint()
        self._session = open_session(listen=self.endpoint)
        self._points, self._data = points, points.tobytes()
        pool = max(64 << 20, 6 * len(self._data))
        self._writers = [writer(self._session, f"camera{n}", pool) for n in range(writers)]

    def send(self, writer: int) -> int:
        stamp = time.time_ns()
        self._writers[writer](self._data, stamp, self._points.shape)
        return stamp

    def send_array(self, writer: int) -> int:
        stamp = time.time_ns()
        self._writers[writer](self._points.tobytes(), stamp, self._points.shape)
        return stamp

    def close(self) -> None:
        self._session.close()
