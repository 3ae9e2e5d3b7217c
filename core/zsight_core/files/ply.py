"""PLY files, Stanford's polygon format, as far as they are clouds: the element ``vertex``; ascii and both binaries."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, BinaryIO, Literal, cast

import numpy as np

from zsight_core.errors import FileError, PointsError
from zsight_core.files.atomic_file import AnyPath, atomic_file
from zsight_core.files.input_file import fill, input_file, require_size

if TYPE_CHECKING:
    from collections.abc import Iterator
    from io import BufferedReader

    from numpy.typing import NDArray

    from zsight_core.points import Points

__all__ = ["PlyEncoding", "PlyFile", "read", "warm_up", "write"]

PlyEncoding = Literal["ascii", "binary_little_endian", "binary_big_endian"]

_TYPES = {
    "char": "i1",
    "uchar": "u1",
    "short": "i2",
    "ushort": "u2",
    "int": "i4",
    "uint": "u4",
    "float": "f4",
    "double": "f8",
    "int8": "i1",
    "uint8": "u1",
    "int16": "i2",
    "uint16": "u2",
    "int32": "i4",
    "uint32": "u4",
    "float32": "f4",
    "float64": "f8",
}  # fmt: skip  the format's first names, and below them those that came later
_NAMES = {"i1": "char", "u1": "uchar", "i2": "short", "u2": "ushort", "i4": "int", "u4": "uint", "f4": "float",
          "f8": "double"}  # fmt: skip
_COLOUR = ("red", "green", "blue")
_ENCODINGS = ("ascii", "binary_little_endian", "binary_big_endian")
_LONGEST_LINE = 1 << 16
_MOST_LINES = 4096
_MOST_VERTICES = (1 << 32) - 1


@dataclass(frozen=True, eq=False)  # arrays do not compare to one truth value
class PlyFile:
    """A cloud as its file has it.

    ``points`` (1, N): the vertex's properties in their order and types, little endian; ``red green blue`` of type uchar
    are the packed float32 ``rgb``. Coordinates have the file's unit; PLY does not say which.
    """

    points: Points
    encoding: PlyEncoding


def read(path: AnyPath) -> PlyFile:
    """Read the vertices; faces and other elements behind them are left out.

    Never more memory is taken than the file's size justifies, whatever its header promises.

    Raises:
        FileError: there is no such file, or it is empty, cut short, contradicts itself or is no PLY file; the vertices
            have lists; something other than a one-line-a-row element of plain numbers stands before them.
    """
    with input_file(path) as (file, size):
        header = _read_header(file, path)
        read_rows = _read_ascii if header.encoding == "ascii" else _read_binary
        records = read_rows(file, header, size - file.tell(), path)
    return PlyFile(_with_packed_colour(records).reshape(1, -1), header.encoding)


def write(
    path: AnyPath, points: Points, *, encoding: PlyEncoding = "binary_little_endian", overwrite: bool = False
) -> None:
    """Write a cloud as vertices; the file appears whole or not at all.

    The packed ``rgb`` becomes ``red green blue`` (its upper byte, an alpha in some files, is not kept). PLY has no rows
    and columns and no 64-bit integers: an organised cloud comes back as one row. In ascii the numbers have as many
    digits as it takes to read them back.

    Args:
        path: the file to make.
        points: (H, W) with float32, float64 or integer fields of up to 32 bits, one number each; metres.
        encoding: ascii, binary_little_endian or binary_big_endian.
        overwrite: replace a file that is there.

    Raises:
        PointsError: the cloud cannot be said in PLY.
        FileError: there is a file already, or the system refuses to write.
    """
    if encoding not in _ENCODINGS:
        raise PointsError(f"encoding is {encoding!r}; expected one of {', '.join(_ENCODINGS)}")
    records = _with_separate_colours(points)
    with atomic_file(path, overwrite=overwrite) as file:
        file.write(_format_header(records, encoding))
        _write_rows(file, records, encoding)


def warm_up() -> None:
    """Compile the kernels, or load them from the cache."""
    from zsight_core.files import number_rows

    number_rows.warm_up()


@dataclass(frozen=True)
class _Element:
    """What the header says of one element; ``properties`` are name and type as numpy writes it, lists have none."""

    name: str
    count: int
    properties: list[tuple[str, str | None]]


@dataclass(frozen=True)
class _Header:
    encoding: PlyEncoding
    elements: list[_Element]

    @property
    def before(self) -> list[_Element]:
        return self.elements[: self._place]

    @property
    def vertex(self) -> _Element:
        return self.elements[self._place]

    @property
    def _place(self) -> int:
        return [element.name for element in self.elements].index("vertex")


def _read_header(file: BufferedReader, path: AnyPath) -> _Header:
    elements: list[_Element] = []
    encoding = None
    for words in _header_lines(file, path):
        match words:
            case ["format", kind, "1.0"] if kind in _ENCODINGS and encoding is None:
                encoding = cast(PlyEncoding, kind)
            case ["element", name, count] if count.isascii() and count.isdigit() and len(count) < 20:
                elements.append(_Element(name, int(count), []))
            case ["property", "list", _, _, name] if elements:
                elements[-1].properties.append((name, None))
            case ["property", kind, name] if elements and kind in _TYPES:
                elements[-1].properties.append((name, _TYPES[kind]))
            case _:
                raise FileError(path, f"has the header line {' '.join(words)[:60]!r}, which is not PLY 1.0")
    if encoding is None:
        raise FileError(path, "has no line format in its header")
    _require_cloud(elements, path)
    return _Header(encoding, elements)


def _header_lines(file: BufferedReader, path: AnyPath) -> Iterator[list[str]]:
    first = file.readline(_LONGEST_LINE)
    if first.strip() != b"ply":
        raise FileError(path, "is empty" if not first else "does not begin with the line ply; that is no PLY file")
    for _ in range(_MOST_LINES):
        line = file.readline(_LONGEST_LINE)
        if not line.endswith(b"\n"):
            raise FileError(path, "ends within its header; expected a line end_header")
        words = line.decode("utf-8", "replace").split()
        if words == ["end_header"]:
            return
        if words and words[0] not in ("comment", "obj_info"):
            yield words
    raise FileError(path, f"has no line end_header among its first {_MOST_LINES}; that is no PLY file")


def _require_cloud(elements: list[_Element], path: AnyPath) -> None:
    names = [element.name for element in elements]
    if names.count("vertex") != 1:
        raise FileError(path, f"has the elements {', '.join(names)[:80] or 'none'}; expected vertex, once")
    for element in elements[: names.index("vertex") + 1]:
        properties = [name for name, _ in element.properties]
        if any(kind is None for _, kind in element.properties):
            raise FileError(path, f"element {element.name} has a list; only plain numbers can be read there")
        if not properties or len(set(properties)) < len(properties):
            raise FileError(path, f"element {element.name} has the properties {properties}; expected some, each once")
        if element.count > _MOST_VERTICES:
            raise FileError(path, f"element {element.name} is there {element.count} times; the header is damaged")


def _dtype(element: _Element, order: str = "<") -> np.dtype[Any]:
    return np.dtype([(name, f"{order}{kind}") for name, kind in element.properties])


def _read_binary(file: BufferedReader, header: _Header, size: int, path: AnyPath) -> Points:
    order = "<" if header.encoding == "binary_little_endian" else ">"
    before = sum(element.count * _dtype(element).itemsize for element in header.before)
    vertex, dtype = header.vertex, _dtype(header.vertex, order)
    require_size(size, before + vertex.count * dtype.itemsize, path)
    records = np.empty(vertex.count, dtype)
    fill(file.fileno(), records, file.tell() + before, path)
    return records if order == "<" else records.astype(_dtype(vertex))


def _read_ascii(file: BufferedReader, header: _Header, size: int, path: AnyPath) -> Points:
    from zsight_core.files import number_rows

    vertex = header.vertex
    lines_before = sum(element.count for element in header.before)
    require_size(size, 2 * lines_before + number_rows.least_bytes(vertex.count, len(vertex.properties)), path)
    text = np.empty(size + number_rows.TAIL, np.uint8)
    fill(file.fileno(), text[:size], file.tell(), path)
    text[size:] = ord("\n")
    records = np.zeros(vertex.count, _dtype(vertex))
    cells = records.view(np.uint8).reshape(vertex.count, records.dtype.itemsize)
    rows = text[_after_lines(text, size, lines_before, path) :]
    try:
        number_rows.parse_rows(rows, cells, number_rows.columns_of(records.dtype), more=header.elements[-1] != vertex)
    except number_rows.RowsError as error:
        raise FileError(path, f"{error}") from None
    return records


def _after_lines(text: NDArray[np.uint8], size: int, count: int, path: AnyPath) -> int:
    """Where the line number ``count`` (from 0) begins; the file's own text has ``size`` bytes."""
    if count == 0:
        return 0
    ends = np.flatnonzero(text[:size] == ord("\n"))
    if len(ends) < count:
        raise FileError(path, f"is cut short: {len(ends)} lines of data are there, {count} before the vertices")
    return int(ends[count - 1]) + 1


def _with_packed_colour(records: Points) -> Points:
    """The same records with uchar red, green, blue packed into one field rgb in the place of red."""
    names = records.dtype.names or ()
    if "rgb" in names or any(name not in names or records.dtype[name] != np.uint8 for name in _COLOUR):
        return records
    kept = [name for name in names if name not in ("green", "blue")]
    layout = [("rgb", np.dtype("<f4")) if name == "red" else (name, records.dtype[name]) for name in kept]
    packed = np.empty(len(records), np.dtype(layout))
    for name in kept:
        if name != "red":
            packed[name] = records[name]
    red, green, blue = (records[name].astype(np.uint32) for name in _COLOUR)
    packed["rgb"] = (red << 16 | green << 8 | blue).view(np.float32)
    return packed


def _with_separate_colours(points: Points) -> Points:
    """Records (N,), packed and little endian, with the field rgb taken apart."""
    if points.ndim != 2 or not points.dtype.names:
        raise PointsError(f"cloud has shape {points.shape} and dtype {points.dtype}; expected (H, W) and named fields")
    columns: dict[str, NDArray[Any]] = {}
    for name in points.dtype.names:
        if name == "rgb" and points.dtype[name].itemsize == 4:
            if set(_COLOUR) & set(points.dtype.names):
                raise PointsError("cloud has both rgb and red, green or blue, which are the same in PLY; drop one")
            columns |= _channels(points[name].reshape(-1))
        else:
            _require_sayable(name, points.dtype[name])
            columns[name] = points[name].reshape(-1)
    records = np.empty(points.size, [(name, column.dtype.newbyteorder("<")) for name, column in columns.items()])
    for name, column in columns.items():
        records[name] = column
    return records


def _channels(packed: NDArray[Any]) -> dict[str, NDArray[np.uint8]]:
    """Red, green and blue of packed colours (N,) of any byte order and type of four bytes."""
    bits = np.ascontiguousarray(packed.astype(packed.dtype.newbyteorder("="))).view(np.uint32)
    return {name: (bits >> shift & 255).astype(np.uint8) for name, shift in zip(_COLOUR, (16, 8, 0), strict=True)}


def _require_sayable(name: str, dtype: np.dtype[Any]) -> None:
    if dtype.str[1:] not in _NAMES:
        raise PointsError(
            f"field {name} has type {dtype}; PLY holds float32, float64, integers to 32 bits: convert it first"
        )
    if name.split() != [name] or "\0" in name:
        raise PointsError(f"field name {name!r} cannot be written to PLY: it is blank or has a blank")


def _format_header(records: Points, encoding: PlyEncoding) -> bytes:
    dtype = records.dtype
    properties = [f"property {_NAMES[dtype[name].str[1:]]} {name}" for name in dtype.names or ()]
    return "\n".join(
        ["ply", f"format {encoding} 1.0", f"element vertex {len(records)}", *properties, "end_header", ""]
    ).encode()


def _write_rows(file: BinaryIO, records: Points, encoding: PlyEncoding) -> None:
    if encoding == "ascii":
        from zsight_core.files import number_rows

        file.writelines(text.data for text in number_rows.format_rows(records))
        return
    ordered = records if encoding == "binary_little_endian" else records.astype(records.dtype.newbyteorder(">"))
    file.write(ordered.view(np.uint8).data)
