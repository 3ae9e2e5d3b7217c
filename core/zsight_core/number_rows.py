"""Rows of numbers as text, one record a line: read and written exactly.

Reading is correctly rounded: each decimal becomes the nearest number of the column's type. The kernel works in double
precision after Clinger (How to read floating point numbers accurately, 1990); where that cannot decide, it hands the
word to exact integer arithmetic. Writing uses as many digits as it takes to read the same number back.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import numpy as np
from numba import njit

from zsight_core.eight_bytes import load

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from zsight_core.points import Points

__all__ = ["TAIL", "Column", "RowsError", "columns_of", "format_rows", "least_bytes", "parse_rows", "warm_up"]

TAIL = 16
"""A text to read ends with so many line feeds more than it has, for a kernel that looks at several letters at once."""


@dataclass(frozen=True)
class Column:
    """One number of each row: its type as numpy writes it (``f4 f8 i1 .. i8 u1 .. u8``) and its byte in the record.

    A negative byte means that the number is read and dropped.
    """

    type: str
    at: int


class RowsError(Exception):
    """Text that is not the rows expected; the message says where."""


_KINDS = {"f4": 0, "f8": 1, "i1": 2, "i2": 3, "i4": 4, "i8": 5, "u1": 6, "u2": 7, "u4": 8, "u8": 9, "text": 10}
_SIZES = np.array([4, 8, 1, 2, 4, 8, 1, 2, 4, 8], np.int64)
_FLOAT, _DOUBLE, _SIGNED, _UNSIGNED, _UINT32, _TEXT = 0, 1, 2, 6, 8, 10
_WIDTHS = np.array([16, 0, 4, 6, 11, 20, 3, 5, 10, 20, 25], np.int64)  # the longest number of each kind, in letters
_DOUBTFUL = 8  # steps of a double about the middle of two float32 within which the nearer is not certain
_POWERS = np.array([float(f"1e{k}") for k in range(309)])
_TEXT_WIDTH = 25
_LONGEST_WORD = 1100  # a double written out in full takes at most 1,077
_HARD_WORDS = 4096
_ROWS_AT_ONCE = 1 << 15

# What stops the kernel that reads
_DONE, _HARD, _SHORT_ROW, _LONG_ROW, _JUNK, _RANGE, _FEW_ROWS, _MANY_ROWS = range(8)

_ONES = np.uint64(0x0101010101010101)
_HIGHS = np.uint64(0x8080808080808080)
_ZEROS = np.uint64(0x3030303030303030)
_ABOVE_NINE = np.uint64(0x4646464646464646)  # lifts what lies above a 9 over 127
_TENS = np.array([10**k for k in range(9)], np.uint64)
_0, _1, _3, _8, _10 = (np.uint64(k) for k in (0, 1, 3, 8, 10))  # with a signed number, numba would go over to float
_NAN = np.uint64(int.from_bytes(b"NAN", "little"))
_CAPITALS = np.uint64(0xDFDFDF)


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
        code = int(_parse(text, cells, rows, record, kinds, places, _SIZES, _POWERS, state, hard))
        for row, column, start, end in hard[: state[2]].tolist():
            word = text[start:end].tobytes()
            records_at = places[column]
            if records_at >= 0:
                bits = _exact(word, columns[column].type)
                records[row, records_at : records_at + len(bits)] = np.frombuffer(bits, np.uint8)
        if code == _DONE or (code == _MANY_ROWS and more):
            return
        if code != _HARD:
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
        letters = np.empty(len(piece) * int((_WIDTHS[kinds] + 1).sum()), np.uint8)
        records = np.ascontiguousarray(piece).view(np.uint8).reshape(len(piece), -1)
        yield letters[: _format(records, kinds, places, _SIZES, _POWERS, letters)]


def warm_up() -> None:
    """Compile the kernels, or load them from the cache."""
    points = np.zeros(1, np.dtype([("x", "<f4")]))
    text = np.concatenate([*format_rows(points), np.full(TAIL, ord("\n"), np.uint8)])
    parse_rows(text, points.view(np.uint8).reshape(1, 4), [Column("f4", 0)])


def _table(columns: Sequence[Column]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    kinds = np.array([_KINDS[column.type] for column in columns], np.int64)
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
        case 2:
            return f"{where} has too few numbers; expected {len(columns)}"
        case 3:
            return f"{where} has more than the {len(columns)} numbers expected"
        case 4:
            return f"{where} holds {word!r}; expected a number"
        case 5:
            return f"{where} holds {word!r}, which does not fit its column of type {_type_at(text, at, columns)}"
        case 6:
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
        kind = f"S{_TEXT_WIDTH}" if base == np.dtype("<f8") else base.str
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


@njit(cache=True, nogil=True)
def _parse(  # noqa: C901  one pass over the text with its six ways to end
    text: NDArray[np.uint8],
    records: NDArray[np.uint8],
    rows: int,
    record: int,
    kinds: NDArray[np.int64],
    places: NDArray[np.int64],
    sizes: NDArray[np.int64],
    powers: NDArray[np.float64],
    state: NDArray[np.int64],
    hard: NDArray[np.int64],
) -> int:
    """Read rows until all are there, something is wrong, or the list of hard words may overflow."""
    at, row = state[0], state[1]
    end = len(text) - TAIL + 1  # line feeds follow, so that inner loops need not look for the end
    width, found = len(kinds), 0
    while row < rows:
        behind = _plain_row(text, at, records, row * record, kinds, places, powers)
        if behind > 0:
            at = behind
            row += 1
            continue
        at = _skip_blanks(text, at)
        if text[at] == 10:  # an empty line, or the end
            at += 1
            if at >= end:
                state[0], state[1], state[2] = at, row, found
                return _FEW_ROWS
            continue
        if found + width > len(hard):
            state[0], state[1], state[2] = at, row, found
            return _HARD
        for column in range(width):
            at = _skip_blanks(text, at)
            if text[at] == 10:
                state[0], state[1], state[2] = at, row, found
                return _SHORT_ROW
            start = at
            kind = kinds[column]
            at, code, bits = _word(text, at, kind, powers)
            if code == _HARD:
                hard[found, 0], hard[found, 1], hard[found, 2], hard[found, 3] = row, column, start, at
                found += 1
            elif code != _DONE:
                state[0], state[1], state[2] = start, row, found
                return code
            place = places[column]
            if place >= 0:
                _put_bits(records, row * record + place, sizes[kind], bits)
        at = _skip_blanks(text, at)
        if text[at] != 10:
            state[0], state[1], state[2] = at, row, found
            return _LONG_ROW
        at += 1
        row += 1
    state[0], state[1], state[2] = at, row, found
    while at < end:
        if text[at] > 32:
            return _MANY_ROWS
        at += 1
    return _DONE


@njit(cache=True, nogil=True)
def _skip_blanks(text: NDArray[np.uint8], at: int) -> int:
    while text[at] == 32 or text[at] == 9 or text[at] == 13:
        at += 1
    return at


@njit(cache=True, nogil=True)
def _plain_row(  # noqa: C901  in one piece, because calls for each number would take longer than the reading
    text: NDArray[np.uint8],
    start: int,
    records: NDArray[np.uint8],
    record: int,
    kinds: NDArray[np.int64],
    places: NDArray[np.int64],
    powers: NDArray[np.float64],
) -> np.int64:
    """Read a row of usual words, such as -12.345, 1234567 and nan; give the place behind it, or 0 where one is unusual.

    Up to eight digits are taken at once, after Lemire (Number parsing at a gigabyte per second, 2021).
    """
    at = np.uint64(start)
    for column in range(len(kinds)):
        while text[at] == 32 or text[at] == 9:
            at += _1
        letters, kind = load(text, at), kinds[column]
        if kind == _FLOAT and letters & _CAPITALS == _NAN and text[at + _3] <= 32:
            at += _3
            bits = np.uint32(0x7FC00000)
        else:
            negative = letters & np.uint64(255) == np.uint64(45)
            if negative:
                at += _1
                letters = load(text, at)
            others = (
                (letters + _ABOVE_NINE) | (letters - _ZEROS)
            ) & _HIGHS  # up to and with the first that is no digit
            below = (others & (~others + _1)) - _1
            count = (((below & _ONES) * _ONES) >> np.uint64(56)) - _1 if others != _0 else _8
            digits = (letters - _ZEROS) << (_8 * (_8 - count)) if count > _0 else _0  # with zeros in front
            digits = ((digits * np.uint64(2561)) >> np.uint64(8)) & np.uint64(0x00FF00FF00FF00FF)
            digits = ((digits * np.uint64(6553601)) >> np.uint64(16)) & np.uint64(0x0000FFFF0000FFFF)
            number = (digits * np.uint64(42949672960001)) >> np.uint64(32)
            at += count
            while count >= _8 and 48 <= text[at] <= 57 and count < _10:
                number = number * _10 + np.uint64(text[at] - 48)
                at += _1
                count += _1
            if kind == _FLOAT:
                scale = _0
                if text[at] == 46:
                    at += _1
                    letters = load(text, at)
                    others = ((letters + _ABOVE_NINE) | (letters - _ZEROS)) & _HIGHS
                    below = (others & (~others + _1)) - _1
                    scale = (((below & _ONES) * _ONES) >> np.uint64(56)) - _1 if others != _0 else _8
                    digits = (letters - _ZEROS) << (_8 * (_8 - scale)) if scale > _0 else _0
                    digits = ((digits * np.uint64(2561)) >> np.uint64(8)) & np.uint64(0x00FF00FF00FF00FF)
                    digits = ((digits * np.uint64(6553601)) >> np.uint64(16)) & np.uint64(0x0000FFFF0000FFFF)
                    number = number * _TENS[scale] + ((digits * np.uint64(42949672960001)) >> np.uint64(32))
                    at += scale
                    while scale >= _8 and 48 <= text[at] <= 57 and count + scale < np.uint64(18):
                        number = number * _10 + np.uint64(text[at] - 48)
                        at += _1
                        scale += _1
                value = np.float64(np.int64(number)) / powers[scale]
                tail = np.int64(np.float64(value).view(np.uint64) & np.uint64((1 << 29) - 1))
                if abs(tail - (1 << 28)) <= _DOUBTFUL:
                    return np.int64(0)
                bits = np.float32(value).view(np.uint32) | np.uint32(np.uint64(negative) << np.uint64(31))
                count += scale
            elif kind == _UINT32:
                if negative or number > np.uint64(0xFFFFFFFF):
                    return np.int64(0)
                bits = np.uint32(number)
            else:
                return np.int64(0)
            if count == _0 or text[at] > 32:
                return np.int64(0)
        place = places[column]
        if place >= 0:
            _put_bits(records, record + place, 4, np.uint64(bits))
    while text[at] == 32 or text[at] == 9 or text[at] == 13:
        at += _1
    return np.int64(at + _1) if text[at] == 10 else np.int64(0)


@njit(cache=True, nogil=True)
def _put_bits(records: NDArray[np.uint8], at: int, size: int, bits: np.uint64) -> None:
    place = np.uint64(at)
    if size == 4:  # written out, so that it becomes one move
        records[place] = np.uint8(bits)
        records[place + np.uint64(1)] = np.uint8(bits >> np.uint64(8))
        records[place + np.uint64(2)] = np.uint8(bits >> np.uint64(16))
        records[place + np.uint64(3)] = np.uint8(bits >> np.uint64(24))
        return
    for k in range(size):
        records[place + np.uint64(k)] = np.uint8(bits >> np.uint64(8 * k))


@njit(cache=True, nogil=True)
def _word(text: NDArray[np.uint8], at: int, kind: int, powers: NDArray[np.float64]) -> tuple[int, int, np.uint64]:
    """Read one word; gives the byte behind it, a code and the number's bits."""
    start = at
    negative = text[at] == 45
    if negative or text[at] == 43:
        at += 1
    mantissa = np.uint64(0)
    digits, kept, scale = 0, 0, 0  # digits read; of them in the mantissa, without leading zeros; power of ten
    while 48 <= text[at] <= 57:
        if kept < 19:
            mantissa = mantissa * np.uint64(10) + np.uint64(text[at] - 48)
            kept += mantissa != 0
        else:
            kept += 1
            scale += 1
        digits += 1
        at += 1
    whole = text[at] <= 32
    if text[at] == 46:
        at += 1
        while 48 <= text[at] <= 57:
            if kept < 19:
                mantissa = mantissa * np.uint64(10) + np.uint64(text[at] - 48)
                kept += mantissa != 0
                scale -= 1
            else:
                kept += 1
            digits += 1
            at += 1
    if digits > 0 and (text[at] == 101 or text[at] == 69):
        at, power = _power(text, at)
        scale += power
    if digits == 0 or text[at] > 32 or at - start > _LONGEST_WORD:
        return _named(text, start, kind)
    if kind >= _SIGNED:
        if not whole:
            return start, _JUNK, np.uint64(0)
        return _integer(at, negative, mantissa, kept, scale, kind)
    if kind == _DOUBLE:
        return _double(at, negative, mantissa, kept, scale, powers)
    return _single(at, negative, mantissa, scale, powers)


@njit(cache=True, nogil=True)
def _power(text: NDArray[np.uint8], at: int) -> tuple[int, int]:
    """Read the power of ten behind an e; without digits it is left unread, which makes the word junk."""
    start = at
    at += 1
    negative = text[at] == 45
    if negative or text[at] == 43:
        at += 1
    if not 48 <= text[at] <= 57:
        return start, 0
    power = 0
    while 48 <= text[at] <= 57:
        power = min(power * 10 + int(text[at]) - 48, 100000)
        at += 1
    return at, -power if negative else power


@njit(cache=True, nogil=True)
def _named(text: NDArray[np.uint8], start: int, kind: int) -> tuple[int, int, np.uint64]:
    """nan, inf or infinity in any case and with any sign; anything else is junk."""
    at = start
    negative = text[at] == 45
    if negative or text[at] == 43:
        at += 1
    end = at
    while text[end] > 32:
        end += 1
    if kind >= _SIGNED:
        return start, _JUNK, np.uint64(0)
    nan, inf = False, False
    if end - at == 3:
        a, b, c = text[at] | 32, text[at + 1] | 32, text[at + 2] | 32
        nan = a == 110 and b == 97 and c == 110
        inf = a == 105 and b == 110 and c == 102
    elif end - at == 8:
        inf = True
        for k, letter in enumerate((105, 110, 102, 105, 110, 105, 116, 121)):
            inf = inf and (text[at + k] | 32) == letter
    if not nan and not inf:
        return start, _JUNK, np.uint64(0)
    value = np.nan if nan else np.inf
    if kind == _FLOAT:
        bits = np.uint64(np.float32(value).view(np.uint32))
        return end, _DONE, bits | np.uint64(1 << 31) if negative else bits
    bits = np.float64(value).view(np.uint64)
    return end, _DONE, bits | np.uint64(1 << 63) if negative else bits


@njit(cache=True, nogil=True)
def _integer(
    at: int, negative: bool, mantissa: np.uint64, kept: int, scale: int, kind: int
) -> tuple[int, int, np.uint64]:
    """An integer in two's complement, if its type holds it; 20 digits are those of 2^64 and need care."""
    size = 1 << (kind - _SIGNED) if kind < _UNSIGNED else 1 << (kind - _UNSIGNED)
    bits = np.uint64(8 * size)
    if kept > 20 or scale > 1:
        return at, _RANGE, np.uint64(0)
    if scale == 1:
        return at, _HARD, np.uint64(0)
    if kind >= _UNSIGNED:
        if (negative and mantissa != 0) or (size < 8 and mantissa >> bits != 0):
            return at, _RANGE, np.uint64(0)
        return at, _DONE, mantissa
    limit = np.uint64(1) << (bits - np.uint64(1))
    if mantissa > limit or (mantissa == limit and not negative):
        return at, _RANGE, np.uint64(0)
    return at, _DONE, ~mantissa + np.uint64(1) if negative else mantissa


@njit(cache=True, nogil=True)
def _double(
    at: int, negative: bool, mantissa: np.uint64, kept: int, scale: int, powers: NDArray[np.float64]
) -> tuple[int, int, np.uint64]:
    """Clinger's fast path: both factors are exact doubles, so that one operation rounds correctly."""
    value = 0.0
    if mantissa != 0:
        if kept > 19 or mantissa > np.uint64(1 << 53) or not -22 <= scale <= 22:
            return at, _HARD, np.uint64(0)
        value = np.float64(mantissa)
        value = value / powers[-scale] if scale < 0 else value * powers[scale]
    bits = np.float64(value).view(np.uint64)
    return at, _DONE, bits | np.uint64(1 << 63) if negative else bits


@njit(cache=True, nogil=True)
def _single(
    at: int, negative: bool, mantissa: np.uint64, scale: int, powers: NDArray[np.float64]
) -> tuple[int, int, np.uint64]:
    """In double with an error of a few units in the last place, which matters only next to the middle of two float32.

    19 digits of mantissa, one power of ten and one product err by less than 2 units together.
    """
    sign = np.uint64(1 << 31) if negative else np.uint64(0)
    if mantissa == 0:
        return at, _DONE, sign
    if not -300 <= scale <= 300:
        return at, _HARD, np.uint64(0)
    value = np.float64(mantissa)
    value = value / powers[-scale] if scale < 0 else value * powers[scale]
    if value < 1.1754943508222875e-38:  # below the normal float32: count steps of 2^-149
        steps = value * 7.136238463529799e44  # 2^149
        below = np.floor(steps)
        if abs(steps - below - 0.5) < 1e-6:
            return at, _HARD, np.uint64(0)
        return at, _DONE, np.uint64(below + (steps - below > 0.5)) | sign
    if value > 3.4028234e38:
        return at, _HARD, np.uint64(0)
    tail = np.int64(np.float64(value).view(np.uint64) & np.uint64((1 << 29) - 1))
    if abs(tail - (1 << 28)) <= _DOUBTFUL:
        return at, _HARD, np.uint64(0)
    return at, _DONE, np.uint64(np.float32(value).view(np.uint32)) | sign


@njit(cache=True, nogil=True)
def _format(
    records: NDArray[np.uint8],
    kinds: NDArray[np.int64],
    places: NDArray[np.int64],
    sizes: NDArray[np.int64],
    powers: NDArray[np.float64],
    letters: NDArray[np.uint8],
) -> int:
    out = 0
    for row in range(len(records)):
        for column in range(len(kinds)):
            kind, place = kinds[column], places[column]
            if kind == _TEXT:
                out = _put_text(records[row], place, letters, out)
            else:
                bits = np.uint64(0)
                for k in range(sizes[kind]):
                    bits |= np.uint64(records[row, place + k]) << np.uint64(8 * k)
                if kind == _FLOAT:
                    out = _put_single(np.uint32(bits), powers, letters, out)
                else:
                    out = _put_integer(bits, kind, sizes[kind], letters, out)
            letters[out] = 32
            out += 1
        letters[out - 1] = 10
    return out


@njit(cache=True, nogil=True)
def _put_text(record: NDArray[np.uint8], place: int, letters: NDArray[np.uint8], out: int) -> int:
    for k in range(place, place + _TEXT_WIDTH):
        if record[k] == 0:
            break
        letters[out] = record[k]
        out += 1
    return out


@njit(cache=True, nogil=True)
def _put_integer(bits: np.uint64, kind: int, size: int, letters: NDArray[np.uint8], out: int) -> int:
    if kind < _UNSIGNED and bits >> np.uint64(8 * size - 1) & np.uint64(1):
        letters[out] = 45
        out += 1
        bits = ~bits + np.uint64(1)
        if size < 8:
            bits &= (np.uint64(1) << np.uint64(8 * size)) - np.uint64(1)
    return _put_digits(bits, _count_digits(bits), letters, out)


@njit(cache=True, nogil=True)
def _count_digits(number: np.uint64) -> int:
    count = 1
    while number >= np.uint64(10):
        number //= np.uint64(10)
        count += 1
    return count


@njit(cache=True, nogil=True)
def _put_digits(number: np.uint64, count: int, letters: NDArray[np.uint8], out: int) -> int:
    for k in range(out + count - 1, out - 1, -1):
        letters[k] = np.uint64(48) + number % np.uint64(10)
        number //= np.uint64(10)
    return out + count


@njit(cache=True, nogil=True)
def _put_single(bits: np.uint32, powers: NDArray[np.float64], letters: NDArray[np.uint8], out: int) -> int:
    value = np.float64(np.uint32(bits).view(np.float32))
    if np.isnan(value):
        letters[out], letters[out + 1], letters[out + 2] = 110, 97, 110
        return out + 3
    if bits >> np.uint32(31):
        letters[out] = 45
        out += 1
        value = -value
    if np.isinf(value):
        letters[out], letters[out + 1], letters[out + 2] = 105, 110, 102
        return out + 3
    if value == 0:
        letters[out] = 48
        return out + 1
    digits, count, power = _decimal(value, np.uint32(bits) & np.uint32(0x7FFFFFFF), powers)
    return _put_decimal(digits, count, power, letters, out)


@njit(cache=True, nogil=True)
def _decimal(value: float, bits: np.uint32, powers: NDArray[np.float64]) -> tuple[np.uint64, int, int]:
    """Digits d1 d2 .. dn and a power p with value = d1.d2 .. dn x 10^p, n the least of 7, 8, 9 that reads back.

    Nine digits always do: their spacing is below a third of that of float32, and the double arithmetic errs by 1e-15.
    """
    power = int(np.floor(np.log10(value)))
    below = np.float64(np.uint32(bits - np.uint32(1)).view(np.float32))  # the closer neighbour at powers of two
    half_step = 0.5 * (value - below)
    for count in range(7, 10):
        shift = count - 1 - power
        scaled = value * powers[shift] if shift >= 0 else value / powers[-shift]
        digits = np.rint(scaled)
        back = digits / powers[shift] if shift >= 0 else digits * powers[-shift]
        if count == 9 or abs(back - value) < 0.999 * half_step:
            break
    number, shown = np.uint64(digits), _count_digits(np.uint64(digits))
    while number % np.uint64(10) == 0:
        number //= np.uint64(10)
    # the logarithm may be off by one next to a power of ten, and rounding may carry: count what came out
    return number, _count_digits(number), shown - 1 - shift


@njit(cache=True, nogil=True)
def _put_decimal(digits: np.uint64, count: int, power: int, letters: NDArray[np.uint8], out: int) -> int:
    """Plainly where that is short (0.00123, 12.5, 1230000), else as 1.25e-09."""
    if 0 <= power < 9:
        if count <= power + 1:
            out = _put_digits(digits, count, letters, out)
            for _ in range(power + 1 - count):
                letters[out] = 48
                out += 1
            return out
        return _put_pointed(digits, count, power + 1, letters, out)
    if -5 <= power < 0:
        letters[out], letters[out + 1] = 48, 46
        out += 2
        for _ in range(-1 - power):
            letters[out] = 48
            out += 1
        return _put_digits(digits, count, letters, out)
    out = _put_pointed(digits, count, 1, letters, out)
    letters[out] = 101
    out += 1
    if power < 0:
        letters[out] = 45
        out += 1
        power = -power
    return _put_digits(np.uint64(power), 2 if power > 9 else 1, letters, out)


@njit(cache=True, nogil=True)
def _put_pointed(digits: np.uint64, count: int, before: int, letters: NDArray[np.uint8], out: int) -> int:
    """Digits with a point behind the first so many; none where nothing follows."""
    if count == before:
        return _put_digits(digits, count, letters, out)
    _put_digits(digits, count, letters, out + 1)
    for k in range(before):
        letters[out + k] = letters[out + k + 1]
    letters[out + before] = 46
    return out + count + 1
