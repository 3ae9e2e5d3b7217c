"""PCD files: what is written comes back, and what others write is understood."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, cast

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from zsight_core.ellipse import ellipse
from zsight_core.errors import FileError, PointsError
from zsight_core.files import pcd
from zsight_core.points import XYZ, XYZRGB, Points, colours

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

ENCODINGS: tuple[pcd.Encoding, ...] = ("ascii", "binary", "binary_compressed")
NUMBERS = ["<f4", "<f8", "i1", "<i2", "<i4", "<i8", "u1", "<u2", "<u4", "<u8", ">f4", ">f8", ">u2", ">i8"]
NAMES = ["x", "y", "z", "rgb", "label", "normal_x", "größe", "curvature"]

in_one_folder = settings(
    suppress_health_check=[HealthCheck.function_scoped_fixture]
)  # each example overwrites its file


@st.composite
def clouds(draw: st.DrawFn) -> Points:
    """Any cloud that PCD can hold: all types, subarrays, padding, any bits."""
    names = draw(st.lists(st.sampled_from(NAMES), min_size=1, max_size=5, unique=True))
    fields = [(name, draw(st.sampled_from(NUMBERS)), draw(st.sampled_from([(), (), (1,), (3,)]))) for name in names]
    dtype = np.dtype([("rgb", "<f4") if name == "rgb" else (name, kind, shape) for name, kind, shape in fields])
    gap = draw(st.integers(0, 5))
    if gap:
        parts = cast(Any, dtype.fields)
        dtype = np.dtype(
            {
                "names": names,
                "formats": [dtype[name] for name in names],
                "offsets": [parts[name][1] + gap for name in names],
                "itemsize": dtype.itemsize + 2 * gap,
            }
        )
    height, width = draw(st.integers(0, 4)), draw(st.integers(0, 5))
    data = draw(st.binary(min_size=height * width * dtype.itemsize, max_size=height * width * dtype.itemsize))
    points = np.frombuffer(data, dtype) if data else np.zeros(0, dtype)
    return points.reshape(height, width)


def little(values: NDArray[Any]) -> NDArray[Any]:
    return np.ascontiguousarray(values.astype(values.dtype.newbyteorder("<")))


def assert_same_bits(got: Points, expected: Points) -> None:
    assert got.shape == expected.shape
    assert got.dtype.names == expected.dtype.names
    for name in expected.dtype.names or ():
        assert little(got[name]).tobytes() == little(expected[name]).tobytes()


def assert_same_numbers(got: Points, expected: Points) -> None:
    """The same numbers, colours to the bit; NaN is NaN, whatever its payload."""
    assert got.shape == expected.shape
    assert got.dtype.names == expected.dtype.names
    for name in expected.dtype.names or ():
        if name == "rgb":
            assert got[name].tobytes() == np.ascontiguousarray(expected[name]).tobytes()
        else:
            flat = got[name].reshape(expected[name].shape)
            np.testing.assert_array_equal(flat, expected[name])
            assert flat.dtype == expected[name].dtype.newbyteorder("<")
            if flat.dtype.kind == "f":
                number = ~np.isnan(flat)
                np.testing.assert_array_equal(np.signbit(flat)[number], np.signbit(expected[name])[number])


@given(points=clouds(), encoding=st.sampled_from(ENCODINGS))
@in_one_folder
def test_any_cloud_comes_back(points: Points, encoding: pcd.Encoding, tmp_path: Path) -> None:
    pcd.write(tmp_path / "a.pcd", points, encoding=encoding, overwrite=True)
    file = pcd.read(tmp_path / "a.pcd")
    assert file.encoding == encoding
    (assert_same_numbers if encoding == "ascii" else assert_same_bits)(file.points, points)


@given(st.tuples(*[st.floats(allow_nan=False, allow_infinity=False)] * 7), st.sampled_from(ENCODINGS))
@in_one_folder
def test_any_viewpoint_comes_back(tmp_path: Path, viewpoint: pcd.Viewpoint, encoding: pcd.Encoding) -> None:
    pcd.write(tmp_path / "a.pcd", ellipse()[:, :3], viewpoint=viewpoint, encoding=encoding, overwrite=True)
    assert pcd.read(tmp_path / "a.pcd").viewpoint == viewpoint


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_organised_clouds_keep_shape_holes_and_colours(tmp_path: Path, encoding: pcd.Encoding) -> None:
    rng = np.random.default_rng(1)
    points = np.zeros((48, 64), XYZRGB)
    for axis in "xyz":
        points[axis] = rng.normal(size=points.shape)
    points["rgb"] = rng.integers(0, 2**32, points.shape, dtype=np.uint32).view(np.float32)  # alpha: every NaN, too
    points["z"][rng.random(points.shape) < 0.3] = np.nan
    pcd.write(tmp_path / "a.pcd", points, encoding=encoding)
    back = pcd.read(tmp_path / "a.pcd").points
    assert back.dtype == XYZRGB
    assert back.tobytes() == points.tobytes() or encoding == "ascii"
    assert_same_numbers(back, points)
    np.testing.assert_array_equal(colours(back), colours(points))


def test_views_with_strides_are_written_as_they_look(tmp_path: Path) -> None:
    points = ellipse().reshape(40, 73)[::-2, 3:60:3]
    pcd.write(tmp_path / "a.pcd", points)
    assert_same_bits(pcd.read(tmp_path / "a.pcd").points, points)


def test_padding_is_not_written(tmp_path: Path) -> None:
    pcd.write(tmp_path / "a.pcd", np.zeros((1, 10), XYZ))
    data = (tmp_path / "a.pcd").read_bytes()
    assert len(data.partition(b"DATA binary\n")[2]) == 10 * 12
    assert pcd.read(tmp_path / "a.pcd").points.dtype.itemsize == 12


def test_ascii_is_for_people_and_all_readers(tmp_path: Path) -> None:
    points = ellipse()[:, [0, 1459]]
    points["x"] = [[0.1, np.nan]]
    pcd.write(tmp_path / "a.pcd", points, encoding="ascii", viewpoint=(0.1, 0, 0, 1, 0, 0, 0))
    assert (tmp_path / "a.pcd").read_text().splitlines() == [
        "# .PCD v0.7 - Point Cloud Data file format",
        "VERSION 0.7",
        "FIELDS x y z rgb",
        "SIZE 4 4 4 4",
        "TYPE F F F U",
        "COUNT 1 1 1 1",
        "WIDTH 2",
        "HEIGHT 1",
        "VIEWPOINT 0.1 0 0 1 0 0 0",
        "POINTS 2",
        "DATA ascii",
        "0.1 0 -1 16711680",
        "nan -2.4492937e-16 -0.05 913920",
    ]


def header(**changes: str | None) -> str:
    lines = {
        "VERSION": "0.7",
        "FIELDS": "x y z",
        "SIZE": "4 4 4",
        "TYPE": "F F F",
        "COUNT": "1 1 1",
        "WIDTH": "2",
        "HEIGHT": "1",
        "VIEWPOINT": "0 0 0 1 0 0 0",
        "POINTS": "2",
        "DATA": "ascii",
    } | changes  # fmt: skip  one row reads as the header does
    return "".join(f"{key} {value}\n" for key, value in lines.items() if value is not None)


def read_text(tmp_path: Path, text: str | bytes) -> pcd.PcdFile:
    (tmp_path / "a.pcd").write_bytes(text if isinstance(text, bytes) else text.encode())
    return pcd.read(tmp_path / "a.pcd")


ROWS = "1 2 3\n4 5 6\n"
PLAIN = [(1, 2, 3), (4, 5, 6)]


@pytest.mark.parametrize(
    "text",
    [
        header() + ROWS,
        header(VERSION=".7") + ROWS,
        header(VERSION=None) + ROWS,
        header(VIEWPOINT=None) + ROWS,
        header(HEIGHT=None) + ROWS,
        header(POINTS=None) + ROWS,
        header(WIDTH=None) + ROWS,
        header(WIDTH=None, HEIGHT=None) + ROWS,
        header(COUNT=None) + ROWS,
        header(DATA="ASCII") + ROWS,
        "# made by hand\n\n#\n" + header() + ROWS,
        "# fünf\n".encode("latin-1").decode("latin-1") + header() + ROWS,
        (header() + ROWS).replace("\n", "\r\n"),
        header() + "\n1 2 3\n\n4 5 6",
        header().replace("FIELDS", "COLUMNS") + ROWS,
        header(TYPE="f f f") + ROWS,
    ],
)
def test_variants_of_the_header_are_understood(tmp_path: Path, text: str) -> None:
    file = read_text(tmp_path, text)
    assert file.points.shape == (1, 2)
    assert file.points[0].tolist() == PLAIN
    assert file.viewpoint == (0, 0, 0, 1, 0, 0, 0)


def test_crlf_header_before_binary_data(tmp_path: Path) -> None:
    text = header(DATA="binary").replace("\n", "\r\n").encode() + np.arange(6, dtype="<f4").tobytes()
    assert read_text(tmp_path, text).points[0].tolist() == [(0, 1, 2), (3, 4, 5)]


@pytest.mark.parametrize("name", ["rgb", "rgba"])
@pytest.mark.parametrize("kind", ["I", "U", "F"])
@pytest.mark.parametrize("encoding", ["ascii", "binary"])
def test_colour_of_any_name_and_type_is_our_packed_rgb(tmp_path: Path, name: str, kind: str, encoding: str) -> None:
    bits = np.array([0x00FF8001, 0x00000102], np.uint32)
    words = [repr(float(number)) for number in bits.view(np.float32)] if kind == "F" else [str(n) for n in bits]
    data = "\n".join(words).encode() if encoding == "ascii" else bits.tobytes()
    text = header(FIELDS=name, SIZE="4", TYPE=kind, COUNT="1", DATA=encoding).encode() + data
    points = read_text(tmp_path, text).points
    assert points.dtype == np.dtype([("rgb", "<f4")])
    assert colours(points).tolist() == [[[0xFF, 0x80, 1], [0, 1, 2]]]


def test_negative_colour_integers_are_an_alpha_of_255(tmp_path: Path) -> None:
    text = header(FIELDS="rgb", SIZE="4", TYPE="I", COUNT="1") + "-16777216\n-1\n"
    assert read_text(tmp_path, text).points["rgb"].view(np.uint32).tolist() == [[0xFF000000, 0xFFFFFFFF]]


def test_rgb_beside_rgba_keeps_both(tmp_path: Path) -> None:
    text = header(FIELDS="rgb rgba", SIZE="4 4", TYPE="F U", COUNT="1 1") + "0 5\n0 6\n"
    assert read_text(tmp_path, text).points.dtype == np.dtype([("rgb", "<f4"), ("rgba", "<u4")])


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_padding_fields_are_skipped(tmp_path: Path, encoding: pcd.Encoding) -> None:
    names, sizes, kinds, counts = "x _ y _ z", "4 4 4 1 4", "F F F U F", "1 1 1 3 1"
    packed = np.dtype([("x", "<f4"), ("p", "<f4"), ("y", "<f4"), ("q", "u1", (3,)), ("z", "<f4")])
    records = np.array([(1, 9, 2, (7, 7, 7), 3), (4, 9, 5, (7, 7, 7), 6)], packed)
    pcd.write(tmp_path / "a.pcd", records[np.newaxis], encoding=encoding)
    named = (tmp_path / "a.pcd").read_bytes().replace(b"FIELDS x p y q z", b"FIELDS " + names.encode())
    assert f"SIZE {sizes}\nTYPE {kinds}\nCOUNT {counts}".encode() in named
    points = read_text(tmp_path, named).points
    assert points.dtype.names == ("x", "y", "z")
    assert points[0].tolist() == PLAIN


def test_several_numbers_a_point_are_a_subarray(tmp_path: Path) -> None:
    text = header(FIELDS="x fpfh", SIZE="4 2", TYPE="F I", COUNT="1 3") + "1 2 3 4\n5 6 7 8\n"
    points = read_text(tmp_path, text).points
    assert points.dtype == np.dtype([("x", "<f4"), ("fpfh", "<i2", (3,))])
    assert points["fpfh"].tolist() == [[[2, 3, 4], [6, 7, 8]]]


def test_what_is_read_may_be_changed(tmp_path: Path) -> None:
    for encoding in ENCODINGS:
        pcd.write(tmp_path / "a.pcd", ellipse(), encoding=encoding, overwrite=True)
        points = pcd.read(tmp_path / "a.pcd").points
        points["x"] = 0
        assert points.flags.aligned
        assert points.flags.c_contiguous


@pytest.mark.parametrize(
    ("points", "complaint"),
    [
        (np.zeros(4, XYZ), "shape"),
        (np.zeros((2, 2, 2), XYZ), "shape"),
        (np.zeros((2, 2), np.float32), "named fields"),
        (np.zeros((1, 1), [("x", "<f2")]), "float32, float64 and integers"),
        (np.zeros((1, 1), [("x", "?")]), "float32, float64 and integers"),
        (np.zeros((1, 1), [("x", "S3")]), "float32, float64 and integers"),
        (np.zeros((1, 1), [("x", [("a", "<f4")])]), "float32, float64 and integers"),
        (np.zeros((1, 1), [("x", "<f4", (0,))]), "float32, float64 and integers"),
        (np.zeros((1, 1), [("a b", "<f4")]), "cannot be written"),
        (np.zeros((1, 1), [("_", "<f4")]), "cannot be written"),
    ],
)
def test_clouds_that_pcd_cannot_hold_are_refused(tmp_path: Path, points: Points, complaint: str) -> None:
    with pytest.raises(PointsError, match=complaint):
        pcd.write(tmp_path / "a.pcd", points)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("viewpoint", [(0,) * 6, (0, 0, 0, np.nan, 0, 0, 0), ()])
def test_viewpoints_have_seven_finite_numbers(tmp_path: Path, viewpoint: tuple[float, ...]) -> None:
    with pytest.raises(PointsError, match="seven"):
        pcd.write(tmp_path / "a.pcd", ellipse(), viewpoint=viewpoint)


def test_an_unknown_encoding_is_refused(tmp_path: Path) -> None:
    with pytest.raises(PointsError, match="encoding"):
        pcd.write(tmp_path / "a.pcd", ellipse(), encoding=cast(Any, "zip"))


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_an_existing_file_is_not_touched(tmp_path: Path, encoding: pcd.Encoding) -> None:
    (tmp_path / "a.pcd").write_bytes(b"precious")
    with pytest.raises(FileError, match="already"):
        pcd.write(tmp_path / "a.pcd", ellipse(), encoding=encoding)
    assert (tmp_path / "a.pcd").read_bytes() == b"precious"
    assert len(list(tmp_path.iterdir())) == 1
