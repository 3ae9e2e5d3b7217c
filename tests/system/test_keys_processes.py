"""Keys between real processes: a rogue's own log says why; a host is revoked while the router runs."""

from __future__ import annotations

import shutil
from typing import TYPE_CHECKING

import pytest
from tests.services.waiting import soon
from tests.system.commands import DEADLINE, Command, free_port, run

if TYPE_CHECKING:
    from pathlib import Path

    from tests.system.commands import Ended

pytestmark = pytest.mark.system


def test_a_cell_with_keys(tmp_path: Path) -> None:
    authority = tmp_path / "authority"
    endpoint = f"tls/127.0.0.1:{free_port()}"
    assert run("keys", "init", "127.0.0.1", "--folder", authority).code == 0
    for host, role in (("eye", "camera"), ("mind", "finder"), ("desk", "operator"), ("gone", "operator")):
        assert run("keys", "add", host, "--role", role, "--folder", authority).code == 0

    def having(host: str) -> dict[str, str]:
        return {"ZSIGHT_KEYS": str(authority / host), "ZSIGHT_CONNECT": endpoint, "ZSIGHT_LISTEN": endpoint}

    def processes(host: str) -> Ended:
        return run("node", "list", "--json", **having(host))

    def names() -> list[str]:
        ended = processes("desk")
        return sorted(f"{n['host']}/{n['process']}" for n in ended.json["nodes"]) if ended.code == 0 else []

    camera = ("run", "camera", "--source", "ellipse")
    with Command("run", "router", **having("router")) as router, Command(*camera, **having("eye")):
        assert soon(lambda: names() == ["eye/camera", "router/router"], DEADLINE)
        rogue = run(*camera, **having("mind"))
        assert rogue.code == 2
        assert "keys of mind do not allow to publish zsight/kinect/points: its roles are finder" in rogue.err

        shutil.copytree(authority / "gone", tmp_path / "kept")
        assert processes("gone").code == 0
        assert run("keys", "revoke", "gone", "--folder", authority).code == 0
        router.wait_for("the list of hosts has changed")
        refused = run("node", "list", **{**having("desk"), "ZSIGHT_KEYS": str(tmp_path / "kept")})
        assert refused.code == 3
        assert f"{endpoint}: certificate: it does not trust this host's: it was revoked" in refused.err
        assert soon(lambda: names() == ["eye/camera", "router/router"], DEADLINE)
