"""PCD files: our reader and writer beside PCL's, run in turns on the same clouds; files must be read alike, bit by bit.

    python bench/pcd_io.py PROGRAM CLOUD.pcd [CLOUD.pcd ...]

PROGRAM is pcl/pcd_io.cpp, compiled as pcl/README.md says. Times are milliseconds of the processor, system calls
included; PCL keeps its cloud between runs, ours makes a new one each time.
"""

from __future__ import annotations

import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import IO, TYPE_CHECKING, cast

import numpy as np

from zsight_core.files import pcd
from zsight_core.points import XYZRGB

if TYPE_CHECKING:
    from collections.abc import Callable

    from zsight_core.points import Points

ENCODINGS: tuple[pcd.Encoding, ...] = ("binary", "binary_compressed", "ascii")
ROUNDS = 15


class Pcl:
    """The running PCL program."""

    def __init__(self, program: str) -> None:
        self._process = subprocess.Popen([program], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)

    def ask(self, *words: object) -> float:
        """Milliseconds that a task took."""
        cast(IO[str], self._process.stdin).write(" ".join(str(word) for word in words) + "\n")
        cast(IO[str], self._process.stdin).flush()
        took = float(cast(IO[str], self._process.stdout).readline().split()[0])
        if took < 0:
            raise SystemExit(f"PCL failed to {' '.join(str(word) for word in words)}")
        return took

    def load(self, path: Path, folder: Path) -> Points:
        """The cloud as PCL reads it, (N,)."""
        self.ask("load", path)
        self.ask("dump", folder / "dump")
        return np.fromfile(folder / "dump", XYZRGB)


def main(program: str, *clouds: str) -> None:
    pcd.warm_up()
    pcl = Pcl(program)
    print(f"{'cloud':38} {'task':24} {'PCL ms':>8} {'ours ms':>8} {'ratio':>6}   read alike")
    for cloud in clouds:
        with tempfile.TemporaryDirectory() as folder:
            measure(pcl, Path(cloud), Path(folder))


def measure(pcl: Pcl, cloud: Path, folder: Path) -> None:
    points = plain(pcd.read(cloud).points)
    for encoding in ENCODINGS:
        measure_encoding(pcl, cloud.name, points, encoding, folder)


def measure_encoding(pcl: Pcl, name: str, points: Points, encoding: pcd.Encoding, folder: Path) -> None:
    ours, theirs, fresh = (folder / f"{who}-{encoding}.pcd" for who in ("ours", "pcl", "fresh"))
    pcd.write(ours, points, encoding=encoding)
    pcl.ask("load", ours)
    pcl.ask("save", encoding, theirs)
    alike = same(pcl.load(ours, folder), points) and same(plain(pcd.read(theirs).points), pcl.load(theirs, folder))
    loads = turns(lambda: pcl.ask("load", ours), lambda: timed(lambda: pcd.read(ours)))
    saves = turns(
        lambda: gone(fresh, lambda: pcl.ask("save", encoding, fresh)),
        lambda: gone(fresh, lambda: timed(lambda: pcd.write(fresh, points, encoding=encoding))),
    )
    row(name, f"load {encoding}", loads, alike)
    row(name, f"save {encoding}", saves, alike)


def plain(points: Points) -> Points:
    """x, y, z and rgb alone."""
    copy = np.empty(points.shape, XYZRGB)
    for name in XYZRGB.names or ():
        copy[name] = points[name]
    return copy


def same(a: Points, b: Points) -> bool:
    """True where coordinates are the same numbers (NaN for NaN) and the lower 24 bits of colours are equal."""
    a, b = a.reshape(-1), b.reshape(-1)
    coordinates = all(np.array_equal(a[axis], b[axis], equal_nan=True) for axis in "xyz")
    return coordinates and bool(np.array_equal(a["rgb"].view(np.uint32) << 8, b["rgb"].view(np.uint32) << 8))


def turns(theirs: Callable[[], float], ours: Callable[[], float]) -> list[tuple[float, float]]:
    return [(theirs(), ours()) for _ in range(ROUNDS)]


def timed(task: Callable[[], object]) -> float:
    start = time.thread_time_ns()
    task()
    return 1e-6 * (time.thread_time_ns() - start)


def gone(path: Path, task: Callable[[], float]) -> float:
    """Run a task that makes a file, and remove the file."""
    took = task()
    path.unlink()
    return took


def row(cloud: str, task: str, pairs: list[tuple[float, float]], alike: bool) -> None:
    theirs, ours = (statistics.median(column) for column in zip(*pairs, strict=True))
    ratio = statistics.median(their / our for their, our in pairs)
    print(f"{cloud:38} {task:24} {theirs:8.2f} {ours:8.2f} {ratio:6.2f}   {'yes' if alike else 'NO'}")


if __name__ == "__main__":
    main(*sys.argv[1:])
