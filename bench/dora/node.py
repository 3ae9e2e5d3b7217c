"""Camera -> voxel -> sink with dora's Python nodes, the work that bench/chain.py measures: ``python node.py ROLE``.

The folder above must be on PYTHONPATH, and zsight_core for the voxel grid. CHAIN_CLOUD names the cloud (.npy).
"""

from __future__ import annotations

import os
import sys
import time

import numpy as np
import pyarrow as pa
from dora import Node
from latencies import Latencies


def main(role: str) -> None:
    node, points = Node(), np.load(os.environ["CHAIN_CLOUD"])
    latencies = Latencies()
    if role == "voxel":
        from zsight_core.voxel_grid import voxel_grid, warm_up

        warm_up()
    for event in node:
        if event["type"] == "STOP":
            return
        if event["type"] != "INPUT":
            continue
        if role == "camera":
            node.send_output("points", pa.array(points.reshape(-1).view(np.uint8)), {"stamp": str(time.time_ns())})
            continue
        stamp = event["metadata"]["stamp"]
        cloud = event["value"].to_numpy().view(points.dtype)
        if role == "voxel":
            smaller = voxel_grid(cloud.reshape(points.shape), 0.02)
            node.send_output("voxel", pa.array(smaller.reshape(-1).view(np.uint8)), {"stamp": stamp})
        else:
            latencies.add(int(stamp))


if __name__ == "__main__":
    main(sys.argv[1])
