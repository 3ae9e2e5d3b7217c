"""Writes the parts of the documentation that derive from the code: the tables of architecture.md and the settings page.

Run it as ``python docs/generate.py`` after a change of a channel, a service or a setting; a test compares.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING

from zsight.services import SERVICES, Service
from zsight.settings import Settings, describe, is_live, variable
from zsight_protocol.channels import CHANNELS, Channel

if TYPE_CHECKING:
    from collections.abc import Sequence

DOCS = Path(__file__).resolve().parent

SETTINGS_HEAD = """# Settings of the services

Every setting can be given in five places; the first that has it counts:

1. an option, `zsight run voxel --leaf 0.01`;
2. what was saved at run time, `zsight param set voxel leaf 0.01 --save`;
3. an environment variable, `ZSIGHT_VOXEL_LEAF=0.01`: the process's name, then the setting's;
4. the process's table in the file that `zsight up FILE.toml` reads;
5. the default.

```toml
# two_cameras.toml
[process.router]

[process.left]
service = "camera"
camera = "left"
source = "book"

[process.right]
service = "camera"
camera = "right"
source = "ellipse"

[process.voxel]
camera = "left"
leaf = 0.01
```

A process is named by its table; `service` says which service it runs where the two differ. `namespace`, `connect` and
`listen` may stand above the tables. In the file and in variables underscores take the place of the hyphens; the
variables below are those of a process that bears its service's name. `-` stands for a default of nothing.

## At run time

`zsight param list` shows the settings of all running processes, `zsight param get PROCESS SETTING` one of them, and
`zsight param set PROCESS SETTING VALUE` changes those marked *yes* below from the next cloud, patch or goal on. The
others are read at the start: `--save` keeps a value for the next one, in
`~/.config/zsight/saved/NAMESPACE/PROCESS.json` on the process's own host. A value out of range is refused, whatever it
comes from; `-` is no value, as `param list` shows it. The same from a program: `cell.parameters` of
[the client](../client.md).

This page is made from the code by `python docs/generate.py`.
"""


def main() -> None:
    """Write all generated parts."""
    for path, text in pages().items():
        path.write_text(text, encoding="utf-8")


def pages() -> dict[Path, str]:
    """Every page with generated parts, as it should be."""
    architecture = DOCS / "architecture.md"
    text = architecture.read_text(encoding="utf-8")
    text = with_part(text, "channels", channel_table(CHANNELS))
    text = with_part(text, "services", service_table(SERVICES))
    return {architecture: text, DOCS / "reference" / "settings.md": settings_page(SERVICES)}


def with_part(page: str, name: str, part: str) -> str:
    """The page with the part between its two marks replaced.

    Raises:
        ValueError: the page has no such marks.
    """
    begin, end = f"<!-- begin {name}: made by docs/generate.py -->\n", f"<!-- end {name} -->"
    before, found_begin, rest = page.partition(begin)
    _, found_end, after = rest.partition(end)
    if not found_begin or not found_end:
        raise ValueError(f"the page has no part {name}; expected the lines {begin!r} and {end!r}")
    return f"{before}{begin}{part}{end}{after}"


def channel_table(channels: tuple[Channel, ...]) -> str:
    """Table 1: every key, its message, its delivery."""
    rows = [(f"`NS/{_readable(row.pattern)}`", _message(row), row.delivery.value) for row in channels]
    return _table(("key", "message", "delivery"), rows)


def _readable(pattern: str) -> str:
    """A pattern with names in place of its stars."""
    names = {
        "find_object": ["FINDER"],
        "catalog": ["TYPE"],
        "param": ["HOST", "PROCESS"],
        "@recorder": ["RECORDER"],
        "@player": ["PLAYER"],
        "@health": ["HOST", "PROCESS"],
        "@log": ["HOST", "PROCESS"],
        "@host": ["HOST"],
        "@alive": ["HOST", "PROCESS"],
    }
    stars = iter(names.get(pattern.split("/", maxsplit=1)[0], ["CAMERA"]))
    return re.sub(r"\*", lambda _: next(stars), pattern)


def _message(row: Channel) -> str:
    if row.message is None:
        return "-"
    return row.message.__name__.replace("[", " of ").replace("]", "")


def service_table(services: tuple[Service, ...]) -> str:
    """Table 2: every service, its module, what it does."""
    return _table(("name", "module", "does"), [(row.name, f"`{row.module}`", row.does) for row in services])


def settings_page(services: tuple[Service, ...]) -> str:
    """Every setting of every service."""
    return SETTINGS_HEAD + "".join(_service_part(row) for row in services)


def _service_part(row: Service) -> str:
    kind = row.settings()
    rows = [
        (f"`--{name}`", f"`{variable(row.name, name)}`", f"`{default}`", _when(kind, name), words)
        for name, default, words in describe(kind)
    ]
    table = _table(("setting", "environment", "default", "at run time", "meaning"), rows) if rows else "No settings.\n"
    return f"\n## {row.name}\n\n{row.does[0].upper()}{row.does[1:]}.\n\n{table}"


def _when(kind: type[Settings], name: str) -> str:
    return "yes" if is_live(kind, name.replace("-", "_")) else "restart"


def _table(headings: tuple[str, ...], rows: Sequence[tuple[str, ...]]) -> str:
    lines = [headings, tuple("---" for _ in headings), *rows]
    return "".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |\n" for line in lines)


if __name__ == "__main__":
    main()
