"""Point Cloud Data files, the Point Cloud Library's format: ascii, binary and binary_compressed."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, BinaryIO, Literal, cast

import numpy as np

from zsight_core.errors import FileError, PointsError
from zsight_core.files.atomic_file import AnyPath, atomic_file
from zsight_core.files.input_file import Descriptor, fill, require_size
from zsight_core.files.pcd_header import LEVEL, Field, Header, Viewpoint, format_header, read_header

if TYPE_CHECKING:
    from collections.abc import Sequence

    from zsight_core.points import Points

__all__ = ["LEVEL", "Encoding", "PcdFile", "Viewpoint", "read", "warm_up", "write"]

Encoding = Literal["ascii", "binary", "binary_compressed"]

_LARGEST_COMPRESSED = 4_000_000_000  # sizes have 32 bits, and what does not compress grows by 1/32


@dataclass(frozen=True, eq=False)  # arrays do not compare to one truth value
class PcdFile:
    """A cloud as its file has it.

    ``points`` (H, W), fields as in the file: several numbers a point are a subarray, padding ``_`` is a gap, a colour
    ``rgb`` or ``rgba`` of any type is the packed float32 ``rgb`` bit for bit; metres.
    ``viewpoint`` x y z qw qx qy qz: where the sensor stood, metres, and its quaternion with **w first**, as PCD has it.
    """

    points: Points
    viewpoint: Viewpoint
    encoding: Encoding


def read(path: AnyPath) -> PcdFile:
    """Read a cloud.

    Never more memory is taken than the file's size justifies, whatever its header promises.

    Raises:
        FileError: there is no such file, or it is empty, cut short, contradicts itself or is no PCD file.
    """
    with Descriptor(path) as (opened, size):
        header, at = read_header(opened, path)
        points = _READERS[header.encoding](opened, header, at, size - at, path)
    return PcdFile(points.reshape(header.height, header.width), header.viewpoint, cast(Encoding, header.encoding))


def write(
    path: AnyPath,
    points: Points,
    *,
    viewpoint: Sequence[float] = LEVEL,
    encoding: Encoding = "binary",
    overwrite: bool = False,
) -> None:
    """Write a cloud; the file appears whole or not at all.

    In ascii a packed ``rgb`` is written as an unsigned integer, because as a float text it loses bits (all of them
    where it is a NaN); other numbers get as many digits as it takes to read the same number back, except that the
    payload bits of NaN are lost. The binary encodings keep every bit. Padding is not written.

    Args:
        path: the file to make.
        points: (H, W) with integer or float32 or float64 fields, subarrays allowed, any byte order and padding; metres.
        viewpoint: where the sensor stood: x y z, metres, and the quaternion w x y z, w first.
        encoding: ascii, binary or binary_compressed.
        overwrite: replace a file that is there.

    Raises:
        PointsError: the cloud cannot be said in PCD.
        FileError: there is a file already, or the system refuses to write.
    """
    header = _header_of(points, viewpoint, encoding)
    with atomic_file(path, overwrite=overwrite) as file:
        packed = _packed(points)
        file.write(format_header(header))
        _WRITERS[encoding](file, header, packed, path)


def warm_up() -> None:
    """Compile the kernels of all encodings, or load them from the cache."""
    from zsight_core.files import field_columns, lzf, number_rows

    field_columns.warm_up()
    lzf.warm_up()
    number_rows.warm_up()


def _read_binary(opened: int, header: Header, at: int, size: int, path: AnyPath) -> Points:
    expected = header.count * header.record_size
    require_size(size, expected, path)
    if size >= expected + header.record_size:
        raise FileError(path, f"holds {size} bytes of data; its header promises {header.count} points, {expected}")
    points = np.empty(header.count, header.dtype)
    fill(opened, points, at, path)
    return points


def _read_compressed(opened: int, header: Header, at: int, size: int, path: AnyPath) -> Points:
    from zsight_core.files import field_columns, lzf

    packed_size, data_size = _compressed_sizes(opened, at, path)
    expected = header.count * header.record_size
    if data_size != expected:
        raise FileError(path, f"has {data_size} bytes of data; its header promises {header.count} points, {expected}")
    if packed_size > size - 8:
        raise FileError(path, f"is cut short: {size - 8} of {packed_size} compressed bytes are there")
    if data_size > lzf.MAX_RATIO * packed_size:
        raise FileError(path, f"is damaged: {packed_size} compressed bytes cannot hold {data_size}")
    stream, data = np.empty(packed_size, np.uint8), np.empty(data_size, np.uint8)
    fill(opened, stream, at + 8, path)
    if lzf.decompress(stream, data) != data_size:
        raise FileError(path, "is damaged: its compressed data do not expand to what the header promises")
    return field_columns.to_records(data, header.field_sizes).reshape(-1).view(header.dtype)


def _read_ascii(opened: int, header: Header, at: int, size: int, path: AnyPath) -> Points:
    from zsight_core.files import number_rows

    columns = _columns(header)
    require_size(size, number_rows.least_bytes(header.count, len(columns)), path)
    text = np.empty(size + number_rows.TAIL, np.uint8)
    fill(opened, text[:size], at, path)
    text[size:] = ord("\n")
    points = np.zeros(header.count, header.dtype)
    records = points.view(np.uint8).reshape(header.count, header.record_size)
    try:
        number_rows.parse_rows(text, records, columns)
    except number_rows.RowsError as error:
        raise FileError(path, f"{error}") from None
    return points


_READERS = {"ascii": _read_ascii, "binary": _read_binary, "binary_compressed": _read_compressed}


def _compressed_sizes(opened: int, at: int, path: AnyPath) -> tuple[int, int]:
    sizes = os.pread(opened, 8, at)
    if len(sizes) < 8:
        raise FileError(path, "is cut short: the sizes of its compressed data are missing")
    return int.from_bytes(sizes[:4], "little"), int.from_bytes(sizes[4:], "little")


def _columns(header: Header) -> list[Any]:
    """Each number of an ascii row; a colour is read as the type that the file gives it."""
    from zsight_core.files.number_rows import Column

    return [
        Column(field.type, -1 if field.is_padding else at + k * field.size)
        for field, at in zip(header.fields, header.offsets, strict=True)
        for k in range(field.count)
    ]


def _header_of(points: Points, viewpoint: Sequence[float], encoding: Encoding) -> Header:
    if encoding not in _WRITERS:
        raise PointsError(f"encoding is {encoding!r}; expected one of {', '.join(_WRITERS)}")
    x, y, z, qw, qx, qy, qz = [float(number) for number in viewpoint] if len(viewpoint) == 7 else [np.nan] * 7
    if not np.isfinite([x, y, z, qw, qx, qy, qz]).all():
        raise PointsError(f"viewpoint is {viewpoint}; expected seven finite numbers: x y z qw qx qy qz")
    if points.ndim != 2 or not points.dtype.names:
        raise PointsError(f"cloud has shape {points.shape} and dtype {points.dtype}; expected (H, W) and named fields")
    fields = tuple(_field_of(name, points.dtype[name], encoding) for name in points.dtype.names)
    height, width = points.shape
    return Header(fields, width, height, (x, y, z, qw, qx, qy, qz), encoding)


def _field_of(name: str, dtype: np.dtype[Any], encoding: Encoding) -> Field:
    base, count = dtype.base, int(np.prod(dtype.shape, dtype=int))
    kind = {"f": "F", "i": "I", "u": "U"}.get(base.kind)
    if kind is None or (kind == "F" and base.itemsize not in (4, 8)) or count < 1:
        raise PointsError(f"field {name} has type {dtype}; PCD holds float32, float64 and integers: convert it first")
    if name.split() != [name] or name == "_" or "\0" in name:
        raise PointsError(f"field name {name!r} cannot be written to PCD: it is blank, has a blank or means padding")
    field = Field(name, base.itemsize, kind, count)
    return Field(name, 4, "U", 1) if field.is_colour and encoding == "ascii" else field


def _packed(points: Points) -> Points:
    """The points one after another as (N,), little endian and without padding; not copied if they are so already."""
    dtype = points.dtype
    names = dtype.names or ()
    layout = np.dtype([(name, dtype[name].base.newbyteorder("<"), dtype[name].shape) for name in names])
    if dtype == layout and points.flags.c_contiguous:
        return points.reshape(-1)
    packed = np.empty(points.shape, layout)
    for name in names:
        packed[name] = points[name]
    return packed.reshape(-1)


def _write_binary(file: BinaryIO, header: Header, packed: Points, path: AnyPath) -> None:  # noqa: ARG001  as the others
    file.write(packed.view(np.uint8).data)


def _write_compressed(file: BinaryIO, header: Header, packed: Points, path: AnyPath) -> None:
    from zsight_core.files import field_columns, lzf

    if packed.nbytes >= _LARGEST_COMPRESSED:
        raise FileError(path, f"{packed.nbytes} bytes are too much for binary_compressed; write it as binary")
    data = field_columns.to_columns(packed.view(np.uint8).reshape(-1, header.record_size), header.field_sizes)
    stream = lzf.compress(data)
    file.write(len(stream).to_bytes(4, "little") + len(data).to_bytes(4, "little"))
    file.write(stream.data)


def _write_ascii(file: BinaryIO, header: Header, packed: Points, path: AnyPath) -> None:  # noqa: ARG001  as the others
    from zsight_core.files import number_rows

    numbers = np.dtype([(field.name, f"<{field.type}", (field.count,)) for field in header.fields])  # rgb: U
    file.writelines(text.data for text in number_rows.format_rows(packed.view(numbers)))


_WRITERS = {"ascii": _write_ascii, "binary": _write_binary, "binary_compressed": _write_compressed}
