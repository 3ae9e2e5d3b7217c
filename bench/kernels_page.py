"""Tables of docs/performance.md from what `zsight bench kernels --json` printed, on stdin."""

from __future__ import annotations

import json
import sys
from typing import Any

CLOUDS = ("mosd", "milk", "mug", "synthetic 1280x720")

Row = dict[str, Any]


def main(rows: list[Row]) -> None:
    """Print the tables one after the other."""
    split = [(row, *cut(row["name"])) for row in rows]
    table(
        ["kernel", *CLOUDS, "copies", "target", "holds"],
        [
            timed(name, found)
            for name, found in by_name(split, lambda row: row.get("peer") == "PCL" and "copies" in row)
        ],
    )
    table(
        ["kernel", "peer", *CLOUDS],
        [
            beside(name, found)
            for name, found in by_name(split, lambda row: row.get("peer") in ("Open3D", "small_gicp"))
        ],
    )
    table(
        ["difference from PCL", *CLOUDS, "target", "holds"],
        [
            differing(name, found)
            for name, found in by_name(split, lambda row: row.get("peer") == "PCL" and "copies" not in row)
        ],
    )
    memory = {row["name"].partition(",")[0]: row for row in rows if row["name"].endswith("extra memory by input")}
    table(
        ["kernel", "ns a point at 10 k, 100 k, 1 M, 10 M", "exponent", "extra memory, by input"],
        [
            [
                name,
                ", ".join(f"{ns:g}" for ns in row["ns_per_point"].values()),
                f"{row['value']:g}",
                words(memory[name]),
            ]
            for row in rows
            if "ns_per_point" in row
            for name in (row["name"].partition(",")[0],)
        ],
    )


def cut(name: str) -> tuple[str, str]:
    """A row's name without its cloud, and the cloud."""
    what, _, cloud = name.rpartition(", ")
    what, colon, _ = what.partition(": least IoU")
    return (what + colon, cloud) if cloud in CLOUDS else (name, "")


def by_name(split: list[tuple[Row, str, str]], wanted: Any) -> list[tuple[str, dict[str, Row]]]:
    """Rows of one name (and peer) by their cloud, in the order of the first."""
    found: dict[tuple[str, Any], dict[str, Row]] = {}
    for row, name, cloud in split:
        if cloud and wanted(row):
            found.setdefault((name, row["peer"]), {})[cloud] = row
    return [(name, rows) for (name, _), rows in found.items()]


def timed(name: str, rows: dict[str, Row]) -> list[str]:
    copies = [row["copies"] for row in rows.values()]
    target = next(iter(rows.values()))["target"]
    return [name, *cells(rows), f"{min(copies):g} to {max(copies):g}", f"{target:g}", holds(rows)]


def beside(name: str, rows: dict[str, Row]) -> list[str]:
    return [name, next(iter(rows.values()))["peer"], *cells(rows)]


def differing(name: str, rows: dict[str, Row]) -> list[str]:
    values = [f"{rows[cloud]['value']:.3g}" if cloud in rows else "" for cloud in CLOUDS]
    return [name, *values, f"{next(iter(rows.values()))['target']:g}", holds(rows)]


def cells(rows: dict[str, Row]) -> list[str]:
    """Ours / the peer's = ratio, in ms, for each cloud."""
    return [
        f"{rows[cloud]['value']:.3g} / {rows[cloud]['peer_value']:.3g} = {rows[cloud]['ratio']:.3g}"
        if cloud in rows
        else ""
        for cloud in CLOUDS
    ]


def holds(rows: dict[str, Row]) -> str:
    """Where it does not hold."""
    if all(row["holds"] is None for row in rows.values()):
        return ""
    missed = [cloud.partition(" ")[0] for cloud, row in rows.items() if row["holds"] is False]
    return f"**not {', '.join(missed)}**" if missed else "yes"


def words(row: Row) -> str:
    return f"{row['value']:g}" if row["holds"] else f"**{row['value']:g}**"


def table(headings: list[str], rows: list[list[str]]) -> None:
    print(f"| {' | '.join(headings)} |")
    print(f"|{'---|' * len(headings)}")
    for row in rows:
        print(f"| {' | '.join(row)} |")
    print()


if __name__ == "__main__":
    main(json.load(sys.stdin)["rows"])
