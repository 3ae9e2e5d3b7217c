"""The images are built from the Dockerfile, and their services talk with keys over a network of several hosts."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from tests.services.waiting import soon
from tests.system.commands import run

if TYPE_CHECKING:
    from collections.abc import Iterator

REPOSITORY = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(REPOSITORY / "bench"))
hosts_module = import_module("network_hosts")

BASE = "docker.io/library/python:3.11-slim"
PATIENCE = 300.0  # seconds; kernels are compiled in a new container
BUILD = {**os.environ, "STORAGE_DRIVER": "vfs", "BUILDAH_ISOLATION": "chroot"}


def why_not() -> str | None:
    """Why no image can be built here; none where one can."""
    if shutil.which("buildah") is None:
        return "no buildah on this machine"
    found = subprocess.run(["buildah", "images", "-q", BASE], env=BUILD, capture_output=True, text=True, check=False)
    if not found.stdout.strip():
        return f"the base image {BASE} is not here, and tests download nothing"
    reason: str | None = hosts_module.why_not()
    return reason


pytestmark = [
    pytest.mark.system,
    pytest.mark.timeout(2400),
    pytest.mark.skipif(why_not() is not None, reason=str(why_not())),
]


def buildah(*arguments: object) -> str:
    """A command of buildah and what it prints."""
    command = ["buildah", *map(str, arguments)]
    done = subprocess.run(command, env=BUILD, capture_output=True, text=True, timeout=2000, check=False)
    assert done.returncode == 0, done.stderr[-4000:]
    return done.stdout.strip()


@pytest.fixture(scope="module", params=["client", "perception"])
def image(request: pytest.FixtureRequest) -> str:
    """An image of the Dockerfile."""
    built(request.param)
    return f"zsight:{request.param}"


def built(target: str) -> None:
    file = REPOSITORY / "docker" / "Dockerfile"
    options = ("--isolation", "chroot", "--pull-never", "--layers", "--target", target, "-t", f"zsight:{target}")
    buildah("bud", *options, "-f", file, REPOSITORY)


@pytest.fixture
def container(image: str) -> Iterator[str]:
    name = buildah("from", "--pull-never", image)
    yield name
    buildah("rm", name)


def inside(name: str, *command: str) -> str:
    return buildah("run", "--isolation", "chroot", name, "--", *command)


def test_an_image_runs_without_root_and_holds_what_it_is_for(container: str, image: str) -> None:
    assert inside(container, "id", "-u") == "10001"
    assert inside(container, "zsight", "version") == "0.1.0"
    look = (
        "import importlib.util as u; print([n for n in ('numba', 'open3d', 'mcap', 'cryptography') if u.find_spec(n)])"
    )
    held = inside(container, "python", "-c", look)
    assert held == ("['cryptography']" if image.endswith("client") else "['numba', 'open3d', 'mcap', 'cryptography']")


class Containers:
    """Containers that run on the hosts of a network; the end of the block ends and removes them."""

    def __init__(self, hosts: Any, keys: Path) -> None:
        self._hosts = hosts
        self._keys = keys
        self._processes: list[subprocess.Popen[bytes]] = []
        self._names: dict[str, str] = {}

    def _name(self, target: str) -> str:
        """One container of each image: a copy of its files costs more than all else here."""
        if target not in self._names:
            self._names[target] = buildah("from", "--pull-never", f"zsight:{target}")
        return self._names[target]

    def start(self, host: int, target: str, *command: str, **environment: str) -> subprocess.Popen[bytes]:
        name = self._name(target)
        variables = [part for key, value in environment.items() for part in ("--env", f"{key}={value}")]
        options = ["run", "--isolation", "chroot", "-v", f"{self._keys}:/home/zsight/keys", *variables, name, "--"]
        whole = self._hosts.command(host, "buildah", *options, "zsight", *command)
        process = subprocess.Popen(whole, env=BUILD, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
        self._processes.append(process)
        return process

    def ask(self, host: int, *command: str, **environment: str) -> tuple[int, str]:
        """A command in a container, from start to end: its exit code and what it printed."""
        process = self.start(host, "client", *command, **environment)
        out, _ = process.communicate(timeout=100)
        return process.returncode, out.decode(errors="replace")

    def close(self) -> None:
        for process in self._processes:
            process.terminate()
        for process in self._processes:
            try:
                process.wait(20)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
            if process.stdout is not None:
                process.stdout.close()
        for name in self._names.values():
            buildah("rm", name)


def test_containers_on_two_hosts_talk_with_keys(tmp_path: Path) -> None:
    for target in ("client", "perception"):
        built(target)
    with hosts_module.Hosts(2) as hosts:
        authority = tmp_path / "keys"
        run("keys", "init", hosts.address(1), "--folder", authority)
        for host, role in (("eye", "camera"), ("sieve", "voxel"), ("desk", "operator")):
            assert run("keys", "add", host, "--role", role, "--folder", authority).code == 0
        for path in (tmp_path, *authority.rglob("*"), authority):
            os.chown(path, 10001, 10001)
        tmp_path.chmod(0o755)
        endpoint = f"tls/{hosts.address(1)}:7447"
        containers = Containers(hosts, authority)

        def having(host: str) -> dict[str, str]:
            return {"ZSIGHT_KEYS": f"keys/{host}", "ZSIGHT_CONNECT": endpoint}

        try:
            containers.start(1, "client", "run", "router", "--listen", "tls/0.0.0.0:7447", **having("router"))
            containers.start(2, "perception", "run", "camera", "--source", "ellipse", "--rate", "10", **having("eye"))
            containers.start(2, "perception", "run", "voxel", "--leaf", "0.05", **having("sieve"))

            def processes() -> list[str]:
                code, out = containers.ask(1, "node", "list", "--json", **having("desk"))
                return sorted(n["process"] for n in json.loads(out.splitlines()[-1])["nodes"]) if code == 0 else []

            assert soon(lambda: processes() == ["camera", "router", "voxel"], PATIENCE)
            count = ("topic", "hz", "zsight/kinect/points/voxel", "--count", "5", "--json")

            def messages() -> int:
                code, out = containers.ask(1, *count, **having("desk"))
                return int(json.loads(out.splitlines()[-1])["messages"]) if code == 0 else 0

            assert soon(lambda: messages() == 5, PATIENCE)
            code, out = containers.ask(2, "doctor", "--process", "camera", **having("eye"))
            assert code == 0, out
        finally:
            containers.close()
