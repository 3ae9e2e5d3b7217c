"""A reader that stands still (SIGSTOP) for some seconds, while a camera goes on and others read."""

from __future__ import annotations

import argparse
import json
import os
import signal
import time
from contextlib import ExitStack
from typing import Any

import numpy as np
from bench_row import print_rows, row
from bus_processes import Member, burner, cell, member, reader, router, writer

_SETTLE = 2.0  # seconds before and after


def run(stalled: float = 5.0, rate: float = 30.0, burners: int = 0) -> list[dict[str, Any]]:
    """Rows as ``zsight bench --json`` prints them, beside so many processes that burn processor time."""
    network = cell()
    with ExitStack() as stack:
        hub = stack.enter_context(member(router, network))
        camera = stack.enter_context(member(writer, network, rate, 480, 640))
        other = stack.enter_context(member(reader, network, 0.0))
        victim = stack.enter_context(member(reader, network, 0.0))
        for _ in range(burners):
            stack.enter_context(member(burner))
        time.sleep(_SETTLE)
        camera.figures()  # of these puts one made the ring
        time.sleep(_SETTLE)
        before = [m.figures() for m in (camera, other, victim)]
        os.kill(victim.pid, signal.SIGSTOP)
        time.sleep(stalled / 3)
        memory = [m.resident() + m.shared() for m in (hub, camera, other)]
        time.sleep(stalled - stalled / 3)
        during = camera.figures()
        grown = [m.resident() + m.shared() - was for m, was in zip((hub, camera, other), memory, strict=True)]
        woken = time.time()
        os.kill(victim.pid, signal.SIGCONT)
        time.sleep(_SETTLE)
        return _rows(before, during, woken, grown, (camera, other, victim))


def _rows(
    before: list[Any], during: Any, woken: float, grown: list[int], members: tuple[Member, Member, Member]
) -> list[dict[str, Any]]:
    camera, other, victim = (m.figures() for m in members)
    ages = [age for when, age, _ in victim[1] if when >= woken]
    sent = camera[0] - before[0][0]
    got = {kind: other[0][kind] - before[1][0][kind] for kind in ("received", "superseded", "lost", "late", "refused")}
    slow = {kind: victim[0][kind] - before[2][0][kind] for kind in got}
    figures = [
        ("put p99 while all readers run", float(np.percentile(before[0][1], 99)), "ms", None),
        ("put p99 while a reader stands still", float(np.percentile(during[1], 99)), "ms", 15.0),
        ("longest put while a reader stands still", max(during[1]), "ms", None),
        ("clouds that another reader lost", float(got["lost"] + got["refused"]), f"of {sent}", 0.0),
        ("age of the first cloud after SIGCONT", ages[0], "ms", 100.0),
        ("oldest cloud after SIGCONT", max(ages), "ms", 100.0),
        ("growth of router, camera or other reader in the last two thirds", max(grown) / 2**20, "MiB", 2.0),
    ]
    return [row(*figure, other=got, stopped=slow) for figure in figures]


def main() -> None:
    """Print the rows."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", action="store_true", help="one JSON object on stdout")
    parser.add_argument("--stalled", type=float, default=5.0, help="seconds that the reader stands still")
    parser.add_argument("--rate", type=float, default=30.0, help="clouds a second")
    parser.add_argument("--burners", type=int, default=0, help="processes that burn processor time meanwhile")
    arguments = parser.parse_args()
    rows = run(arguments.stalled, arguments.rate, arguments.burners)
    if arguments.json:
        print(json.dumps({"rows": rows}))
        return
    print_rows(rows)
    print(rows[0]["other"], rows[0]["stopped"])


if __name__ == "__main__":
    main()
