"""Write the section Finder of docs/performance.md and its pictures from what ``bench/finder.py --json`` printed."""

from __future__ import annotations

import argparse
import json
import re
from pathlib import Path
from typing import Any

from PIL import Image, ImageDraw

REPOSITORY = Path(__file__).resolve().parents[1]
PAGE = REPOSITORY / "docs" / "performance.md"
PICTURES = REPOSITORY / "docs" / "pictures"
HOLDS, MISSED, PLAIN, INK, GRID = (70, 130, 90), (200, 90, 70), (120, 140, 165), (40, 44, 52), (222, 224, 228)
ROW, LEFT, WIDTH, RIGHT = 26, 320, 480, 200

Row = dict[str, Any]
Bar = tuple[str, float, float | None, str, bool | None]


def plot(title: str, bars: list[Bar], most: float) -> Image.Image:
    """Level bars: name, length, target mark, words beside it, whether it holds; ``most`` is the longest shown."""
    image = Image.new("RGB", (LEFT + WIDTH + RIGHT, 50 + ROW * len(bars)), "white")
    draw = ImageDraw.Draw(image)
    draw.text((12, 12), title, fill=INK)
    for number, (name, length, target, words, holds) in enumerate(bars):
        top = 40 + ROW * number
        draw.line((LEFT, top + ROW - 3, LEFT + WIDTH, top + ROW - 3), fill=GRID)
        draw.text((12, top + 4), name, fill=INK)
        colour = {True: HOLDS, False: MISSED, None: PLAIN}[holds]
        end = LEFT + WIDTH * min(length / most, 1.0)
        draw.rectangle((LEFT, top + 3, max(end, LEFT + 1), top + ROW - 8), fill=colour)
        draw.text((LEFT + WIDTH + 10, top + 4), words, fill=INK)
        if target is not None:
            x = LEFT + WIDTH * target / most
            draw.line((x, top, x, top + ROW - 4), fill=INK, width=2)
    return image


def recall_plot(rows: list[Row]) -> Image.Image:
    """Recall by level; the black mark is the target."""
    recalls = [row for row in rows if row["name"].endswith("recall")]
    bars = [(_name(r), r["value"], r["target"], f"{r['value']:.3f} of {r['of']}", r["holds"]) for r in recalls]
    return plot("Share of the objects seen at least half that were found; the black mark is the target", bars, 1.0)


def limits_plot(rows: list[Row]) -> Image.Image:
    """Errors and times over what is allowed."""
    limits = [row for row in rows if row["unit"] in ("mm", "deg", "ms") and row["target"]]
    bars: list[Bar] = [
        (_name(r), r["value"] / r["target"], 1.0, f"{r['value']:.3g} of {r['target']:g} {r['unit']}", r["holds"])
        for r in limits
    ]
    return plot("Errors and times over what is allowed (the black mark); bars end at three times that", bars, 3.0)


def _name(row: Row) -> str:
    return str(row["name"]).removeprefix("finder ")


def section(found: dict[str, Any], scenes: int) -> str:
    """The markdown section."""
    rows, machine = found["rows"], found["machine"]
    missed = [row for row in rows if row["holds"] is False]
    lines = [
        "## Finder",
        "",
        f"`zsight bench finder` over {scenes} simulated scenes of each of twelve levels, half of them seen by a",
        "simulated Kinect and half by a time-of-flight camera, from test seeds, with all shipped types as rivals of",
        f"each other. Measured on {machine['processor']}, {machine['cores']} cores, in one process, as processor time;",
        "little else was running. Errors of poses are those",
        "of objects that are seen at least half and were found, in the camera's frame; an answer more than 20 mm or 15",
        "degrees off is a wrong one and a miss instead. The normalised error is the square root of the median over",
        "that of a chi-square distribution, which a few large errors do not move. `of` says on how many things a",
        "figure rests: where that is small, a share tells little.",
        "",
        f"{len(missed)} of {sum(row['holds'] is not None for row in rows)} targets are missed.",
        "",
        "![recall by level](pictures/finder_recall.png)",
        "",
        "![errors and times](pictures/finder_limits.png)",
        "",
        "| figure | value | target | of | holds |",
        "|---|---|---|---|---|",
    ]
    for row in rows:
        verdict = {True: "yes", False: "**no**", None: ""}[row["holds"]]
        target = "" if row["target"] is None else f"{row['target']:g}"
        value = f"{row['value']:.4g} {row['unit']}".strip()
        lines.append(f"| {_name(row)} | {value} | {target} | {row['of'] or ''} | {verdict} |")
    causes = found.get("failures", {}).get("causes", {})
    for kind, entries in causes.items():
        if entries:
            told = "; ".join(f"{cause} ({count})" for cause, count in entries[:8])
            lines += ["", f"Most frequent causes of what was {kind}: {told}."]
    lines += ["", "Made with `python bench/finder.py --failures --json > finder.json` and `bench/finder_page.py`."]
    return "\n".join(lines) + "\n"


def put(page: str, text: str) -> str:
    """The page with the section in place of its former self, or at the end."""
    former = re.compile(r"^## Finder\n.*?(?=^## |\Z)", re.MULTILINE | re.DOTALL)
    if former.search(page):
        return former.sub(lambda _: text + "\n", page).rstrip("\n") + "\n"
    return (page.rstrip("\n") or "# Performance") + "\n\n" + text


def main() -> None:
    """Write page and pictures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("file", type=Path, help="what bench/finder.py --failures --json printed")
    parser.add_argument("--scenes", type=int, default=8, help="scenes a level it was run with")
    arguments = parser.parse_args()
    found = json.loads(arguments.file.read_text(encoding="utf-8"))
    PICTURES.mkdir(parents=True, exist_ok=True)
    recall_plot(found["rows"]).save(PICTURES / "finder_recall.png")
    limits_plot(found["rows"]).save(PICTURES / "finder_limits.png")
    page = PAGE.read_text(encoding="utf-8") if PAGE.exists() else ""
    PAGE.write_text(put(page, section(found, arguments.scenes)), encoding="utf-8")


if __name__ == "__main__":
    main()
