"""The catalogue of object types: what ships, what is refused and how it is said."""

from __future__ import annotations

import json
import struct
from typing import TYPE_CHECKING

import numpy as np
import pytest

from zsight.catalogue.type_files import Catalogue, load, read_type, shipped_folder, write_type
from zsight.errors import UsageError
from zsight_core import open3d_module
from zsight_core.errors import FileError
from zsight_core.model import Box, Mesh, size_of
from zsight_core.solid import solid_of
from zsight_protocol.object_type import BoxShape, ObjectType, ShapeOf

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

GOOD = """\
name: crate
code: 77
shape:
  box: {size: [0.3, 0.2, 0.1]}
colour: [1, 2, 3]
notes: Fragile.
grasps:
  - {approach: [0, 0, -1], width: 0.2}
properties: {mass: 1.5}
"""


def written(folder: Path, text: str, name: str = "crate.yaml") -> Path:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def test_every_type_that_ships_has_a_model() -> None:
    catalogue = load(shipped_folder())
    models = {model.name: model for model in catalogue.models()}
    assert set(models) == {
        "ball", "coke_can", "cube", "domino", "l_bracket", "milk_carton", "mug", "slim_can", "table_surface", "tea_box",
        "toy_block",
    }  # fmt: skip
    codes = [kind.code for kind in catalogue.types.values()]
    assert len(set(codes)) == len(codes)
    for name in ("mug", "l_bracket", "milk_carton"):
        shape = models[name].shape
        assert isinstance(shape, Mesh)
        np.testing.assert_allclose(shape.vertices.min(axis=0) + shape.vertices.max(axis=0), 0, atol=1e-4)
    assert size_of(models["milk_carton"].shape) == pytest.approx((0.095, 0.095, 0.228), abs=1e-3)


@pytest.mark.parametrize(
    ("code", "name"), [("1000", "toy_block"), ("1001", "coke_can"), ("1002", "table_surface"), ("mug", "mug")]
)
def test_a_type_is_known_by_its_name_and_the_books_number(code: str, name: str) -> None:
    assert load(shipped_folder()).resolve(code).name == name


@pytest.mark.parametrize(
    ("wanted", "words"),
    [
        ("toy_blok", "did you mean toy_block"),
        ("can", "coke_can or slim_can|slim_can or coke_can"),
        ("9999", "known are ball, coke_can, cube"),
        ("", "known are"),
    ],
)
def test_an_unknown_type_is_refused_with_the_nearest_names(wanted: str, words: str) -> None:
    with pytest.raises(UsageError, match=words):
        load(shipped_folder()).resolve(wanted)


def test_a_file_is_read_whole(tmp_path: Path) -> None:
    kind = read_type(written(tmp_path, GOOD))
    assert (kind.name, kind.code, kind.colour, kind.notes) == ("crate", 77, (1, 2, 3), "Fragile.")
    assert kind.shape.box == BoxShape(size=(0.3, 0.2, 0.1))
    assert kind.grasps == ({"approach": [0, 0, -1], "width": 0.2},)
    assert kind.properties == {"mass": 1.5}


@pytest.mark.parametrize(
    ("old", "new", "line", "words"),
    [
        ("name: crate", "name: Big Crate", 1, "name: String should match"),
        ("code: 77", "code: many", 2, "code: Input should be a valid integer"),
        ("code: 77", "code: true", 2, "code"),
        ("shape:", "shap:", 1, "shape: Field required"),
        ("box:", "bocks:", 4, "shape.bocks: Extra inputs"),
        ("[0.3, 0.2, 0.1]", "[0.3, 0.2]", 4, "shape.box.size"),
        ("[0.3, 0.2, 0.1]", "[0.3, -0.2, 0.1]", 4, "greater than 0"),
        ("box: {size: [0.3, 0.2, 0.1]}", "{box: {size: [1, 1, 1]}, sphere: {diameter: 1}}", 4, "got box, sphere"),
        ("box: {size: [0.3, 0.2, 0.1]}", "mesh: {file: ../../etc/passwd}", 4, "shape.mesh.file"),
        ("[1, 2, 3]", "[1, 2, 256]", 5, "colour.2: Input should be less than or equal to 255"),
        ("  - {approach: [0, 0, -1], width: 0.2}", "  - 5", 8, "grasps.0"),
        ("notes: Fragile.", "weight: 3", 6, "weight: Extra inputs"),
    ],
)  # fmt: skip
def test_a_mistake_is_shown_with_its_line(tmp_path: Path, old: str, new: str, line: int, words: str) -> None:
    assert old in GOOD
    path = written(tmp_path, GOOD.replace(old, new))
    with pytest.raises(UsageError) as caught:
        read_type(path)
    assert str(caught.value).startswith(f"{path}, line {line}: ")
    assert words in str(caught.value)


@pytest.mark.parametrize(
    "text", ["", "- 1\n- 2\n", "name: [", "name: a\n\tcode: 1", "a: 1\n---\nb: 2", "just words", "\0", "? [a]\n: b\n"]
)
def test_what_is_no_type_is_refused(tmp_path: Path, text: str) -> None:
    path = written(tmp_path, text)
    with pytest.raises(UsageError, match=r"crate.yaml"):
        read_type(path)


def test_files_that_cannot_be_read_are_named(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"absent.yaml: cannot be read: No such file"):
        read_type(tmp_path / "absent.yaml")
    (tmp_path / "latin.yaml").write_bytes(b"name: caf\xe9")
    with pytest.raises(UsageError, match=r"latin.yaml: not readable"):
        read_type(tmp_path / "latin.yaml")
    with pytest.raises(UsageError, match=r"nowhere does not exist; expected YAML files"):
        load(tmp_path / "nowhere")


def test_a_later_folder_replaces_types_of_an_earlier_one(tmp_path: Path) -> None:
    written(tmp_path, GOOD.replace("crate", "cube"), "anything.yaml")
    catalogue = load(shipped_folder(), tmp_path)
    assert catalogue.model("cube").shape == Box((0.3, 0.2, 0.1))
    assert catalogue.resolve("77").name == "cube"


def test_a_changed_type_has_its_new_model(tmp_path: Path) -> None:
    catalogue = Catalogue()
    for edge in (0.1, 0.2):
        kind = ObjectType(name="crate", shape=ShapeOf(box=BoxShape(size=(edge, edge, edge))))
        catalogue.add(kind, tmp_path)
        assert catalogue.model("crate").shape == Box((edge, edge, edge))
    catalogue.remove("crate")
    assert catalogue.models() == []
    with pytest.raises(UsageError):
        catalogue.remove("crate")


def ascii_stl(facets: str) -> bytes:
    return f"solid part\n{facets}endsolid part\n".encode()


FACET = "facet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex {x} 0 0\nvertex 0 1 0\nendloop\nendfacet\n"
BROKEN = {
    "empty.stl": b"",
    "words.stl": b"this is no mesh at all, however long it goes on" * 4,
    "none.stl": ascii_stl(""),
    "nan.stl": bytes(80) + (1).to_bytes(4, "little") + np.full(12, np.nan, "<f4").tobytes() + b"\0\0",
    "cut.stl": bytes(80) + (9).to_bytes(4, "little") + bytes(50),
    "empty.ply": b"",
    "points.ply": b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\n"
    b"end_header\n0 0 0\n",
    "empty.obj": b"",
    "vertices.obj": b"v 0 0 0\nv 1 0 0\nv 0 1 0\n",
    "empty.glb": b"",
    "head.glb": b"glTF\2\0\0\0\14\0\0\0",
}


@pytest.mark.parametrize("file", sorted(BROKEN))
def test_a_broken_mesh_is_told_and_the_other_types_go_on(
    tmp_path: Path, file: str, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / file).write_bytes(BROKEN[file])
    written(tmp_path, f"name: part\nshape:\n  mesh: {{file: {file}}}\n", "part.yaml")
    written(tmp_path, GOOD)
    catalogue = load(tmp_path)
    for _ in range(2):
        assert [model.name for model in catalogue.models()] == ["crate"]
    assert caplog.text.count(f"object type part cannot be found: {tmp_path / file}") == 1
    with pytest.raises(FileError, match=file):
        catalogue.model("part")


def test_a_mesh_in_millimetres_is_told(tmp_path: Path) -> None:
    (tmp_path / "big.stl").write_bytes((shipped_folder() / "mug.stl").read_bytes())
    written(tmp_path, "name: big\nshape:\n  mesh: {file: big.stl, scale: 1000}\n", "big.yaml")
    with pytest.raises(UsageError, match=r"is its unit millimetres\? Then its scale is 0.001"):
        load(tmp_path).model("big")


def glb(vertices: NDArray[np.float64], faces: NDArray[np.int32]) -> bytes:
    """A binary glTF file of one mesh."""
    corners, indices = vertices.astype("<f4"), faces.astype("<u4")
    document = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "buffers": [{"byteLength": corners.nbytes + indices.nbytes}],
        "bufferViews": [
            {"buffer": 0, "byteOffset": 0, "byteLength": corners.nbytes},
            {"buffer": 0, "byteOffset": corners.nbytes, "byteLength": indices.nbytes},
        ],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": len(corners), "type": "VEC3",
             "min": corners.min(axis=0).tolist(), "max": corners.max(axis=0).tolist()},
            {"bufferView": 1, "componentType": 5125, "count": indices.size, "type": "SCALAR"},
        ],
    }  # fmt: skip
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    body = corners.tobytes() + indices.tobytes()
    chunks = [(b"JSON", text), (b"BIN\0", body)]
    packed = b"".join(struct.pack("<I4s", len(chunk), kind) + chunk for kind, chunk in chunks)
    return struct.pack("<4sII", b"glTF", 2, 12 + len(packed)) + packed


@pytest.mark.parametrize("suffix", ["stl", "ply", "obj", "glb"])
def test_a_mesh_is_read_in_every_format(tmp_path: Path, suffix: str) -> None:
    solid, path = solid_of(Box((0.1, 0.2, 0.3))), tmp_path / f"box.{suffix}"
    if suffix == "glb":
        path.write_bytes(glb(solid.vertices, solid.faces))
    else:
        geometry = open3d_module.load()
        points = geometry.utility.Vector3dVector(solid.vertices)
        box = geometry.geometry.TriangleMesh(points, geometry.utility.Vector3iVector(solid.faces))
        box.compute_vertex_normals()
        assert geometry.io.write_triangle_mesh(str(path), box)
    written(tmp_path, f"name: part\nshape:\n  mesh: {{file: box.{suffix}}}\n", "part.yaml")
    assert size_of(load(tmp_path).model("part").shape) == pytest.approx((0.1, 0.2, 0.3), abs=1e-6)


def test_a_type_that_was_written_is_read(tmp_path: Path) -> None:
    kind = read_type(written(tmp_path, GOOD))
    write_type(kind, tmp_path / "again.yaml")
    assert read_type(tmp_path / "again.yaml") == kind
    with pytest.raises(FileError):
        write_type(kind, tmp_path / "again.yaml")
