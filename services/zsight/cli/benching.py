"""``zsight bench``: measurements beside other systems, from a checkout of the project."""

from __future__ import annotations

import os
import platform
import sys
from importlib import import_module, metadata
from pathlib import Path
from typing import Annotated, Any

import typer

from zsight.cli.options import Json
from zsight.cli.output import print_json, print_table
from zsight.errors import UsageError

__all__ = ["bench"]


def bench(
    name: Annotated[str, typer.Argument(metavar="[NAME]", help="What to measure; left out: which there are.")] = "",
    json: Json = False,
) -> None:
    """Measure something beside its peers; exit code 1 where a target does not hold."""
    folder = _folder()
    known = sorted(path.stem for path in folder.glob("*.py") if "\ndef run(" in path.read_text(encoding="utf-8"))
    if not name:
        typer.echo("\n".join(known))
        return
    if name not in known:
        raise UsageError(f"no bench is called {name!r}; expected one of {', '.join(known)}")
    sys.path.insert(0, str(folder))
    rows: list[dict[str, Any]] = import_module(name).run()
    if json:
        print_json({"machine": machine(), "rows": rows})
    else:
        headings = ("name", "value", "unit", "peer", "peer_value", "ratio", "target", "holds")
        print_table(headings, [[_words(row.get(heading)) for heading in headings] for row in rows])
    raise typer.Exit(0 if all(row["holds"] is not False for row in rows) else 1)


def _folder() -> Path:
    import zsight

    for folder in (Path(zsight.__file__).resolve().parents[2] / "bench", Path.cwd() / "bench"):
        if folder.is_dir():
            return folder
    raise UsageError("the benches are in a checkout of the project, not in its package: run this command there")


def machine() -> dict[str, Any]:
    """What the figures were measured on."""
    packages = ("eclipse-zenoh", "numpy", "numba", "open3d-cpu", "open3d")
    return {
        "processor": _processor(),
        "cores": os.cpu_count(),
        "system": platform.platform(),
        "python": platform.python_version(),
        "packages": {name: _version(name) for name in packages if _version(name)},
    }


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor()
    return next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), platform.machine())


def _version(name: str) -> str:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return ""


def _words(value: Any) -> str:
    if value is None:
        return "-"
    return f"{value:.4g}" if isinstance(value, float) else str(value)
