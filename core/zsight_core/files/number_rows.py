"""Rows of numbers as text, one record a line: read and written exactly.

Reading is correctly rounded: each decimal becomes the nearest number of the column's type. Writing uses as many digits
as it takes to read the same number back.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import numpy as np

from zsight_core.files import read_numbers, spell_numbers
from zsight_core.files.number_kinds import KINDS
from zsight_core.files.read_numbers import TAIL

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from zsight_core.points import Points

__all__ = ["TAIL", "Column", "RowsError", "columns_of", "format_rows", "least_bytes", "parse_rows", "warm_up"]

_HARD_WORDS = 4096
_ROWS_AT_ONCE = 1 << 15


@dataclass(frozen=True)
class Column:
    """One number of each row: its type as numpy writes it (``f4 f8 i1 .. i8 u1 .. u8``) and its byte in the record.

    A negative byte means that the number is read and dropped.
    """

    type: str
    at: int


class RowsError(Exception):
    """Text that is not the rows expected; the message says where."""


def columns_of(dtype: np.dtype[Any]) -> list[Column]:
    """The numbers of a row that fills a record of scalar fields, in their order."""
    fields: Any = dtype.fields
    return [Column(fields[name][0].str[1:], fields[name][1]) for name in dtype.names or ()]


def least_bytes(rows: int, columns: int) -> int:
    """The shortest text of so many rows: a digit and a blank a number; the last line may lack its end."""
    return max(2 * rows * columns - 1, 0)


def parse_rows(
    text: NDArray[np.uint8], records: NDArray[np.uint8], columns: Sequence[Column], *, more: bool = False
) -> None:
    """Read as many lines as there are records; empty lines are skipped, blanks and tabs part the numbers.

    Args:
        text: uint8 (bytes,), the last `TAIL` of which are line feeds.
        records: uint8 (rows, bytes a record), filled at the columns' bytes in little endian.
        columns: the numbers of a line, in order.
        more: further text may follow the rows.

    Raises:
        RowsError: a row is too short or too long, a word is no number or does not fit its type, rows are missing or
            left over.
    """
    kinds, places = _table(columns)
    cells, (rows, record) = records.reshape(-1), records.shape
    state = np.zeros(3, np.int64)  # byte of the text, row, number of hard words
    hard = np.empty((_HARD_WORDS, 4), np.int64)  # row, column, first byte, byte behind the last
    while True:
        code = int(read_numbers.read_rows(text, cells, rows, record, kinds, places, state, hard))
        for row, column, start, end in hard[: state[2]].tolist():
            word = text[start:end].tobytes()
            records_at = places[column]
            if records_at >= 0:
                bits = _exact(word, columns[column].type)
                records[row, records_at : records_at + len(bits)] = np.frombuffer(bits, np.uint8)
        if code == read_numbers.DONE or (code == read_numbers.MANY_ROWS and more):
            return
        if code != read_numbers.HARD:
            raise RowsError(_complaint(code, text, records, columns, state))


def format_rows(points: Points) -> Iterator[NDArray[np.uint8]]:
    """Write points as lines of numbers in the order of their fields.

    float32 are written with 7 to 9 digits, float64 with up to 17: the fewest of those that read back as the same
    number; NaN as ``nan`` whatever its bits.

    Args:
        points: structured array (rows,) of packed scalar or subarray fields of the types of `Column`, little endian.

    Yields:
        Pieces of the text, uint8 (bytes,), each ending with a line.
    """
    for start in range(0, len(points), _ROWS_AT_ONCE):
        piece, columns = _with_doubles_as_text(points[start : start + _ROWS_AT_ONCE])
        kinds, places = _table(columns)
        letters = np.empty(len(piece) * int((spell_numbers.WIDTHS[kinds] + 1).sum()) + spell_numbers.ROOM, np.uint8)
        records = np.ascontiguousarray(piece).view(np.uint8).reshape(len(piece), -1)
        yield letters[: spell_numbers.spell_rows(records, kinds, places, letters)]


def warm_up() -> None:
    """Compile the kernels, or load them from the cache."""
    read_numbers.warm_up()
    spell_numbers.warm_up()


def _table(columns: Sequence[Column]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    kinds = np.array([KINDS[column.type] for column in columns], np.int64)
    return kinds, np.array([column.at for column in columns], np.int64)


def _exact(word: bytes, number_type: str) -> bytes:
    """The bits of the number nearest to a decimal, by exact arithmetic."""
    if number_type[0] in "iu":
        return _exact_integer(word, number_type)
    value = float(word)  # correctly rounded to double
    if number_type == "f8" or value == 0 or np.isinf(value):
        return np.array(value, f"<{number_type}").tobytes()
    # A double that lies midway between two float32 was perhaps rounded to there: compare the decimal itself
    decimal = Fraction(word.decode())
    with np.errstate(over="ignore"):
        nearest = np.float32(value)
        candidates = [nearest, *(np.nextafter(nearest, np.float32(end)) for end in (-np.inf, np.inf))]
    distances = [abs(_exact_value(candidate) - decimal) for candidate in candidates]
    ties = [number for number, distance in zip(candidates, distances, strict=True) if distance == min(distances)]
    best = min(ties, key=lambda number: int(number.view(np.uint32)) & 1)  # midway: the even one
    return np.array(best, "<f4").tobytes()


def _exact_value(number: np.float32) -> Fraction:
    """The number as a fraction; infinity stands where the next float32 would, so that rounding reaches it."""
    return Fraction(float(number)) if np.isfinite(number) else Fraction(2**128) * (1 if number > 0 else -1)


def _exact_integer(word: bytes, number_type: str) -> bytes:
    try:
        return int(word).to_bytes(int(number_type[1:]), "little", signed=number_type[0] == "i")
    except OverflowError:
        raise RowsError(f"{word.decode()} does not fit a column of type {number_type}") from None


def _complaint(
    code: int, text: NDArray[np.uint8], records: NDArray[np.uint8], columns: Sequence[Column], state: NDArray[np.int64]
) -> str:
    at, row = int(state[0]), int(state[1])
    line = int(np.count_nonzero(text[:at] == ord("\n"))) + 1
    word = (text[at : at + 40].tobytes().split() or [b""])[0].decode("ascii", "replace")
    where = f"row {row + 1} (line {line} of the data)"
    match code:
        case read_numbers.SHORT_ROW:
            return f"{where} has too few numbers; expected {len(columns)}"
        case read_numbers.LONG_ROW:
            return f"{where} has more than the {len(columns)} numbers expected"
        case read_numbers.JUNK:
            return f"{where} holds {word!r}; expected a number"
        case read_numbers.RANGE:
            return f"{where} holds {word!r}, which does not fit its column of type {_type_at(text, at, columns)}"
        case read_numbers.FEW_ROWS:
            return f"the data end after {row} rows; the header promises {len(records)}"
        case _:
            return f"there are more rows than the {len(records)} that the header promises"


def _type_at(text: NDArray[np.uint8], at: int, columns: Sequence[Column]) -> str:
    line = text[:at].tobytes().rpartition(b"\n")[2]
    return columns[len(line.split())].type


def _with_doubles_as_text(points: Points) -> tuple[Points, list[Column]]:
    """The same records with each double as its shortest text (numpy's Dragon4), which the kernel copies."""
    dtype: Any = points.dtype
    fields: list[tuple[str, str, int]] = []
    for name in dtype.names:
        base, shape = dtype[name].base, dtype[name].shape
        kind = f"S{spell_numbers.TEXT_WIDTH}" if base == np.dtype("<f8") else base.str
        fields.append((name, kind, int(np.prod(shape, dtype=int))))
    spelled = np.dtype([(name, kind, (count,)) for name, kind, count in fields])
    columns: list[Column] = []
    for name, kind, count in fields:
        size = np.dtype(kind).itemsize
        start = spelled.fields[name][1] if spelled.fields else 0
        word = "text" if kind.startswith("S") else kind[1:]
        columns += [Column(word, start + size * k) for k in range(count)]
    copy = np.empty(len(points), spelled)
    for name, kind, count in fields:
        copy[name] = points[name].reshape(len(points), count).astype(kind)
    return copy, columns
