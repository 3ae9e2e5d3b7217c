"""Draws how hops grow, from the JSON of transport.py on standard input: ``python transport_pictures.py FOLDER``.

It needs matplotlib, which nothing else here does: a virtual environment of its own will do.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any


def draw(rows: list[dict[str, Any]], folder: Path) -> None:
    """Median and 99th percentile by readers and by size, as transport_readers.png and transport_sizes.png."""
    from matplotlib import pyplot as plt

    kinds = (
        ("transport_readers", "readers of one cloud of 4.9 MB", "1 writer to ", lambda name: float(name.split()[3])),
        ("transport_sizes", "size of the cloud, MB", "one hop of ", lambda name: float(name.split()[3])),
    )
    for file, label, start, place in kinds:
        chosen = [row for row in rows if row["name"].startswith(start)]
        figure, axes = plt.subplots(figsize=(6, 4), dpi=120)
        for word, style in (("p50", "o-"), ("p99", "o:")):
            of = [row for row in chosen if row["name"].endswith(word)]
            mine = {place(row["name"]): row["value"] for row in of}
            axes.plot(list(mine), list(mine.values()), style, color="tab:blue", label=f"zsight {word}")
            for peer, colour in (("bare zenoh", "tab:orange"), ("floor", "tab:gray")):
                theirs = {place(row["name"]): row["peer_value"] for row in of if row["peer"] == peer}
                axes.plot(list(theirs), list(theirs.values()), style, color=colour, label=f"{peer} {word}")
        axes.set(xlabel=label, ylabel="until the last array can be used, ms", ylim=(0, None))
        axes.grid(alpha=0.3)
        axes.legend(fontsize=8)
        figure.tight_layout()
        figure.savefig(folder / f"{file}.png")
        plt.close(figure)


if __name__ == "__main__":
    draw(json.load(sys.stdin)["rows"], Path(sys.argv[1]))
