"""Clouds at a camera's rate to three readers, one of them slow, and requests, for minutes: what is lost, what grows.

python soak.py --minutes 10              as long as it is to hold
python soak.py --minutes 0.3 --burners 8     beside eight processes that burn processor time
"""

from __future__ import annotations

import argparse
import json
import time
from contextlib import ExitStack
from typing import Any

import numpy as np
from bench_row import print_rows, row
from bus_processes import Member, asker, burner, cell, member, reader, router, server, writer
from progress import tell

_RATE = 30.0
_SLOW = 0.3  # seconds that the slow reader works on each cloud
_WARM = 60.0  # seconds before the first look at memory; a fifth of a shorter soak
_LOOK = 2.0  # seconds between two looks at the figures
_WORD = 10.0  # seconds between two lines on stderr
_CALM = 10  # clouds of which one was looked at before the next came, whose surplus is exact


def run(minutes: float = 10.0, burners: int = 0) -> list[dict[str, Any]]:
    """Rows as ``zsight bench --json`` prints them; a line every ten seconds on stderr meanwhile.

    Args:
        minutes: to soak.
        burners: processes that burn processor time meanwhile.
    """
    network = cell()
    seconds = minutes * 60
    with ExitStack() as stack:
        members = {"router": stack.enter_context(member(router, network))}
        members["camera"] = stack.enter_context(member(writer, network, _RATE, 480, 640))
        for name, work in (("fast reader", 0.0), ("other fast reader", 0.0), ("slow reader", _SLOW)):
            members[name] = stack.enter_context(member(reader, network, work))
        members["server"] = stack.enter_context(member(server, network))
        members["asker"] = stack.enter_context(member(asker, network))
        for _ in range(burners):
            stack.enter_context(member(burner))
        soak = _Soak(members)
        soak.watch(min(_WARM, seconds / 5))
        before = {name: m.resident() for name, m in members.items()}
        soak.watch(seconds - min(_WARM, seconds / 5))
        grown = {name: m.resident() - before[name] for name, m in members.items()}
    return _rows(soak, grown, burners)


class _Soak:
    """What the members told, collected while they run."""

    def __init__(self, members: dict[str, Member]) -> None:
        self._members = members
        self._told = time.monotonic()
        self.sent = self.asked = self.hung = self.unanswered = 0
        self.answered_ms: list[float] = []
        self.counts: dict[str, dict[str, Any]] = {}
        self.seen: dict[str, list[tuple[float, float, int]]] = {name: [] for name in members if "reader" in name}

    def watch(self, seconds: float) -> None:
        """Collect for so long."""
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0:
            time.sleep(min(_LOOK, left))
            self.sent = self._members["camera"].figures()[0]
            self.asked, self.hung, self.unanswered, new = self._members["asker"].figures()
            self.answered_ms += new
            for name in self.seen:
                self.counts[name], new = self._members[name].figures()
                self.seen[name] += new
            if time.monotonic() - self._told >= _WORD:
                self._tell()

    def _tell(self) -> None:
        self._told = time.monotonic()
        words = (f"{name} {c['received']} received, {c['lost']} lost" for name, c in self.counts.items())
        tell(f"{self.sent} sent; {'; '.join(words)}; {self.asked} asked, {self.hung} hang")


def _rows(soak: _Soak, grown: dict[str, int], burners: int) -> list[dict[str, Any]]:
    rows: list[dict[str, Any]] = []

    def add(name: str, value: float, unit: str, target: float | None, **more: Any) -> None:
        rows.append(row(name, value, unit, target, **more))

    for name, counts in soak.counts.items():
        fates = {kind: counts[kind] for kind in ("received", "superseded", "lost", "late", "refused")}
        target = 0 if "fast" in name and not burners else None
        add(f"{name}: lost", fates["lost"], f"of {soak.sent} clouds", target, **fates)
        # Beside burners losses are legal, but each must be counted.
        surplus = [surplus for _, _, surplus in soak.seen[name]]
        add(f"{name}: lost and not counted", max(min(surplus[:_CALM]) - min(surplus[-_CALM:]), 0), "clouds", 0)
        p50, p99 = np.percentile([age for _, age, _ in soak.seen[name]], [50, 99])
        add(f"{name}: age of a cloud, median", float(p50), "ms", None, p99=round(float(p99), 2))
    add("requests without an end", soak.hung, f"of {soak.asked}", 0)
    add("requests without an answer", soak.unanswered, f"of {soak.asked}", None)
    add("longest request", max(soak.answered_ms), "ms", None)
    for name, size in grown.items():
        add(f"{name}: growth of its memory", size / 2**20, "MiB", 2.0)
    return rows


def main() -> None:
    """Print the rows."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", action="store_true", help="one JSON object on stdout")
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--burners", type=int, default=0)
    arguments = parser.parse_args()
    rows = run(arguments.minutes, arguments.burners)
    if arguments.json:
        print(json.dumps({"rows": rows}))
        return
    print_rows(rows)


if __name__ == "__main__":
    main()
