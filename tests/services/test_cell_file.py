"""Tables of processes, and the settings in them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from zsight import camera, finder, voxel
from zsight.errors import UsageError
from zsight.hosts.cell_file import DEFAULT_TABLE, ProcessEntry, read
from zsight.services import SERVICES, service
from zsight.settings import describe, parse

if TYPE_CHECKING:
    from pathlib import Path


def written(folder: Path, text: str) -> Path:
    path = folder / "cell.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_the_table_without_a_file_is_the_chapters() -> None:
    assert [entry.service for entry in DEFAULT_TABLE.processes] == ["router", "camera", "voxel", "planes", "finder"]
    assert {row.name for row in SERVICES} >= {entry.service for entry in DEFAULT_TABLE.processes}


def test_every_service_explains_every_setting() -> None:
    for row in SERVICES:
        for name, default, words in describe(row.settings()):
            assert words, f"{row.name} --{name}"
            assert default != ""
        assert callable(row.run())


def test_a_table_is_read_whole(tmp_path: Path) -> None:
    path = written(
        tmp_path,
        """
        namespace = "cell7"
        listen = ["tcp/0.0.0.0:7450", "tcp/[::]:7450"]
        connect = "tcp/192.0.2.7:7447"
        [process.router]
        [process.left]
        service = "camera"
        camera = "left"
        source = "ellipse"
        loop = false
        rate = 2
        """,
    )
    table = read(path)
    assert (table.namespace, table.connect) == ("cell7", ("tcp/192.0.2.7:7447",))
    assert table.listen == ("tcp/0.0.0.0:7450", "tcp/[::]:7450")
    assert table.processes == (
        ProcessEntry("router", "router"),
        ProcessEntry("left", "camera", {"camera": "left", "source": "ellipse", "loop": False, "rate": 2}),
    )


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[process.", "not TOML"),
        ("", r"no \[process.NAME\] table"),
        ("process = 5", r"no \[process.NAME\] table"),
        ("process.router = 5", "process router is 5; expected a table"),
        ("[proces.router]", "proces is unknown; expected namespace, connect, listen, process"),
        ("[process.Router]", "process is 'Router'; expected lower-case letters"),
        ("[process.eye]", "no service is called 'eye'"),
        ("[process.eye]\nservice = 'camra'", "did you mean camera"),
        ("[process.eye]\nservice = 5", "service"),
        ("[process.voxel]\nleef = 0.1", "no setting is called leef; known are camera, leaf"),
        ("[process.voxel]\nleaf = 0", "setting leaf is 0: Input should be greater than 0"),
        ("[process.voxel]\nleaf = 'fine'", "setting leaf is 'fine'"),
        ("namespace = 5\n[process.voxel]", "namespace"),
        ("namespace = 'Cell 7'\n[process.voxel]", "namespace"),
        ("connect = 5\n[process.voxel]", "connect"),
        ("listen = [5]\n[process.voxel]", "listen"),
        ("listen = []\n[process.voxel]", "listen"),
    ],
)
def test_a_mistake_is_named_with_its_file(tmp_path: Path, text: str, words: str) -> None:
    path = written(tmp_path, text)
    with pytest.raises(UsageError, match=words) as caught:
        read(path)
    assert str(caught.value).startswith(str(path))


def test_files_that_cannot_be_read_are_named(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"absent.toml: cannot be read"):
        read(tmp_path / "absent.toml")
    (tmp_path / "latin.toml").write_bytes(b"namespace = 'caf\xe9'")
    with pytest.raises(UsageError, match="not TOML"):
        read(tmp_path / "latin.toml")


# Settings from text, as the command line has them.


def test_settings_come_from_text() -> None:
    assert parse(voxel.Settings, {"leaf": "0.05", "camera": "left"}) == voxel.Settings(leaf=0.05, camera="left")
    assert parse(camera.Settings, {"world-frame": "map", "loop": "false", "seed": "3"}) == camera.Settings(
        world_frame="map", loop=False, seed=3
    )
    assert parse(finder.Settings, {}) == finder.Settings()


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("leaf", "-1", "setting leaf is '-1': Input should be greater than 0"),
        ("leaf", "11", "less than or equal to 10"),
        ("leaf", "nan", "setting leaf is 'nan'"),
        ("leaf", "", "setting leaf is ''"),
        ("leafs", "1", "no setting is called leafs; known are camera, leaf"),
    ],
)
def test_a_bad_setting_is_named(name: str, value: str, words: str) -> None:
    with pytest.raises(UsageError, match=words):
        parse(voxel.Settings, {name: value})


def test_an_unknown_service_is_named() -> None:
    with pytest.raises(UsageError, match="did you mean voxel"):
        service("voxels")
    with pytest.raises(UsageError, match="expected one of router, camera"):
        service("xyz")
