"""A process that records until it is killed, and says how far everything is safe; see test_crash.py."""

from __future__ import annotations

import sys
import time
from pathlib import Path

from tests.services.recordings import cloud, sample, transform

from zsight.recording.disk_writer import DiskPolicy, DiskWriter


def main(path: str, compression: str, rows: int) -> None:
    writer = DiskWriter(Path(path), "cell", {}, DiskPolicy(compression=compression), in_force=[])
    picture = cloud(1, size=(rows, 64))
    told, number = 0, 0
    while True:
        now = time.time_ns()
        number += 1
        writer.put(sample("cell/tf", transform(number), now, sequence=number))
        writer.put(sample("cell/kinect/points", picture, now + 1, sequence=number, writer=8))
        if writer.safe_ns != told:
            told = writer.safe_ns
            print(told, number, time.time_ns(), flush=True)
        time.sleep(0.002)  # a stream that comes so often; nothing waits for it


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], int(sys.argv[3]))
