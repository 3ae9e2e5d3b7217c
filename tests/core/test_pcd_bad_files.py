"""Bad PCD files: a clear FileError, no other error, and no more memory than the file's size justifies."""

from __future__ import annotations

import tracemalloc
from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from zsight_core.ellipse import ellipse
from zsight_core.errors import FileError
from zsight_core.files import pcd

if TYPE_CHECKING:
    from pathlib import Path

ENCODINGS: tuple[pcd.Encoding, ...] = ("ascii", "binary", "binary_compressed")
HUGE = str(2**40)
LITTLE_MEMORY = 1 << 20  # bytes: room for reading lines and for messages

in_one_folder = settings(
    suppress_health_check=[HealthCheck.function_scoped_fixture]
)  # each example overwrites its file


def header(**changes: str | None) -> bytes:
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
    return "".join(f"{key} {value}\n" for key, value in lines.items() if value is not None).encode()


def binary(data: bytes, **changes: str | None) -> bytes:
    return header(DATA="binary", **changes) + data


def compressed(packed: int, unpacked: int, data: bytes, **changes: str | None) -> bytes:
    sizes = packed.to_bytes(4, "little") + unpacked.to_bytes(4, "little")
    return header(DATA="binary_compressed", **changes) + sizes + data


def good(encoding: pcd.Encoding, folder: Path) -> bytes:
    points = ellipse()[:, :60:5]
    pcd.write(folder / "good.pcd", points, encoding=encoding, overwrite=True)
    return (folder / "good.pcd").read_bytes()


LITERALS = b"\x17" + bytes(24)  # LZF: 24 bytes as they stand

BAD = {
    "empty": (b"", "is empty"),
    "blank": (b"\n\n", "ends within its header"),
    "not text": (bytes(range(128, 256)) * 40 + b"\n", "that is no header"),
    "PNG": (b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR", "that is no header"),
    "NUL": (header(VERSION="0.7\0") + b"1 2 3\n4 5 6\n", "no text"),
    "endless line": (b"FIELDS " + b"x " * 100_000, "longer than"),
    "endless comments": (b"#\n" * 100_000, "no line DATA"),
    "latin-1": (header(FIELDS="x y \xe9").decode().encode("latin-1"), "no text"),
    "words": (b"hello world\n", "begins with b'HELLO'"),
    "header cut": (header()[:60], "ends within its header"),
    "last line cut": (b"".join([header(DATA=None), b"DATA ascii"]), "ends within its header"),
    "twice": (header().replace(b"WIDTH", b"WIDTH 2\nWIDTH"), "a second time"),
    "unknown data": (header(DATA="zip"), "DATA is 'zip'"),
    "no data kind": (header(DATA=""), "DATA is ''"),
    "unknown version": (header(VERSION="1.0"), "VERSION"),
    "no fields": (header(FIELDS=None), "no FIELDS"),
    "fields empty": (header(FIELDS=""), "no FIELDS"),
    "only padding": (header(FIELDS="_ _ _"), "at least one"),
    "field twice": (header(FIELDS="x y x"), "each once"),
    "no size": (header(SIZE=None), "no SIZE"),
    "no type": (header(TYPE=None), "no TYPE"),
    "sizes missing": (header(SIZE="4 4"), "3 fields but 2"),
    "types missing": (header(TYPE="F"), "3 fields but 1"),
    "counts missing": (header(COUNT="1 1 1 1"), "3 fields but 4"),
    "size 3": (header(SIZE="4 3 4"), "SIZE 3"),
    "float of 1": (header(SIZE="1 4 4"), "TYPE F and SIZE 1"),
    "float of 2": (header(SIZE="2 4 4"), "TYPE F and SIZE 2"),
    "type Q": (header(TYPE="F F Q"), "TYPE Q"),
    "size words": (header(SIZE="4 4 four"), "whole numbers"),
    "count 0": (header(COUNT="1 0 1"), "COUNT 0"),
    "count -1": (header(COUNT="1 -1 1"), "whole numbers"),
    "count huge": (header(COUNT=f"1 1 {HUGE}"), "the header is damaged"),
    "count huge, no points": (header(COUNT=f"1 1 {HUGE}", WIDTH="0", POINTS="0"), "the header is damaged"),
    "width words": (header(WIDTH="two"), "WIDTH is 'two'"),
    "width negative": (header(WIDTH="-2"), "WIDTH"),
    "width of 5000 digits": (header(WIDTH="9" * 5000), "WIDTH"),
    "width twice as words": (header(WIDTH="2 2"), "one whole number"),
    "width empty": (header(WIDTH=""), "one whole number"),
    "no width": (header(WIDTH=None, POINTS=None), "no WIDTH"),
    "points lie": (header(POINTS="3"), "is not POINTS 3"),
    "height lies": (header(HEIGHT="480"), "is not POINTS 2"),
    "width beyond 32 bits, no height": (header(WIDTH=HUGE, HEIGHT="0", POINTS="0"), "the header is damaged"),
    "viewpoint short": (header(VIEWPOINT="0 0 0"), "seven numbers"),
    "viewpoint words": (header(VIEWPOINT="0 0 0 w 0 0 0"), "seven numbers"),
    "viewpoint nan": (header(VIEWPOINT="0 0 0 nan 0 0 0"), "seven numbers"),
    "2^40 points, ascii": (header(WIDTH=HUGE, POINTS=HUGE) + b"1 2 3\n" * 50, "the header is damaged"),
    "2^40 points as rows, ascii": (header(WIDTH="1048576", HEIGHT="1048576", POINTS=HUGE) + b"1 2 3\n", "cut short"),
    "2^40 points, binary": (binary(bytes(24), WIDTH="1048576", HEIGHT="1048576", POINTS=HUGE), "cut short"),
    "2^40 points, compressed": (
        compressed(25, 24, LITERALS, WIDTH="1048576", HEIGHT="1048576", POINTS=HUGE),
        "its header promises",
    ),
    "2^31 points, ascii": (header(WIDTH=str(2**31), POINTS=str(2**31)) + b"1 2 3\n" * 50, "cut short"),
    "ascii without data": (header(), "cut short"),
    "ascii cut": (header() + b"1 2 3\n4 5", "cut short|too few"),
    "ascii row short": (header() + b"1 2 3\n4.000000 5\n", "row 2 .* too few"),
    "ascii row missing": (header() + b"1.00000 2.00000 3.00000\n", "end after 1 rows"),
    "ascii row long": (header() + b"1 2 3 4\n5 6 7\n", "row 1 .* more than"),
    "ascii rows left": (header() + b"1 2 3\n4 5 6\n7 8 9\n", "more rows than the 2"),
    "ascii junk": (header() + b"1 2 3\n4 five 6\n", "row 2 .* 'five'"),
    "ascii NUL": (header() + b"1 2 3\n4 \0\0\0 6\n", "row 2"),
    "ascii bytes": (header() + b"1 2 3\n4 \xff\xfe 6\n", "row 2"),
    "ascii integer too large": (header(TYPE="F F U", SIZE="4 4 1") + b"1 2 3\n4 5 256\n", "'256'"),
    "ascii integer with point": (header(TYPE="F F I") + b"1 2 3\n4 5 6.5\n", "'6.5'"),
    "binary without data": (binary(b""), "cut short"),
    "binary cut": (binary(bytes(23)), "cut short"),
    "binary with more points": (binary(bytes(36)), "its header promises 2 points"),
    "compressed without sizes": (compressed(0, 0, b"")[:-5], "sizes of its compressed data"),
    "compressed cut": (compressed(25, 24, LITERALS[:-1]), "cut short: 24 of 25"),
    "compressed size lies": (compressed(25, 48, LITERALS), "has 48 bytes of data"),
    "compressed beyond any ratio": (
        compressed(2, 12 * 10**6, b"\0\0", WIDTH="1000000", POINTS="1000000"),
        "cannot hold",
    ),
    "compressed 4 GB": (compressed(2**32 - 1, 24, LITERALS), "cut short"),
    "compressed of nothing": (compressed(0, 24, b""), "cannot hold"),
    "LZF too short": (compressed(24, 24, b"\x16" + bytes(23)), "do not expand"),
    "LZF too long": (compressed(26, 24, b"\x18" + bytes(25)), "do not expand"),
    "LZF before the beginning": (compressed(2, 24, b"\x20\x00"), "do not expand"),
    "LZF token cut": (compressed(3, 24, b"\x00\x00\xe0"), "do not expand"),
}  # fmt: skip  one line a file where it fits


@pytest.mark.parametrize("name", BAD)
def test_bad_files_are_refused_with_a_reason_and_little_memory(name: str, tmp_path: Path) -> None:
    data, reason = BAD[name]
    path = tmp_path / "bad.pcd"
    path.write_bytes(data)
    pcd.warm_up()
    tracemalloc.start()
    try:
        with pytest.raises(FileError, match=reason) as caught:
            pcd.read(path)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert str(caught.value).startswith(f"{path}: ")
    assert peak < LITTLE_MEMORY + 100 * len(data)


def test_files_that_are_not_there_or_no_files(tmp_path: Path) -> None:
    with pytest.raises(FileError, match="No such file"):
        pcd.read(tmp_path / "nowhere.pcd")
    with pytest.raises(FileError, match="not a regular file"):
        pcd.read(tmp_path)
    with pytest.raises(FileError, match="cannot be read"):
        pcd.read(str(tmp_path / "a\0b.pcd"))


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_every_place_to_cut_a_file_is_noticed(encoding: pcd.Encoding, tmp_path: Path) -> None:
    data = good(encoding, tmp_path)
    path = tmp_path / "cut.pcd"
    for size in range(len(data)):
        path.write_bytes(data[:size])
        if encoding == "ascii" and data[size:].isspace():
            assert pcd.read(path).points.size == 12  # only the last line feed is missing
            continue
        if encoding == "ascii" and b"\n" not in data[size:-1] and data[size - 1 : size].isdigit():
            continue  # a last number that lost digits is still a number
        with pytest.raises(FileError):
            pcd.read(path)


@given(
    st.sampled_from(ENCODINGS), st.lists(st.tuples(st.integers(0, 400), st.integers(0, 255)), min_size=1, max_size=4)
)
@in_one_folder
def test_damaged_bytes_give_a_cloud_or_a_file_error(
    tmp_path: Path, encoding: pcd.Encoding, damages: list[tuple[int, int]]
) -> None:
    data = bytearray(good(encoding, tmp_path))
    for at, value in damages:
        data[at % len(data)] = value
    (tmp_path / "damaged.pcd").write_bytes(data)
    try:
        points = pcd.read(tmp_path / "damaged.pcd").points
    except FileError:
        return
    assert points.ndim == 2
    assert points.nbytes <= 100 * len(data)


@given(st.binary(max_size=300), st.sampled_from(ENCODINGS))
@in_one_folder
def test_any_bytes_behind_a_header_give_a_cloud_or_a_file_error(
    tmp_path: Path, data: bytes, encoding: pcd.Encoding
) -> None:
    (tmp_path / "any.pcd").write_bytes(header(DATA=encoding) + data)
    try:
        points = pcd.read(tmp_path / "any.pcd").points
    except FileError:
        return
    assert points.shape == (1, 2)


def test_a_cloud_of_holes_only_is_a_cloud(tmp_path: Path) -> None:
    path = tmp_path / "holes.pcd"
    path.write_bytes(header() + b"nan nan nan\nnan nan nan\n")
    assert np.isnan(pcd.read(path).points["z"]).all()


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_a_cloud_of_no_points_is_a_cloud(encoding: str, tmp_path: Path) -> None:
    path = tmp_path / "none.pcd"
    sizes = bytes(8) if encoding == "binary_compressed" else b""
    path.write_bytes(header(WIDTH="0", POINTS="0", DATA=encoding) + sizes)
    assert pcd.read(path).points.shape == (1, 0)
