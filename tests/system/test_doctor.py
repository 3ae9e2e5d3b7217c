"""The doctor looks at a host with a cell, without one, and at one process for a container's health."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest
from tests.services.waiting import soon
from tests.system.commands import DEADLINE, Command, free_port, run

if TYPE_CHECKING:
    from pathlib import Path

pytestmark = pytest.mark.system


def checks_of(ended: Any) -> dict[str, dict[str, str]]:
    return {check["check"]: check for check in ended.json["checks"]}


def test_a_cell_is_examined(tmp_path: Path) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    environment = {
        "ZSIGHT_CONNECT": endpoint,
        "ZSIGHT_LISTEN": endpoint,
        "ZSIGHT_HOST": "here",
        "ZSIGHT_CONFIG": "",
        "XDG_CONFIG_HOME": str(tmp_path),
    }
    camera = ("run", "camera", "--source", "ellipse", "--rate", "10", "--pose", "0 0 1 0 0 0 1")
    with Command("run", "router", **environment), Command(*camera, **environment):
        assert soon(lambda: run("doctor", "--process", "camera", **environment).code == 0, DEADLINE)
        well = run("doctor", "--process", "camera", "--json", **environment)
        assert well.json["healthy"] is True
        assert set(checks_of(well)) == {"shared memory", f"endpoint {endpoint}", "process camera"}

        nobody = run("doctor", "--process", "voxel", "--json", **environment)
        assert (nobody.code, nobody.json["healthy"]) == (1, False)
        assert checks_of(nobody)["process voxel"]["status"] == "failed"

        whole = checks_of(run("doctor", "--json", **environment))
        assert set(whole) >= {"versions", "kernels", "disk", "certificate", "cell", "round trip", "clocks"}
        assert "2 processes on 1 hosts" in whole["cell"]["found"]
        assert "ms" in whole["round trip"]["found"]
        assert whole["cloud round trip"]["found"].startswith("4.9 MB in ")
        assert whole["certificate"]["status"] == "skipped"
        assert "which stands in world" in whole["camera kinect"]["found"]
        assert {name for name, check in whole.items() if check["status"] == "failed"} == set()

        second = run("node", "list", "--namespace", "other", **environment)
        assert second.code == 3
        assert "a router answers, but cell other is empty" in second.err

    alone = run("doctor", **environment)
    assert alone.code == 1
    assert f"failed   endpoint {endpoint}: refused" in alone.out
    assert "-> " in alone.out
