"""The compiled PCL program as a process that is asked for one task at a time."""

from __future__ import annotations

import subprocess
from pathlib import Path
from typing import TYPE_CHECKING, Self

import numpy as np

if TYPE_CHECKING:
    from types import TracebackType

    from numpy.typing import NDArray

PROGRAM = Path(__file__).resolve().parent / "pcl" / "build" / "kernels"
BUILD = PROGRAM.parent.parent / "build.sh"


class PclProcess:
    """Speaks the protocol written on top of pcl/kernels.cpp.

    Raises:
        FileNotFoundError: the program is not compiled; run bench/pcl/build.sh.
    """

    def __init__(self, scratch: Path) -> None:
        if not PROGRAM.exists():
            raise FileNotFoundError(f"{PROGRAM} is not there; compile it with {BUILD}")
        self._scratch = scratch / "pcl_result"
        self._process = subprocess.Popen([str(PROGRAM)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._process.terminate()
        self._process.wait(timeout=10)

    def load(self, path: Path, T_world_camera: NDArray[np.float64]) -> None:
        """Read a cloud and place it in the world."""
        self.run(f"load {path}")
        self.run("pose " + " ".join(repr(float(number)) for number in T_world_camera[:3].ravel()))

    def run(self, task: str) -> float:
        """Do a task once; its time in milliseconds, by the program's own clock."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(task + "\n")
        self._process.stdin.flush()
        answer = self._process.stdout.readline().split()
        if not answer or answer[0] == "error":
            raise RuntimeError(f"PCL did not do {task!r}: {' '.join(answer) or 'it ended'}")
        return float(answer[0])

    def result(self) -> NDArray[np.float32]:
        """The last task's result as float32; integers by ``.view(np.int32)``, points as rows of 4 when reshaped."""
        self.run(f"dump {self._scratch}")
        return np.fromfile(self._scratch, np.float32)
