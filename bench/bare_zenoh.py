"""Clouds through Zenoh's shared memory with nothing around it: the floor that our bus is measured against.

    python bare_zenoh.py camera|voxel|sink ENDPOINT CLOUD.npy [RATE]

Processes link directly, what travels are the bare bytes of the points, prepared beforehand; stamp, height and width
ride beside them. All work is done in Zenoh's own callback: there is no queue, no schema, no counting.
"""

from __future__ import annotations

import json
import struct
import sys
import time
from typing import TYPE_CHECKING, Any

import numpy as np
import zenoh
from zenoh import handlers, shm

if TYPE_CHECKING:
    from collections.abc import Callable

    from zsight_core.points import Points


def open_session(listen: str = "", connect: str = "") -> zenoh.Session:
    config = zenoh.Config()
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("listen/endpoints", json.dumps([listen] if listen else []))
    config.insert_json5("connect/endpoints", json.dumps([connect] if connect else []))
    return zenoh.open(config)


def writer(session: zenoh.Session, key: str, pool_bytes: int) -> Callable[[bytes, int, tuple[int, ...]], None]:
    publisher = session.declare_publisher(key, congestion_control=zenoh.CongestionControl.DROP)
    provider = shm.ShmProvider.default_backend(pool_bytes)

    def put(data: bytes, stamp_ns: int, shape: tuple[int, ...]) -> None:
        try:
            buffer = provider.alloc(len(data), shm.GarbageCollect())
        except zenoh.ZError:
            return  # all buffers are on their way: this one is lost
        buffer[0 : len(data)] = data
        publisher.put(buffer, attachment=struct.pack("<QII", stamp_ns, *shape))

    return put


def reader(session: zenoh.Session, key: str, dtype: np.dtype[Any], take: Callable[[Points, int], None]) -> object:
    def arrived(sample: zenoh.Sample) -> None:
        data, shared = sample.payload.to_bytes(), sample.payload.as_shm()
        if sample.attachment is not None and (shared is None or shared.is_valid()):
            stamp_ns, height, width = struct.unpack("<QII", sample.attachment.to_bytes())
            take(np.frombuffer(data, dtype).reshape(height, width), stamp_ns)

    return session.declare_subscriber(key, handlers.Callback(arrived, indirect=False))


def main(role: str, endpoint: str, file: str, rate: float = 30.0) -> None:
    points: Points = np.load(file)
    pool = max(64 << 20, 6 * points.nbytes)
    session = open_session(listen=endpoint) if role == "voxel" else open_session(connect=endpoint)
    if role == "camera":
        put, data, due = writer(session, "points", pool), points.tobytes(), time.monotonic()
        while True:
            time.sleep(max(due - time.monotonic(), 0.0))
            due = max(due + 1 / rate, time.monotonic())
            put(data, time.time_ns(), points.shape)
    elif role == "voxel":
        from zsight_core.voxel_grid import voxel_grid, warm_up

        warm_up()
        put = writer(session, "voxel", pool)

        def downsample(cloud: Points, stamp_ns: int) -> None:
            smaller = voxel_grid(cloud, 0.02)
            put(smaller.tobytes(), stamp_ns, smaller.shape)

        _reader = reader(session, "points", points.dtype, downsample)
    else:
        from latencies import Latencies

        latencies = Latencies()
        _reader = reader(session, "voxel", points.dtype, lambda _, stamp_ns: latencies.add(stamp_ns))
    while True:
        time.sleep(60)


if __name__ == "__main__":
    main(*sys.argv[1:4], *map(float, sys.argv[4:]))  # type: ignore[call-arg]  # three words, then the rate
