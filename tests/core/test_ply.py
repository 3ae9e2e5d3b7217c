"""PLY files: what is written comes back, what others write is understood, bad ones are refused."""

from __future__ import annotations

import tracemalloc
from typing import TYPE_CHECKING, Any, cast

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from zsight_core import open3d_module
from zsight_core.ellipse import ellipse
from zsight_core.errors import FileError, PointsError
from zsight_core.files import ply
from zsight_core.points import XYZRGB, Points, colours, xyz

if TYPE_CHECKING:
    from pathlib import Path

ENCODINGS: tuple[ply.PlyEncoding, ...] = ("ascii", "binary_little_endian", "binary_big_endian")
NUMBERS = ["<f4", "<f8", "i1", "<i2", "<i4", "u1", "<u2", "<u4", ">f4", ">f8", ">i2"]

in_one_folder = settings(
    suppress_health_check=[HealthCheck.function_scoped_fixture]
)  # each example overwrites its file


@st.composite
def clouds(draw: st.DrawFn) -> Points:
    names = draw(st.lists(st.sampled_from(["x", "y", "z", "rgb", "label", "nx", "alpha"]), min_size=1, unique=True))
    dtype = np.dtype([(name, "<f4" if name == "rgb" else draw(st.sampled_from(NUMBERS))) for name in names])
    count = draw(st.integers(0, 12))
    data = draw(st.binary(min_size=count * dtype.itemsize, max_size=count * dtype.itemsize))
    points = (np.frombuffer(data, dtype) if data else np.zeros(0, dtype)).copy()
    if "rgb" in names:
        points["rgb"] = (points["rgb"].view(np.uint32) & 0xFFFFFF).view(np.float32)  # PLY keeps no alpha
    return points.reshape(1, -1)


@given(points=clouds(), encoding=st.sampled_from(ENCODINGS))
@in_one_folder
def test_any_cloud_comes_back(points: Points, encoding: ply.PlyEncoding, tmp_path: Path) -> None:
    ply.write(tmp_path / "a.ply", points, encoding=encoding, overwrite=True)
    file = ply.read(tmp_path / "a.ply")
    assert file.encoding == encoding
    assert file.points.dtype == points.dtype.newbyteorder("<")
    for name in points.dtype.names or ():
        same = file.points[name].tobytes() == points[name].astype(points[name].dtype.newbyteorder("<")).tobytes()
        if encoding == "ascii" and name != "rgb":
            np.testing.assert_array_equal(file.points[name], points[name])
        else:
            assert same


def test_an_organised_cloud_comes_back_as_one_row_with_its_holes(tmp_path: Path) -> None:
    points = ellipse().reshape(40, 73)
    points["z"][::2] = np.nan
    ply.write(tmp_path / "a.ply", points)
    np.testing.assert_array_equal(xyz(ply.read(tmp_path / "a.ply").points), xyz(points.reshape(1, -1)))


HEADER = (
    "ply\nformat ascii 1.0\ncomment by hand\nobj_info x\nelement vertex 2\nproperty float x\nproperty float y\n"
    "property float z\nend_header\n"
)
ROWS = "1 2 3\n4 5 6\n"
PLAIN = [(1, 2, 3), (4, 5, 6)]


def read_text(folder: Path, text: str | bytes) -> Points:
    (folder / "a.ply").write_bytes(text if isinstance(text, bytes) else text.encode())
    return ply.read(folder / "a.ply").points


@pytest.mark.parametrize(
    "text",
    [
        HEADER + ROWS,
        (HEADER + ROWS).replace("\n", "\r\n"),
        HEADER.replace("float", "float32") + ROWS,
        HEADER.replace("float", "double") + ROWS.rstrip(),
        HEADER.replace("end_", "element face 1\nproperty list uchar int vertex_index\nend_") + ROWS + "3 0 1 1\n",
        HEADER.replace("element", "element camera 2\nproperty int a\nproperty int b\nelement") + "7 8\n9 9\n" + ROWS,
    ],
)
def test_variants_are_understood(tmp_path: Path, text: str) -> None:
    assert read_text(tmp_path, text)[0].tolist() == PLAIN


@pytest.mark.parametrize(("encoding", "order"), [("binary_little_endian", "<"), ("binary_big_endian", ">")])
def test_binary_with_elements_before_and_behind(tmp_path: Path, encoding: str, order: str) -> None:
    header = HEADER.replace("ascii", encoding).replace("element", "element camera 3\nproperty short a\nelement")
    header = header.replace("end_", "element face 1\nproperty list uchar int vertex_index\nend_")
    data = np.arange(3, dtype=f"{order}i2").tobytes() + np.arange(6, dtype=f"{order}f4").tobytes() + b"\3" + bytes(12)
    points = read_text(tmp_path, header.encode() + data)
    assert points[0].tolist() == [(0, 1, 2), (3, 4, 5)]
    assert points.dtype == np.dtype([(axis, "<f4") for axis in "xyz"])


def test_colours_are_packed_and_further_properties_kept(tmp_path: Path) -> None:
    more = "property uchar red\nproperty uchar green\nproperty uchar blue\nproperty uchar alpha\nproperty int id\nend"
    points = read_text(tmp_path, HEADER.replace("end", more) + "1 2 3 255 128 1 9 -5\n4 5 6 0 1 2 8 -6\n")
    assert points.dtype.names == ("x", "y", "z", "rgb", "alpha", "id")
    assert colours(points).tolist() == [[[255, 128, 1], [0, 1, 2]]]
    assert points["id"].tolist() == [[-5, -6]]


def test_colours_of_another_type_stay_as_they_are(tmp_path: Path) -> None:
    more = "property float red\nproperty float green\nproperty float blue\nend"
    points = read_text(tmp_path, HEADER.replace("end", more) + "1 2 3 0.5 0.5 1\n4 5 6 0 1 0\n")
    assert points.dtype.names == ("x", "y", "z", "red", "green", "blue")


HUGE = str(2**40)
BAD = {
    "empty": ("", "is empty"),
    "another kind": ("VERSION 0.7\n", "does not begin with the line ply"),
    "header cut": (HEADER[:70], "ends within its header"),
    "header without end": (HEADER.replace("end_header\n", ""), "ends within its header"),
    "endless comments": ("ply\n" + "comment\n" * 5000, "no line end_header"),
    "no format": (HEADER.replace("format ascii 1.0\n", ""), "no line format"),
    "unknown format": (HEADER.replace("ascii", "zip"), "not PLY 1.0"),
    "unknown type": (HEADER.replace("float", "quad"), "not PLY 1.0"),
    "property of nothing": (HEADER.replace("element vertex 2\n", ""), "not PLY 1.0"),
    "no vertex": (HEADER.replace("vertex", "face"), "expected vertex"),
    "no properties": ("ply\nformat ascii 1.0\nelement vertex 0\nend_header\n", "expected some"),
    "property twice": (HEADER.replace("float y", "float x"), "each once"),
    "list in vertex": (HEADER.replace("float z", "list uchar int z") + ROWS, "has a list"),
    "list before vertex": (HEADER.replace("el", "element f 1\nproperty list uchar int i\nel", 1), "has a list"),
    "negative count": (HEADER.replace("vertex 2", "vertex -2"), "not PLY 1.0"),
    "2^40 points": (HEADER.replace("vertex 2", f"vertex {HUGE}") + ROWS, "header is damaged"),
    "2^31 points": (HEADER.replace("vertex 2", f"vertex {2**31}") + ROWS, "cut short"),
    "2^31 points, binary": (HEADER.replace("vertex 2", f"vertex {2**31}").replace("ascii", "binary_big_endian"), "cut"),
    "2^31 lines before": (HEADER.replace("el", f"element f {2**31}\nproperty int i\nel", 1) + ROWS, "cut short"),
    "lines before missing": (HEADER.replace("el", "element f 3\nproperty int i\nel", 1) + "1\n1       1      1", "cut"),
    "row missing": (HEADER + "1.0 2.0 3.0\n", "end after 1 rows"),
    "row short": (HEADER + "1.0 2.0\n4 5 6\n", "row 1 .* too few"),
    "row long": (HEADER + "1 2 3 4\n4 5 6\n", "row 1 .* more than"),
    "too many rows": (HEADER + ROWS + "7 8 9\n", "more rows"),
    "junk": (HEADER + "1 2 3\n4 five 6\n", "'five'"),
    "colour beyond a byte": (HEADER.replace("float z", "uchar z") + "1 2 256\n4 5 6\n", "'256'"),
    "binary cut": (HEADER.replace("ascii", "binary_little_endian") + "x" * 23, "cut short"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_files_are_refused_with_a_reason_and_little_memory(name: str, tmp_path: Path) -> None:
    text, reason = BAD[name]
    ply.warm_up()
    tracemalloc.start()
    try:
        with pytest.raises(FileError, match=reason):
            read_text(tmp_path, text)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < (1 << 20) + 100 * len(text)


@given(st.binary(max_size=200), st.sampled_from(ENCODINGS))
@in_one_folder
def test_any_bytes_behind_a_header_give_a_cloud_or_a_file_error(
    tmp_path: Path, data: bytes, encoding: ply.PlyEncoding
) -> None:
    try:
        points = read_text(tmp_path, HEADER.replace("ascii", encoding).encode() + data)
    except FileError:
        return
    assert points.shape == (1, 2)


@pytest.mark.parametrize(
    ("points", "complaint"),
    [
        (np.zeros(4, XYZRGB), "shape"),
        (np.zeros((1, 4), [("x", "<i8")]), "PLY holds"),
        (np.zeros((1, 4), [("x", "<f4", (3,))]), "PLY holds"),
        (np.zeros((1, 4), [("x", "?")]), "PLY holds"),
        (np.zeros((1, 4), [("a b", "<f4")]), "cannot be written"),
        (np.zeros((1, 4), [("rgb", "<f4"), ("red", "u1")]), "both"),
    ],
)
def test_clouds_that_ply_cannot_hold_are_refused(tmp_path: Path, points: Points, complaint: str) -> None:
    with pytest.raises(PointsError, match=complaint):
        ply.write(tmp_path / "a.ply", points)
    with pytest.raises(PointsError, match="encoding"):
        ply.write(tmp_path / "a.ply", points, encoding=cast(Any, "zip"))
    assert list(tmp_path.iterdir()) == []


def test_an_existing_file_is_not_touched(tmp_path: Path) -> None:
    (tmp_path / "a.ply").write_bytes(b"precious")
    with pytest.raises(FileError, match="already"):
        ply.write(tmp_path / "a.ply", ellipse())
    assert [path.read_bytes() for path in tmp_path.iterdir()] == [b"precious"]


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_open3d_reads_what_we_write(encoding: ply.PlyEncoding, tmp_path: Path) -> None:
    try:
        open3d = open3d_module.load()
    except ImportError as error:
        pytest.skip(f"no Open3D to compare with: {error}")
    points = ellipse()
    ply.write(tmp_path / "a.ply", points, encoding=encoding)
    cloud = open3d.t.io.read_point_cloud(str(tmp_path / "a.ply"))
    np.testing.assert_array_equal(cloud.point["positions"].numpy(), xyz(points)[0])
    np.testing.assert_array_equal(cloud.point["colors"].numpy(), colours(points)[0])
