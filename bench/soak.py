"""Clouds at a camera's rate to three readers, one of them slow, for minutes: what is lost, what grows.

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
from bus_processes import burner, cell, member, reader, router, writer

_RATE = 30.0
_SLOW = 0.3  # seconds that the slow reader works on each cloud


def run(minutes: float = 10.0, burners: int = 0, warm: float | None = None) -> list[dict[str, Any]]:
    """Rows as ``zsight bench --json`` prints them.

    Args:
        minutes: to soak.
        burners: processes that burn processor time meanwhile.
        warm: seconds before the first look at memory; a minute, or a fifth of a shorter soak.
    """
    network = cell()
    seconds = minutes * 60
    with ExitStack() as stack:
        members = {"router": stack.enter_context(member(router, network))}
        members["camera"] = stack.enter_context(member(writer, network, _RATE, 480, 640))
        for name, work in (("fast reader", 0.0), ("other fast reader", 0.0), ("slow reader", _SLOW)):
            members[name] = stack.enter_context(member(reader, network, work))
        for _ in range(burners):
            stack.enter_context(member(burner))
        time.sleep(min(warm if warm is not None else 60.0, seconds / 5))
        before = {name: m.resident() for name, m in members.items()}
        started = members["camera"].figures()[0]
        ages: dict[str, list[Any]] = {name: [] for name in members}
        end = time.monotonic() + seconds - min(60.0, seconds / 5)
        while time.monotonic() < end:
            time.sleep(2.0)
            figures = {name: m.figures() for name, m in members.items() if name != "router"}
            for name, seen in figures.items():
                ages[name] += seen[1]
        grown = {name: m.resident() - before[name] for name, m in members.items()}
    return _rows(figures, ages, grown, figures["camera"][0] - started, burners)


def _rows(
    figures: dict[str, Any], ages: dict[str, list[Any]], grown: dict[str, int], sent: int, burners: int
) -> list[dict[str, Any]]:
    rows: list[dict[str, Any]] = []

    def add(name: str, value: float, unit: str, target: float | None, **more: Any) -> None:
        row = {"name": name, "value": round(value, 3), "unit": unit, "peer": None, "peer_value": None, "ratio": None}
        rows.append({**row, "target": target, "holds": None if target is None else value <= target, **more})

    for name, figure in figures.items():
        if name == "camera":
            continue
        counts, _, passed = figure
        fates = {kind: counts[kind] for kind in ("received", "superseded", "lost", "late", "refused")}
        target = 0 if "fast" in name and not burners else None
        add(f"{name}: lost", fates["lost"], f"of {passed} clouds", target, **fates)
        # Beside burners losses are legal, but each must be counted: the fates add up to what has passed.
        counted = sum(fates[kind] for kind in ("received", "superseded", "lost", "refused"))
        add(f"{name}: lost and not counted", max(passed - counted, 0), "clouds", 0)
        p50, p99 = np.percentile([age for _, age in ages[name]], [50, 99])
        add(f"{name}: age of a cloud, median", float(p50), "ms", None, p99=round(float(p99), 2))
    for name, size in grown.items():
        add(f"{name}: growth of its memory", size / 2**20, "MiB", 2.0, clouds=sent)
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
    for row in rows:
        print(f"{row['name']:44} {row['value']:10} {row['unit']:16} target {row['target']} {row['holds']}")
        print(
            "   ",
            {kind: row[kind] for kind in ("received", "superseded", "lost", "late", "refused", "p99") if kind in row},
        )


if __name__ == "__main__":
    main()
