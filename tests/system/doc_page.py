"""A page of the documentation as a program: its fences in order, run in one folder by one shell, and compared.

A fence is one of these, and the comments that may stand before it say more:

- ``console`` or ``bash`` with ``$ `` prompts: commands, each followed by what it prints (both streams). A line ``...``
  stands for any lines. Exit code 0 is expected unless the page goes on with ``$ echo $?``.
- ``python``: a program; a ``text`` fence right behind it is what it prints; without one, it need only succeed.
- ``yaml`` or ``toml`` whose first line is ``# NAME.yaml``: a file.
- ``<!-- needs: NAMES -->``: skipped unless there are real recordings of these names, which are put into the folder.
- ``<!-- numbers vary -->``: the words are compared and the numbers are not.

``python -m tests.system.doc_page docs/tutorial.md`` runs a page and puts what came into it.
"""

from __future__ import annotations

import os
import queue
import re
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
from dataclasses import dataclass, field
from itertools import zip_longest
from pathlib import Path

from zsight_core import kernel_cache

REPOSITORY = Path(__file__).resolve().parent.parent.parent
PAGES = (
    REPOSITORY / "README.md",
    *sorted((REPOSITORY / "docs").glob("*.md")),
    *sorted((REPOSITORY / "docs" / "reference").glob("*.md")),
)

_FENCE = re.compile(r"(?P<marks>(?:<!--[^>]*-->\n+)*)```(?P<kind>\w+)\n(?P<body>.*?)^```$", re.MULTILINE | re.DOTALL)
_NEEDS = re.compile(r"<!-- needs: (.+?) -->")
_NUMBER = re.compile(r"(?<![A-Za-z0-9_.])[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?")
_TIME = re.compile(r"\d+(?:\.\d+)? ms\b")  # how long something took is never compared
_WARMING = "compiling"  # what the first start on a machine says and later ones do not
_PATIENCE = 170.0  # seconds for one command


@dataclass
class Step:
    """One command, and what the page says it prints."""

    command: str
    shown: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class Fence:
    """A piece of a page that is run."""

    page: Path
    line: int
    kind: str
    body: str
    span: tuple[int, int]
    needs: str
    numbers_vary: bool

    def __str__(self) -> str:
        return f"{self.page.relative_to(REPOSITORY)}:{self.line}"


def fences(page: Path) -> list[Fence]:
    """All fences of a page."""
    text = page.read_text(encoding="utf-8")
    found = []
    for match in _FENCE.finditer(text):
        needs = _NEEDS.search(match["marks"])
        found.append(
            Fence(
                page,
                text.count("\n", 0, match.start("body")),
                match["kind"],
                match["body"],
                match.span("body"),
                needs[1] if needs else "",
                "numbers vary" in match["marks"],
            )
        )
    return found


def pairs(page: Path) -> list[tuple[Fence, Fence | None]]:
    """All fences of a page, each with the one behind it."""
    found = fences(page)
    return [(fence, following) for fence, following in zip_longest(found, found[1:]) if fence is not None]


def is_run(fence: Fence) -> bool:
    """Whether a fence is a program and not only something to look at."""
    if fence.kind in ("console", "bash"):
        return fence.body.startswith("$ ")
    return fence.kind == "python" or is_file(fence)


def is_file(fence: Fence) -> bool:
    """Whether a fence is the content of a file."""
    return fence.kind in ("yaml", "toml") and file_name(fence) is not None


def file_name(fence: Fence) -> str | None:
    """The name in the first line of a file."""
    match = re.match(r"# (\S+\.(?:yaml|toml))\n", fence.body)
    return match[1] if match else None


def steps(fence: Fence) -> list[Step]:
    """The commands of a fence."""
    found: list[Step] = []
    goes_on = False
    for line in fence.body.splitlines():
        if goes_on:
            found[-1].command += "\n" + line.removeprefix("> ")
        elif line.startswith("$ "):
            found.append(Step(line[2:]))
        else:
            found[-1].shown.append(line)
        goes_on = (goes_on or line.startswith("$ ")) and line.endswith("\\")
    return found


class Place:
    """A folder, a port, a home and a shell of a page's own."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.port = _free_port()
        (folder / ".tmp").mkdir()
        endpoint = f"tcp/127.0.0.1:{self.port}"
        kept = {name: value for name, value in os.environ.items() if not name.startswith("ZSIGHT_")}
        self.environment = {
            **kept,
            "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}",
            "HOME": str(folder),
            "TMPDIR": str(folder / ".tmp"),
            "XDG_RUNTIME_DIR": str(folder / ".tmp"),
            "NUMBA_CACHE_DIR": os.environ.get("NUMBA_CACHE_DIR", str(kernel_cache.folder())),
            "ZSIGHT_CONNECT": endpoint,
            "ZSIGHT_LISTEN": endpoint,
            "ZSIGHT_HOST": "desk",
            "LC_ALL": "C.UTF-8",
        }
        self._shell = subprocess.Popen(
            ["bash", "--norc"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            cwd=folder,
            env=self.environment,
            text=True,
            bufsize=1,
            start_new_session=True,
        )
        self._lines: queue.SimpleQueue[str] = queue.SimpleQueue()
        self._listener = threading.Thread(target=self._listen, daemon=True)
        self._listener.start()

    def _listen(self) -> None:
        if self._shell.stdout is not None:
            with self._shell.stdout as printed:
                for line in printed:
                    self._lines.put(line)

    def run(self, command: str) -> tuple[list[str], int]:
        """What a command prints, and its exit code, which the next command finds in ``$?``."""
        if self._shell.stdin is None:
            raise RuntimeError("the shell has no input")
        self._shell.stdin.write(
            f"(exit ${{_code:-0}}); {{ {command}\n}} </dev/null\n_code=$?; printf '\\n<<%s>>\\n' $_code\n"
        )
        self._shell.stdin.flush()
        lines: list[str] = []
        while True:
            line = self._lines.get(timeout=_PATIENCE).rstrip("\n")
            end = re.fullmatch(r"<<(\d+)>>", line)
            if end is None:
                lines.append(line)
                continue
            if lines and not lines[-1]:
                lines.pop()  # the line break before the mark
            return [self._without_place(line) for line in lines if not line.startswith(_WARMING)], int(end[1])

    def _without_place(self, line: str) -> str:
        """A line as it reads on the page: with the usual port, user and folder."""
        line = line.replace(str(self.folder / ".tmp"), "/run/user/1000").replace(str(self.folder), ".")
        line = line.replace(str(self.port), "7447")
        return re.sub(r"zsight-\d+-", "zsight-1000-", line)

    def close(self) -> None:
        """End the page's cell and its shell."""
        if any((self.folder / ".tmp").glob("*.pid")):
            self.run("zsight down")
        os.killpg(self._shell.pid, signal.SIGTERM)
        self._shell.wait(10)
        self._listener.join(10)
        if self._shell.stdin is not None:
            self._shell.stdin.close()


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


def run_fence(place: Place, fence: Fence, following: Fence | None) -> list[tuple[str, list[str], list[str], int]]:
    """Run a fence: for each command what the page shows, what came, and its exit code."""
    name = file_name(fence)
    if name is not None:
        (place.folder / name).write_text(fence.body, encoding="utf-8")
        return []
    if fence.kind == "python":
        program = place.folder / f"program_{fence.line}.py"
        program.write_text(fence.body, encoding="utf-8")
        came, code = place.run(f"python {program.name}")
        shown = following.body.splitlines() if following is not None and following.kind == "text" else came
        return [(f"python program of line {fence.line}", shown, came, code)]
    done = []
    for step in steps(fence):
        came, code = place.run(step.command)
        done.append((step.command, step.shown, came, code))
    return done


def differs(shown: list[str], came: list[str], *, numbers_vary: bool) -> str | None:
    """How what came differs from what the page shows, none where it does not."""
    if not shown:
        return None if not came else f"the page shows nothing; came: {came}"
    if "..." in shown:
        cut = shown.index("...")
        tail = shown[cut + 1 :]
        if len(came) < len(shown) - 1:
            return f"expected {shown}; came: {came}"
        came = [*came[:cut], *came[len(came) - len(tail) :]]
        shown = [*shown[:cut], *tail]
    if len(shown) != len(came):
        return f"expected {len(shown)} lines {shown}; came {len(came)}: {came}"
    for expected, line in zip(shown, came, strict=True):
        if not _alike(expected, line, numbers_vary=numbers_vary):
            return f"expected {expected!r}; came: {line!r}"
    return None


def _alike(expected: str, line: str, *, numbers_vary: bool) -> bool:
    expected, line = (_TIME.sub("some ms", text) for text in (expected, line))
    if _words(expected) != _words(line):
        return False
    pairs = zip(_NUMBER.findall(expected), _NUMBER.findall(line), strict=True)
    return numbers_vary or all(_near(a, b) for a, b in pairs)


def _words(line: str) -> list[str]:
    return _NUMBER.sub("#", line).split()


def _near(expected: str, came: str) -> bool:
    """Equal within 2 % or 20 units of the last decimal (at most 0.05): other noise and rounding are no news."""
    decimals = len(expected.partition(".")[2])
    few = min(20 * 10.0**-decimals, 0.05) if decimals else 0.0
    return abs(float(expected) - float(came)) <= max(few, 0.02 * abs(float(expected)))


def provide(place: Place, names: str) -> bool:
    """Put real recordings into the page's folder; false where there is no such file."""
    folder = Path(os.environ.get("ZSIGHT_DATA", REPOSITORY.parent / "shared" / "data"))
    for name in names.split(", "):
        found = sorted(folder.rglob(name)) if folder.is_dir() else []
        if not found:
            return False
        shutil.copy(found[0], place.folder / name)
    return True


def rewrite(page: Path) -> None:
    """Run a page and put what came into it, keeping ``...`` where the rest still fits."""
    text = page.read_text(encoding="utf-8")
    parts: list[tuple[tuple[int, int], str]] = []
    with tempfile.TemporaryDirectory() as folder:
        place = Place(Path(folder))
        try:
            for fence, following in pairs(page):
                if not is_run(fence) or (fence.needs and not provide(place, fence.needs)):
                    continue
                done = run_fence(place, fence, following)
                for command, _, came, code in done:
                    print(f"{fence}: {command!r}: exit code {code}", *came, sep="\n  ")
                if fence.kind == "python" and following is not None and following.kind == "text":
                    parts.append((following.span, _body(done[0][1], done[0][2])))
                elif fence.kind in ("console", "bash"):
                    body = "".join(
                        "$ " + s.command.replace("\n", "\n> ") + "\n" + _body(d[1], d[2])
                        for s, d in zip(steps(fence), done, strict=True)
                    )
                    parts.append((fence.span, body))
        finally:
            place.close()
    for (begin, end), body in reversed(parts):
        text = text[:begin] + body + text[end:]
    page.write_text(text, encoding="utf-8")


def _body(shown: list[str], came: list[str]) -> str:
    if differs(shown, came, numbers_vary=True) is None and "..." in shown:
        cut = shown.index("...")
        tail = len(shown) - cut - 1
        came = [*came[:cut], "...", *came[len(came) - tail :]]
    return "".join(line + "\n" for line in came)


if __name__ == "__main__":
    for argument in sys.argv[1:]:
        rewrite(Path(argument).resolve())
