"""The text in front of the data of a PCD file (version 0.7 of the Point Cloud Library's format)."""

from __future__ import annotations

import itertools
import math
import os
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np

from zsight_core.errors import FileError

if TYPE_CHECKING:
    from collections.abc import Callable

    from zsight_core.files.atomic_file import AnyPath

__all__ = ["ENCODINGS", "LEVEL", "Field", "Header", "Viewpoint", "format_header", "read_header"]

Viewpoint = tuple[float, float, float, float, float, float, float]
"""Where the sensor stood: x y z, metres, and the quaternion w x y z, in the order of the file."""

LEVEL: Viewpoint = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)

ENCODINGS = ("ascii", "binary", "binary_compressed")

_VERSIONS = {".5", ".6", ".7", "0.5", "0.6", "0.7"}
_SIZES = {"F": (4, 8), "I": (1, 2, 4, 8), "U": (1, 2, 4, 8)}
_LONGEST_LINE = 1 << 16
_MOST_LINES = 4096
_LARGEST_RECORD = 1 << 20
_LARGEST_SIDE = (1 << 32) - 1  # width and height of a PointCloud2 are 32-bit
_last_text = [b""]
"""The header read last: the clouds of one recording have the same, which is then known by one look."""

_KEYWORDS = (
    "VERSION",
    "FIELDS",
    "COLUMNS",
    "SIZE",
    "TYPE",
    "COUNT",
    "WIDTH",
    "HEIGHT",
    "VIEWPOINT",
    "POINTS",
    "DATA",
)  # fmt: skip  one row reads as the format's own order


@dataclass(frozen=True)
class Field:
    """A column of the file: name, bytes a number, F I or U, and how many numbers it holds a point."""

    name: str
    size: int
    kind: str
    count: int

    @property
    def is_padding(self) -> bool:
        """True of the field ``_``, which only keeps its place."""
        return self.name == "_"

    @property
    def is_colour(self) -> bool:
        """True of four bytes that hold a packed colour, whatever type the file gives them."""
        return self.name == "rgb" and self.size == 4 and self.count == 1

    @property
    def type(self) -> str:
        """The type of a number as numpy writes it, such as ``f4``."""
        return f"{self.kind.lower()}{self.size}"


@dataclass(frozen=True)
class Header:
    """What a PCD header says; the field ``rgba`` of a file is called ``rgb`` here."""

    fields: tuple[Field, ...]
    width: int
    height: int
    viewpoint: Viewpoint
    encoding: str

    @property
    def count(self) -> int:
        """Number of points."""
        return self.width * self.height

    @property
    def field_sizes(self) -> list[int]:
        """Bytes a point of each field, padding included."""
        return [field.size * field.count for field in self.fields]

    @cached_property
    def record_size(self) -> int:
        """Bytes a point, padding included."""
        return sum(self.field_sizes)

    @property
    def offsets(self) -> list[int]:
        """Where each field begins in a record."""
        return [0, *itertools.accumulate(self.field_sizes)][:-1]

    @cached_property
    def dtype(self) -> np.dtype[Any]:
        """Type of a record: padding is a gap, several numbers are a subarray, a packed colour is float32."""
        seen = [(field, at) for field, at in zip(self.fields, self.offsets, strict=True) if not field.is_padding]
        return np.dtype(
            {
                "names": [field.name for field, _ in seen],
                "formats": [_format_of(field) for field, _ in seen],
                "offsets": [at for _, at in seen],
                "itemsize": self.record_size,
            }
        )


def read_header(opened: int, path: AnyPath) -> tuple[Header, int]:
    """What stands up to and with the DATA line, and the byte behind that.

    Args:
        opened: descriptor of the file.
        path: of the file, to tell.

    Raises:
        FileError: the header is cut, contradicts itself, or is none.
    """
    text = _last_text[0]
    if text and os.pread(opened, len(text), 0) == text:
        return _parse(text), len(text)
    try:
        with open(opened, "rb", closefd=False) as file:
            text = _header_text(file)
        header = _parse(text)
    except _HeaderError as error:
        raise FileError(path, f"{error}") from None
    _last_text[0] = text
    return header, len(text)


def format_header(header: Header) -> bytes:
    """The header as text, in the order that all readers know."""
    rows: dict[str, list[str] | list[int]] = {
        "VERSION": ["0.7"],
        "FIELDS": [field.name for field in header.fields],
        "SIZE": [field.size for field in header.fields],
        "TYPE": [field.kind for field in header.fields],
        "COUNT": [field.count for field in header.fields],
        "WIDTH": [header.width],
        "HEIGHT": [header.height],
        "VIEWPOINT": [repr(float(number)).removesuffix(".0") for number in header.viewpoint],
        "POINTS": [header.count],
        "DATA": [header.encoding],
    }
    lines = [f"{keyword} {' '.join(str(value) for value in values)}\n" for keyword, values in rows.items()]
    return "".join(["# .PCD v0.7 - Point Cloud Data file format\n", *lines]).encode()


class _HeaderError(Exception):
    """What is wrong with a header; the file's name is added where it is known."""


def _header_text(file: BinaryIO) -> bytes:
    """The lines up to and with DATA, each with a keyword that is known."""
    lines: list[bytes] = []
    for number in range(1, _MOST_LINES + 1):
        line = file.readline(_LONGEST_LINE)
        if len(line) == _LONGEST_LINE:
            raise _HeaderError(f"line {number} is longer than {_LONGEST_LINE} bytes; that is no header of a PCD file")
        keyword = line.split(None, 1)[0].upper() if line.strip() and not line.startswith(b"#") else b""
        if keyword and line.endswith(b"\n") and keyword.decode("utf-8", "replace") not in _KEYWORDS:
            raise _HeaderError(f"line {number} begins with {keyword[:40]!r}; that is no header of a PCD file")
        if not line.endswith(b"\n"):
            raise _HeaderError("is empty" if number == 1 and not line else "ends within its header, before its data")
        lines.append(line)
        if keyword == b"DATA":
            return b"".join(lines)
    raise _HeaderError(f"has no line DATA among its first {_MOST_LINES}; that is no PCD file")


@lru_cache(maxsize=16)  # the clouds of one recording have the same header
def _parse(text: bytes) -> Header:
    entries = _entries(text)
    fields = _fields(entries)
    width, height = _shape(entries)
    encoding = entries["DATA"][0].lower() if entries["DATA"] else ""
    if encoding not in ENCODINGS:
        raise _HeaderError(f"DATA is {encoding[:40]!r}; expected one of {', '.join(ENCODINGS)}")
    version = entries.get("VERSION", ["0.7"])
    if len(version) != 1 or version[0] not in _VERSIONS:
        raise _HeaderError(f"VERSION is {' '.join(version)[:40]!r}; expected 0.7")
    return Header(fields, width, height, _viewpoint(entries), encoding)


def _entries(text: bytes) -> dict[str, list[str]]:
    """Words behind each keyword."""
    entries: dict[str, list[str]] = {}
    for line in text.split(b"\n"):
        words = _words(line)
        if not words:
            continue
        keyword, values = words[0].upper(), words[1:]
        if keyword in entries:
            raise _HeaderError(f"gives {keyword} a second time in its header")
        entries[keyword] = values
    return entries


def _words(line: bytes) -> list[str]:
    if line.startswith(b"#"):
        return []
    try:
        text = line.decode()
    except UnicodeDecodeError:
        text = "\0"
    if "\0" in text:
        raise _HeaderError(f"has {line[:40]!r} in its header, which is no text")
    return text.split()


def _fields(entries: dict[str, list[str]]) -> tuple[Field, ...]:
    names = _row(entries, "COLUMNS" if "COLUMNS" in entries else "FIELDS", None)
    sizes = _numbers(_row(entries, "SIZE", names), "SIZE")
    kinds = [kind.upper() for kind in _row(entries, "TYPE", names)]
    counts = _numbers(_row(entries, "COUNT", names), "COUNT") if "COUNT" in entries else [1] * len(names)
    named = [name for name in names if name != "_"]
    if len(set(named)) < len(named) or not named:
        raise _HeaderError(f"has the fields {' '.join(names)[:80]}; expected at least one, each once")
    for name, size, kind, count in zip(names, sizes, kinds, counts, strict=True):
        if size not in _SIZES.get(kind, ()):
            raise _HeaderError(f"field {name} has TYPE {kind[:40]} and SIZE {size}; expected F 4 8, I or U 1 2 4 8")
        if count < 1:
            raise _HeaderError(f"field {name} has COUNT {count}; expected 1 or more")
    if sum(size * count for size, count in zip(sizes, counts, strict=True)) > _LARGEST_RECORD:
        raise _HeaderError(f"COUNT {counts} makes points larger than {_LARGEST_RECORD} bytes; the header is damaged")
    renamed = ["rgb" if name == "rgba" and "rgb" not in names else name for name in names]
    return tuple(Field(*column) for column in zip(renamed, sizes, kinds, counts, strict=True))


def _row(entries: dict[str, list[str]], keyword: str, names: list[str] | None) -> list[str]:
    """Words of a line that has one for each field."""
    if not entries.get(keyword):
        raise _HeaderError(f"has no {keyword} in its header")
    values = entries[keyword]
    if names is not None and len(values) != len(names):
        raise _HeaderError(f"has {len(names)} fields but {len(values)} in the line {keyword}")
    return values


def _numbers(words: list[str], keyword: str) -> list[int]:
    if not all(word.isascii() and word.isdigit() and len(word) < 20 for word in words):
        raise _HeaderError(f"{keyword} is {' '.join(words)[:40]!r}; expected whole numbers")
    return [int(word) for word in words]


def _shape(entries: dict[str, list[str]]) -> tuple[int, int]:
    """Width and height; a missing height is 1, a missing width follows from POINTS."""
    sides = {key: _side(entries[key], key) for key in ("WIDTH", "HEIGHT", "POINTS") if key in entries}
    height = sides.get("HEIGHT", 1)
    if "WIDTH" not in sides and ("POINTS" not in sides or height != 1):
        raise _HeaderError("has no WIDTH in its header")
    width = sides.get("WIDTH", sides.get("POINTS", 0))
    if sides.get("POINTS", width * height) != width * height:
        raise _HeaderError(f"WIDTH {width} times HEIGHT {height} is not POINTS {sides['POINTS']}")
    if max(width, height) > _LARGEST_SIDE:
        raise _HeaderError(f"WIDTH {width} and HEIGHT {height} go beyond {_LARGEST_SIDE}; the header is damaged")
    return width, height


def _side(words: list[str], keyword: str) -> int:
    if len(words) != 1:
        raise _HeaderError(f"{keyword} is {' '.join(words)[:40]!r}; expected one whole number")
    return _numbers(words, keyword)[0]


def _viewpoint(entries: dict[str, list[str]]) -> Viewpoint:
    if "VIEWPOINT" not in entries:
        return LEVEL
    words = entries["VIEWPOINT"]
    numbers = _attempt(lambda: [float(word) for word in words])
    if numbers is None or len(numbers) != 7 or not all(math.isfinite(number) for number in numbers):
        raise _HeaderError(f"VIEWPOINT is {' '.join(words)[:80]!r}; expected seven numbers: x y z qw qx qy qz")
    x, y, z, qw, qx, qy, qz = numbers
    return (x, y, z, qw, qx, qy, qz)


def _attempt(parse: Callable[[], list[float]]) -> list[float] | None:
    try:
        return parse()
    except ValueError:
        return None


def _format_of(field: Field) -> Any:
    if field.is_colour:
        return "<f4"
    number = f"<{field.type}"
    return number if field.count == 1 else (number, (field.count,))
