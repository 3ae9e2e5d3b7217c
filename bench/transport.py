"""The bus beside other systems: one hop, a chain at a camera's rate, many readers, many writers, many sizes.

Systems take turns within one run, because absolute times of a shared machine wander; ratios are of medians, their
spread that of the pairs or turns. ``python transport.py --json | python transport_pictures.py FOLDER`` draws growth.
"""

from __future__ import annotations

import argparse
import json
from typing import TYPE_CHECKING, Any

import numpy as np
from bench_clouds import DATA, synthetic
from chain import measure as measure_chain
from one_hop import measure as measure_hop
from progress import tell

if TYPE_CHECKING:
    from chain import Figures
    from numpy.typing import NDArray

    from zsight_core.points import Points

READERS = (1, 2, 4)
SIZES = ((120, 160), (480, 640), (720, 1280))
CHAIN_TARGETS = {"bare zenoh": 1.3, "roscpp": 0.5, "dora-rs": 0.4}

Row = dict[str, Any]


def run(clouds: int = 80, seconds: float = 3.0, turns: int = 3) -> list[Row]:
    """Measure everything, in three to five minutes on two cores; says on stderr how far it is.

    Args:
        clouds: that go through each system of a hop.
        seconds: that a turn of a chain is measured.
        turns: of each chain at 640 x 480; one fewer at 1280 x 720.

    Returns:
        Rows as ``zsight bench --json`` prints them: value is ours, ratio ours by the peer's.
    """
    table, wide = table_scene(), synthetic()
    rows = _hop("one hop 640x480", table, clouds, 1.2)
    rows += _hop("one hop 1280x720", wide, clouds // 2)
    rows += growth(clouds // 3)
    rows += _hop("4 writers to 1 reader 640x480", table, clouds // 2, writers=4)
    rows += chain_rows("chain 640x480", measure_chain(table, seconds=seconds, turns=turns), CHAIN_TARGETS)
    return rows + chain_rows("chain 1280x720", measure_chain(wide, seconds=seconds, turns=max(turns - 1, 1)), {})


def _hop(name: str, points: Points, clouds: int, target: float | None = None, **ends: int) -> list[Row]:
    tell(name)
    return hop_rows(name, measure_hop(points, clouds, **ends), target)


def table_scene() -> Points:
    """A real cloud of a table, 640 x 480; the synthetic one where the recordings are not there."""
    from zsight_core.files import pcd
    from zsight_core.pack_fields import to_packed

    file = DATA / "mosd_learn" / "learn0.pcd"
    return to_packed(pcd.read(file).points) if file.exists() else synthetic(640, 480)


def growth(clouds: int) -> list[Row]:
    """How a hop grows with the number of readers and with the size of the cloud."""
    rows: list[Row] = []
    for readers in READERS:
        rows += _hop(f"1 writer to {readers} readers 640x480", table_scene(), clouds, readers=readers)
    for height, width in SIZES:
        rows += _hop(f"one hop of {16e-6 * height * width:.1f} MB", synthetic(width, height), clouds)
    return rows


def hop_rows(name: str, times: dict[str, NDArray[np.float64]], target: float | None) -> list[Row]:
    """Median and 99th percentile until the last reader can use the array, and what did not come."""
    last = {system: values.max(axis=1) for system, values in times.items()}  # NaN where any reader missed it
    lost = {system: int(np.isnan(values).sum()) for system, values in times.items()}
    ours = last["zsight"]
    rows = []
    for peer in ("bare zenoh", "floor"):
        pairs = ours / last[peer]
        for share, word in ((50, "p50"), (99, "p99")):
            value, other = (float(np.nanpercentile(v, share)) for v in (ours, last[peer]))
            row = _row(f"{name} {word}", value, "ms", peer, other, target if word == "p50" else None)
            rows.append(row | {"spread": [round(float(v), 2) for v in np.nanpercentile(pairs, [10, 90])], "lost": lost})
    return rows


def chain_rows(name: str, figures: dict[str, Figures], targets: dict[str, float]) -> list[Row]:
    """Median, 99th percentile, CPU of all processes and losses, beside each peer."""
    ours = figures["zsight"]
    rows = []
    for peer, theirs in figures.items():
        if peer == "zsight":
            continue
        for word, value, other, unit in _measures(ours, theirs):
            target = targets.get(peer) if word == "p50" else None
            row = _row(f"{name} {word}", value, unit, peer, other, target)
            if word == "p50" and not theirs.reason and len(theirs.medians) == len(ours.medians):
                ratios = np.array(ours.medians) / np.array(theirs.medians)
                row["spread"] = [round(float(ratios.min()), 2), round(float(ratios.max()), 2)]
            rows.append(row | ({"reason": theirs.reason or ours.reason} if theirs.reason or ours.reason else {}))
    return rows


def _measures(ours: Figures, theirs: Figures) -> list[tuple[str, float | None, float | None, str]]:
    def percentile(figures: Figures, share: float) -> float | None:
        return float(np.percentile(figures.latencies, share)) if figures.latencies else None

    def load(figures: Figures) -> float | None:
        return 100 * figures.cpu / figures.seconds if figures.seconds else None

    return [
        ("p50", percentile(ours, 50), percentile(theirs, 50), "ms"),
        ("p99", percentile(ours, 99), percentile(theirs, 99), "ms"),
        ("CPU", load(ours), load(theirs), "% of a core"),
        ("lost", ours.lost, theirs.lost if not theirs.reason else None, f"of {len(ours.latencies)} clouds"),
    ]


def _row(name: str, value: float | None, unit: str, peer: str, other: float | None, target: float | None) -> Row:
    ratio = value / other if value is not None and other else None
    return {
        "name": name,
        "value": None if value is None else round(value, 3),
        "unit": unit,
        "peer": peer,
        "peer_value": None if other is None else round(other, 3),
        "ratio": None if ratio is None else round(ratio, 3),
        "target": target,
        "holds": None if target is None or ratio is None else ratio <= target,
    }


def markdown(rows: list[Row]) -> str:
    """The rows as a table."""
    lines = ["| what | ours | peer | its | ratio | spread | target | holds |", "|---|---|---|---|---|---|---|---|"]
    for row in rows:
        ours, theirs, ratio = ("-" if row[k] is None else f"{row[k]:.3g}" for k in ("value", "peer_value", "ratio"))
        spread = " to ".join(map(str, row["spread"])) if "spread" in row else ""
        target = "" if row["target"] is None else f"<= {row['target']}"
        verdict = {True: "yes", False: "no", None: row.get("reason", "")}[row["holds"]]
        cells = [f"{row['name']}, {row['unit']}", ours, row["peer"], theirs, ratio, spread, target, verdict]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def main() -> None:
    """Print the rows as JSON or as a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", action="store_true", help="one JSON object on stdout")
    arguments = parser.parse_args()
    rows = run()
    print(json.dumps({"rows": rows}) if arguments.json else markdown(rows))


if __name__ == "__main__":
    main()
