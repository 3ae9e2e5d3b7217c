"""Scene files: what ships is the book's scene; mistakes are named."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from zsight.catalogue import type_files
from zsight.errors import UsageError
from zsight.scene_file import build, find_scene, read
from zsight_core.simulation.kinect import Kinect
from zsight_core.transform import from_quaternion, from_rpy
from zsight_protocol.object_type import BoxShape

if TYPE_CHECKING:
    from pathlib import Path

SCENE = """\
name: small
camera:
  frame: eye
  chain:
    - {parent: world, frame: post, position: [0, 0, 1]}
    - {parent: post, frame: eye, orientation: [-0.5, 0.5, -0.5, 0.5]}
noise: {model: kinect, seed: 3}
objects:
  - {type: cube, position: [1, 0, 0.5], rpy: [0, 0, 0.2], colour: [1, 2, 3]}
"""


def written(folder: Path, text: str) -> Path:
    path = folder / "scene.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def test_the_books_scene_is_the_books() -> None:
    scene = build(read(find_scene("book")), type_files.load(type_files.shipped_folder()))
    expected = from_rpy((0.027, 0, 1.810), (0, 1.2, 0)) @ from_quaternion((0, 0, 0), (-0.5, 0.5, -0.5, 0.5))
    np.testing.assert_allclose(scene.camera.T_world_camera, expected, atol=1e-12)
    assert (scene.camera.pinhole.width, scene.camera.pinhole.height) == (640, 480)
    assert scene.camera.pinhole.fx == scene.camera.pinhole.fy == pytest.approx(554.38, abs=0.01)
    assert scene.noise is None
    np.testing.assert_allclose(scene.truth("toy_block"), [from_rpy((0.5, -0.35, 0.7922), (0, 0, 0.43))])
    top = next(entry for entry in scene.file.objects if entry.name == "table_top")
    assert top.shape is not None
    assert top.shape.box == BoxShape(size=(0.9144, 0.9144, 0.04))
    assert top.position[2] + 0.02 == pytest.approx(0.7747)


def test_a_scene_is_built_as_written(tmp_path: Path) -> None:
    scene = build(read(written(tmp_path, SCENE)), type_files.load(type_files.shipped_folder()))
    assert scene.file.world_frame == "world"
    assert isinstance(scene.noise, Kinect)
    assert scene.file.noise.seed == 3
    np.testing.assert_allclose(scene.camera.T_world_camera[:3, 3], (0, 0, 1))
    (cube,) = scene.world.bodies
    np.testing.assert_allclose(cube.T_world_model, from_rpy((1, 0, 0.5), (0, 0, 0.2)))
    assert cube.model.colour == (1, 2, 3)
    np.testing.assert_allclose(scene.truth("cube"), [cube.T_world_model])
    assert scene.truth("mug") == []


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("name: small", "nam: small", "name: Field required"),
        ("frame: eye\n", "frame: eye\n  hfov: 4\n", "camera.hfov: Input should be less than 3.1"),
        ("frame: eye\n", "frame: eye\n  width: 0\n", "camera.width: Input should be greater"),
        ("frame: eye\n", "frame: nose\n", "camera: the chain ends at eye; expected the camera's frame nose"),
        ("parent: post", "parent: pole", "camera: the chain breaks: post is followed by a step from pole"),
        ("model: kinect", "model: rain", "noise.model: Input should be 'none', 'kinect' or 'time_of_flight'"),
        ("seed: 3", "seed: -1", "noise.seed"),
        ("type: cube, ", "", "objects.0: expected either a catalogue type or a shape"),
        ("type: cube", "type: cube, shape: {sphere: {diameter: 1}}", "objects.0: expected either"),
        ("[1, 0, 0.5]", "[1, 0]", "objects.0.position"),
        ("[1, 0, 0.5]", "[1, 0, .nan]", "objects.0.position"),
        ("[1, 2, 3]", "[1, 2, 300]", "objects.0.colour.2"),
    ],
)
def test_a_mistake_is_shown_with_its_place(tmp_path: Path, old: str, new: str, words: str) -> None:
    assert old in SCENE
    path = written(tmp_path, SCENE.replace(old, new))
    with pytest.raises(UsageError) as caught:
        read(path)
    assert str(caught.value).startswith(str(path))
    assert words in str(caught.value)


@pytest.mark.parametrize("text", ["", "[", "- 1", "a: 1\n---\nb: 2", "\0"])
def test_what_is_no_scene_is_refused(tmp_path: Path, text: str) -> None:
    path = written(tmp_path, text)
    with pytest.raises(UsageError, match=r"scene.yaml"):
        read(path)


def test_scenes_that_are_not_there_are_named(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"no scene is called 'boook'; expected one of .*book"):
        find_scene("boook")
    with pytest.raises(UsageError, match=r"absent.yaml does not exist"):
        find_scene(str(tmp_path / "absent.yaml"))
    with pytest.raises(UsageError, match="cannot be read"):
        read(tmp_path / "absent.yaml")


def test_a_type_that_nobody_knows_is_refused(tmp_path: Path) -> None:
    file = read(written(tmp_path, SCENE.replace("type: cube", "type: cub")))
    with pytest.raises(UsageError, match="did you mean cube"):
        build(file, type_files.load(type_files.shipped_folder()))


@pytest.mark.parametrize("orientation", ["[0, 0, 0, 0]", "[.nan, 0, 0, 1]"])
def test_a_turn_that_is_none_is_refused(tmp_path: Path, orientation: str) -> None:
    text = SCENE.replace("[-0.5, 0.5, -0.5, 0.5]", orientation)
    with pytest.raises(UsageError, match=r"scene.yaml"):
        read(written(tmp_path, text))
