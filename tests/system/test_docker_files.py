"""The compose file, the Dockerfile and the systemd units agree with each other and with the process table."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import yaml

from zsight.keys.identity import read_hosts, read_identity
from zsight.keys.roles import ROLES
from zsight.services import SERVICES, service
from zsight.settings import parse

REPOSITORY = Path(__file__).resolve().parent.parent.parent
DOCKER = REPOSITORY / "docker"
UNIT = DOCKER / "systemd" / "zsight@.service"


@pytest.fixture(scope="module")
def compose() -> dict[str, Any]:
    loaded: dict[str, Any] = yaml.safe_load((DOCKER / "compose.yaml").read_text())
    return loaded


def options(command: list[str]) -> dict[str, str]:
    """Pairs of a command's ``--name value``."""
    return {name.removeprefix("--"): value for name, value in zip(command[2::2], command[3::2], strict=True)}


def processes(compose: dict[str, Any]) -> dict[str, Any]:
    """The containers that stay: all but the one that makes keys."""
    return {name: container for name, container in compose["services"].items() if name != "keys"}


def test_every_container_runs_a_service_of_the_table(compose: dict[str, Any]) -> None:
    for name, container in processes(compose).items():
        assert container["command"][:2] == ["run", name]
        settings = {k: v for k, v in options(container["command"]).items() if k not in ("listen", "connect")}
        parse(service(name).settings(), settings)
    assert set(processes(compose)) <= {row.name for row in SERVICES}


def test_a_router_and_all_that_finding_needs_are_there(compose: dict[str, Any]) -> None:
    assert set(compose["services"]) >= {"router", "camera", "voxel", "planes", "finder", "recorder"}


def test_everybody_joins_the_port_on_which_the_router_listens(compose: dict[str, Any]) -> None:
    listen = options(compose["services"]["router"]["command"])["listen"]
    for name, container in processes(compose).items():
        host = "localhost" if name == "router" else "router"
        assert container["environment"]["ZSIGHT_CONNECT"] == listen.replace("0.0.0.0", host)  # noqa: S104  in a container


def test_every_process_has_keys_of_its_own_that_are_made(compose: dict[str, Any]) -> None:
    (added,) = re.findall(r"keys add ([a-z ]+) --folder", compose["services"]["keys"]["command"][0])
    for name, container in processes(compose).items():
        assert container["environment"]["ZSIGHT_KEYS"] == f"keys/{name}"
        assert "keys:/home/zsight/keys:ro" in container["volumes"]
        assert name == "router" or name in added.split()
        assert name in ROLES
    assert "authority" not in str([container["volumes"] for container in processes(compose).values()])


def test_every_process_is_asked_by_the_doctor_how_it_is(compose: dict[str, Any]) -> None:
    for name, container in processes(compose).items():
        assert container["healthcheck"]["test"] == ["CMD", "zsight", "doctor", "--process", name]


def test_the_container_of_keys_makes_them(compose: dict[str, Any], tmp_path: Path) -> None:
    (tmp_path / "authority").mkdir()
    (tmp_path / "keys").mkdir()
    (script,) = compose["services"]["keys"]["command"]
    environment = {**os.environ, "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}"}
    command = ["sh", "-ec", script]
    for _ in range(2):  # the second start keeps what the first one made
        subprocess.run(command, cwd=tmp_path, env=environment, check=True, capture_output=True, timeout=100)
    assert {path.name for path in (tmp_path / "keys").iterdir()} == {*processes(compose), "desk"}
    router = tmp_path / "keys" / "router"
    assert {host.host for host in read_hosts(router)} == {*processes(compose), "desk"}
    assert read_identity(tmp_path / "keys" / "finder").roles == ("finder",)


def test_the_router_is_published_on_the_loopback_alone(compose: dict[str, Any]) -> None:
    for name, container in compose["services"].items():
        assert all(port.startswith("127.0.0.1:") for port in container.get("ports", [])), name


def test_the_shared_memory_holds_many_clouds_and_is_one(compose: dict[str, Any]) -> None:
    services = processes(compose)
    assert int(services["router"]["shm_size"].removesuffix("mb")) >= 256
    assert services["router"]["ipc"] == "shareable"
    assert {services[name]["ipc"] for name in services if name != "router"} == {"service:router"}


def test_targets_are_stages_of_the_dockerfile(compose: dict[str, Any]) -> None:
    text = (DOCKER / "Dockerfile").read_text()
    stages = set(re.findall(r"^FROM \S+ AS (\S+)$", text, re.MULTILINE))
    for container in compose["services"].values():
        assert container["build"]["target"] in stages
        assert container["image"] == f"zsight:{container['build']['target']}"
        assert (DOCKER / container["build"]["context"] / container["build"]["dockerfile"]).samefile(
            DOCKER / "Dockerfile"
        )


def test_images_run_without_root() -> None:
    text = (DOCKER / "Dockerfile").read_text()
    assert text.index("USER zsight") > text.index("AS host")
    assert len(re.findall(r"^FROM host AS (client|perception)$", text, re.MULTILINE)) == 2
    assert "USER root" not in text


def test_what_an_image_is_made_of_is_let_into_its_context() -> None:
    allowed = {line[1:] for line in (REPOSITORY / ".dockerignore").read_text().splitlines() if line.startswith("!")}
    assert all((REPOSITORY / name).exists() for name in allowed)
    assert allowed >= {"core", "protocol", "services", "pyproject.toml", "requirements.lock", "README.md", "LICENSE"}


@pytest.mark.system
def test_systemd_accepts_the_unit(tmp_path: Path) -> None:
    if shutil.which("systemd-analyze") is None:
        pytest.skip("no systemd-analyze on this machine")
    # The program need not be installed here: any other stands in for it.
    copy = tmp_path / UNIT.name
    copy.write_text(UNIT.read_text().replace("/opt/zsight/bin/zsight", "/bin/true"))
    done = subprocess.run(["systemd-analyze", "verify", copy], capture_output=True, text=True, timeout=60, check=False)
    ours = [line for line in done.stderr.splitlines() if "zsight" in line]
    assert ours == [], done.stderr
    assert done.returncode == 0, done.stderr
