"""Camera files beside depth images."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import pytest

from zsight_core.errors import FileError
from zsight_core.files import depth_camera
from zsight_core.files.depth_camera import DepthCamera
from zsight_core.pinhole import Pinhole

if TYPE_CHECKING:
    from pathlib import Path

FACTS: dict[str, Any] = {"width": 640, "height": 480, "fx": 525, "fy": 526.5, "cx": 319.5, "cy": 239.5}


def write(folder: Path, facts: dict[str, Any], suffix: str = ".json") -> Path:
    path = folder / f"camera{suffix}"
    toml = "\n".join(f"{key} = {json.dumps(value)}" for key, value in facts.items())
    path.write_text(json.dumps(facts) if suffix == ".json" else toml, encoding="utf-8")
    return path


@pytest.mark.parametrize("suffix", [".json", ".toml"])
def test_both_kinds_of_file_say_the_same(tmp_path: Path, suffix: str) -> None:
    path = write(tmp_path, FACTS | {"depth_scale": 0.0001, "distortion": [0.1, -0.2, 0, 0, 0.05]}, suffix)
    expected = DepthCamera(Pinhole(640, 480, 525, 526.5, 319.5, 239.5, (0.1, -0.2, 0, 0, 0.05)), 0.0001)
    assert depth_camera.read(path) == expected
    assert depth_camera.find(tmp_path) == expected


def test_the_unit_is_a_millimetre_unless_told(tmp_path: Path) -> None:
    assert depth_camera.read(write(tmp_path, FACTS)) == DepthCamera(Pinhole(640, 480, 525, 526.5, 319.5, 239.5), 0.001)


def test_a_folder_without_a_camera_has_none(tmp_path: Path) -> None:
    assert depth_camera.find(tmp_path) is None


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"widht": 3}, "widht"),
        ({"width": 640.5}, "width is 640.5"),
        ({"width": True}, "width is True"),
        ({"height": 0}, "height is 0"),
        ({"height": 1 << 40}, "height is"),
        ({"fx": "525"}, "fx is '525'"),
        ({"fx": 0}, "focal lengths above zero"),
        ({"cx": None}, "cx is None"),
        ({"cy": 10**400}, "cy is"),
        ({"depth_scale": 1000}, "metres a unit"),
        ({"depth_scale": 0}, "metres a unit"),
        ({"distortion": [1, 2]}, "five numbers"),
        ({"distortion": [1, 2, 3, 4, "a"]}, "distortion is 'a'"),
        ({"distortion": 1}, "five numbers"),
    ],
)
def test_facts_that_make_no_sense_are_refused(tmp_path: Path, change: dict[str, Any], complaint: str) -> None:
    with pytest.raises(FileError, match=complaint):
        depth_camera.read(write(tmp_path, FACTS | change))


@pytest.mark.parametrize("key", FACTS)
def test_a_missing_key_is_named(tmp_path: Path, key: str) -> None:
    with pytest.raises(FileError, match=rf"lacks the keys \['{key}'\]"):
        depth_camera.read(write(tmp_path, {name: value for name, value in FACTS.items() if name != key}))


@pytest.mark.parametrize("name", ["camera.json", "camera.toml"])
@pytest.mark.parametrize(
    "text", [b"", b"width = ", b"{", b"\xff\xfe", b"[1]", b"[" * 100_000, b'{"width": ' + b"9" * 5000 + b"}", b"NaN"]
)
def test_files_that_cannot_be_understood_are_refused(tmp_path: Path, name: str, text: bytes) -> None:
    (tmp_path / name).write_bytes(text)
    with pytest.raises(FileError):
        depth_camera.find(tmp_path)


def test_a_large_file_is_no_camera_file(tmp_path: Path) -> None:
    (tmp_path / "camera.json").write_bytes(b" " * (2 << 20))
    with pytest.raises(FileError, match="no camera file"):
        depth_camera.find(tmp_path)
    with pytest.raises(FileError, match="No such file"):
        depth_camera.read(tmp_path / "nowhere.json")
