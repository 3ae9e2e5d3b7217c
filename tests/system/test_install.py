"""What a thin host gets: the base install, without the perception extra, in an environment of its own."""

from __future__ import annotations

import json
import os
import re
import socket
import subprocess
import sys
import venv
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from collections.abc import Iterator

REPOSITORY = Path(__file__).resolve().parent.parent.parent
LOCK = REPOSITORY / "requirements.lock"
HEAVY = ("numba", "open3d", "scipy")
# What the clean environment must not inherit from the one that runs the tests.
OWN = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "VIRTUAL_ENV", "ZSIGHT"))}

pytestmark = [pytest.mark.system, pytest.mark.timeout(600)]


class Host:
    """An environment with its own zsight."""

    def __init__(self, folder: Path) -> None:
        self.python = folder / ("Scripts" if os.name == "nt" else "bin") / "python"

    def run(self, *arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [self.python, *arguments],
            env={**OWN, **environment},
            cwd=self.python.parent,  # not the repository, whose folders must not be found by chance
            capture_output=True,
            text=True,
            timeout=300,
            check=False,
        )

    def zsight(self, *arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
        return self.run("-m", "zsight", *arguments, **environment)


@pytest.fixture(scope="module")
def host(tmp_path_factory: pytest.TempPathFactory) -> Host:
    """A new environment with the base install."""
    folder = tmp_path_factory.mktemp("host")
    venv.create(folder, with_pip=True)
    host = Host(folder)
    pin = next(line for line in LOCK.read_text().splitlines() if line.startswith("msgpack=="))
    download = host.run("-m", "pip", "download", "--quiet", "--no-deps", "--dest", str(folder / "download"), pin)
    if download.returncode != 0:
        pytest.skip(f"pip cannot download here: {download.stderr.strip().splitlines()[-1]}")
    install = host.run("-m", "pip", "install", "--quiet", str(REPOSITORY), PIP_CONSTRAINT=str(LOCK))
    assert install.returncode == 0, install.stderr
    return host


@pytest.fixture
def free_port() -> int:
    """A port of this host that nobody listens on."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


@contextmanager
def router(host: Host, port: int) -> Iterator[str]:
    """A router of the host on this port; its endpoint."""
    endpoint = f"tcp/127.0.0.1:{port}"
    process = subprocess.Popen(
        [host.python, "-m", "zsight", "run", "router", "--listen", endpoint],
        env={**OWN, "ZSIGHT_CONNECT": endpoint},
        cwd=host.python.parent,
        stderr=subprocess.DEVNULL,
    )
    try:
        yield endpoint
    finally:
        process.terminate()
        assert process.wait(10) == 0


def test_nothing_heavy_is_installed(host: Host) -> None:
    packages = {p["name"].lower() for p in json.loads(host.run("-m", "pip", "list", "--format", "json").stdout)}
    assert "zsight" in packages
    assert packages.isdisjoint({*HEAVY, "open3d-cpu", "llvmlite", "pillow"})


def test_the_client_and_the_command_line_can_be_imported(host: Host) -> None:
    code = "import zsight, zsight.client, zsight.cli, zsight.services; assert callable(zsight.connect); print('here')"
    done = host.run("-W", "error", "-c", code)
    assert (done.stdout.strip(), done.returncode) == ("here", 0), done.stderr


def test_every_protocol_module_can_be_imported(host: Host) -> None:
    code = (
        "import importlib, pkgutil, zsight_protocol as package\n"
        "names = [module.name for module in pkgutil.iter_modules(package.__path__, 'zsight_protocol.')]\n"
        "print(len([importlib.import_module(name) for name in names]))"
    )
    done = host.run("-c", code)
    assert int(done.stdout) >= 11, done.stderr


def test_types_and_scenes_come_along(host: Host) -> None:
    code = (
        "from importlib.resources import files; root = files('zsight')\n"
        "print(*[str(root / f) for f in ('types/toy_block.yaml', 'types/mug.stl', 'scenes/book.yaml', 'py.typed')])"
    )
    paths = host.run("-c", code).stdout.split()
    assert len(paths) == 4
    assert all(Path(path).is_file() for path in paths), paths


@pytest.mark.parametrize(
    "command", [["--help"], ["find", "--help"], ["run", "--help"], ["topic", "--help"], ["version"]]
)
def test_a_command_that_needs_no_perception_works(host: Host, command: list[str]) -> None:
    done = host.zsight(*command)
    assert done.returncode == 0, done.stderr
    assert done.stdout


@pytest.mark.parametrize(
    "command", [["run", "voxel", "--help"], ["downsample", "x.pcd", "--leaf", "0.02", "-o", "y.pcd"]]
)
def test_a_command_that_needs_perception_says_how_to_get_it(host: Host, command: list[str]) -> None:
    done = host.zsight(*command)
    assert done.returncode == 2
    assert "is not installed; it comes with: pip install 'zsight[" in done.stderr
    assert "Traceback" not in done.stderr


def test_a_client_without_a_router_says_which_endpoint_it_tried(host: Host, free_port: int) -> None:
    done = host.zsight("find", "toy_block", "--connect", f"tcp/127.0.0.1:{free_port}")
    assert done.returncode == 3
    assert f"tcp/127.0.0.1:{free_port}" in done.stderr
    assert "Traceback" not in done.stderr


def test_a_router_runs_and_a_client_joins_it(host: Host, free_port: int) -> None:
    code = (
        "from zsight.client import CellClient\n"
        "from zsight.errors import NobodyAnswers\n"
        "from zsight.network import Network\n"
        "from zsight.runtime import join\n"
        "try:\n"
        "    with CellClient(join(Network.from_environment(), wait=20)) as client:\n"
        "        client.find('toy_block', timeout=5)\n"
        "except NobodyAnswers as error: print('nobody', error)\n"
    )
    with router(host, free_port) as endpoint:
        done = host.run("-c", code, ZSIGHT_CONNECT=endpoint)
    assert done.stdout.startswith("nobody"), done.stderr


def test_importing_the_command_line_imports_nothing_heavy() -> None:
    code = f"import sys, zsight.cli, zsight.client; print(*[m for m in {HEAVY!r} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    assert done.stdout.split() == []


def test_asking_for_help_takes_less_than_half_a_second() -> None:
    """Processor time, which on an idle machine is the time that passes; a slow machine is measured by its imports."""
    libraries = fastest("-c", "import numpy, pydantic.types, typer.main")
    assert fastest("-m", "zsight", "find", "--help") < max(0.5, 2 * libraries)


def fastest(*arguments: str) -> float:
    """Least processor time of several runs of this interpreter, seconds."""
    seconds = []
    for _ in range(6):
        before = processor_time_of_children()
        subprocess.run([sys.executable, *arguments], capture_output=True, check=True, timeout=60)
        seconds.append(processor_time_of_children() - before)
    return min(seconds)


def processor_time_of_children() -> float:
    times = os.times()
    return times.children_user + times.children_system


def test_the_lock_names_versions_only() -> None:
    lines = [line for line in LOCK.read_text().splitlines() if not line.startswith("#")]
    assert lines == sorted(lines, key=lambda line: re.split("[=;]", line)[0])
    assert all(
        re.fullmatch(r"[a-z0-9-]+==[0-9][0-9a-z.+]*(; [a-z_]+ [!=]= '\w+' (and|or) [a-z_]+ [!=]= '\w+')?", x)
        for x in lines
    )
