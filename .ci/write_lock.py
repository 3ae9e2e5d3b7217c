"""Write requirements.lock: the newest versions that pyproject.toml allows, for users and developers alike."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parent.parent
LEFT_OUT = {"rerun"}  # extras that are large and asked for by few; their tests are skipped without them
HEAD = "# Pinned versions, written by `make lock`; where they come from is pip's own setting.\n"
# One module under two names: without CUDA where a wheel of it exists.
MARKERS = {
    "open3d-cpu": "sys_platform == 'linux' and platform_machine == 'x86_64'",
    "open3d": "sys_platform != 'linux' or platform_machine != 'x86_64'",
}


def wanted() -> list[str]:
    """Requirements of the package, of its extras, and of its developers."""
    document = tomllib.loads((REPOSITORY / "pyproject.toml").read_text())
    project = document["project"]
    chosen = {name: lines for name, lines in project["optional-dependencies"].items() if name not in LEFT_OUT}
    extras = [line for lines in chosen.values() for line in lines]
    others = [line for line in extras if not line.startswith("zsight[")]
    return [*project["dependencies"], *others, *document["dependency-groups"]["dev"]]


def resolve(requirements: list[str]) -> dict[str, str]:
    """Version by name of all that pip would install into an empty environment."""
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder) / "report.json"
        command = [sys.executable, "-m", "pip", "install", "--quiet", "--dry-run", "--ignore-installed"]
        subprocess.run([*command, "--report", str(report), *requirements], check=True)
        installs = json.loads(report.read_text())["install"]
    return {re.sub(r"[-_.]+", "-", i["metadata"]["name"]).lower(): i["metadata"]["version"] for i in installs}


def lock(versions: dict[str, str]) -> str:
    """The text of the lock."""
    for name, twin in (("open3d", "open3d-cpu"), ("open3d-cpu", "open3d")):
        if name in versions:
            versions.setdefault(twin, versions[name])
    lines = [f"{name}=={version}" + marker_of(name) for name, version in sorted(versions.items())]
    return HEAD + "\n".join(lines) + "\n"


def marker_of(name: str) -> str:
    """Where a package is wanted, if not everywhere."""
    return f"; {MARKERS[name]}" if name in MARKERS else ""


if __name__ == "__main__":
    text = lock(resolve(wanted()))
    (REPOSITORY / "requirements.lock").write_text(text)
    print(f"requirements.lock: {len(text.splitlines()) - 1} packages")
