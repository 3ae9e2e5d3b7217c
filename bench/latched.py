"""How soon a reader that comes late has the value that was latched before, from process to process."""

from __future__ import annotations

import argparse
import json
import time
from contextlib import ExitStack
from typing import TYPE_CHECKING, Any

import numpy as np
from bench_row import print_rows, row
from bus_processes import cell, member, router

if TYPE_CHECKING:
    from multiprocessing.connection import Connection

    from zsight.network import Network

_TARGET = 50.0  # milliseconds
_PATIENCE = 5.0  # seconds


def run(tries: int = 30) -> list[dict[str, Any]]:
    """Rows as ``zsight bench --json`` prints them; every try is a session of its own that has joined before."""
    from zsight.runtime import join
    from zsight_protocol.geometry import TransformList

    network = cell()
    times = []
    with ExitStack() as stack:
        stack.enter_context(member(router, network))
        stack.enter_context(member(latch, network))
        for _ in range(tries):
            with join(network) as bus:
                begin = time.perf_counter()
                received = bus.reader(bus.cell.tf_static, TransformList).take(_PATIENCE)
                times.append((time.perf_counter() - begin) * 1e3)
                if received is None:
                    raise TimeoutError(f"no latched value came within {_PATIENCE:g} s")
    figures = [("median", float(np.median(times)), None), ("longest", max(times), _TARGET)]
    return [row(f"late reader has a latched value, {word}", value, "ms", target) for word, value, target in figures]


def latch(pipe: Connection, network: Network) -> None:
    """Latches a transform and stays."""
    from zsight.runtime import join
    from zsight_protocol.geometry import Transform, TransformList, TransformStamped
    from zsight_protocol.message import Header

    bus = join(network)
    step = TransformStamped(header=Header(frame_id="base_link"), child_frame_id="camera", transform=Transform())
    bus.writer(bus.cell.tf_static, TransformList).send(TransformList(transforms=(step,)))
    pipe.send("ready")
    time.sleep(1e6)


def main() -> None:
    """Print the rows."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", action="store_true", help="one JSON object on stdout")
    arguments = parser.parse_args()
    rows = run()
    if arguments.json:
        print(json.dumps({"rows": rows}))
        return
    print_rows(rows)


if __name__ == "__main__":
    main()
