"""The kernel that reads rows of numbers.

It works in double precision after Clinger (How to read floating point numbers accurately, 1990), and takes eight digits
at a time after Lemire (Number parsing at a gigabyte per second, 2021). Words for which that is not certain to give the
nearest number are left to the caller.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from zsight_core.files.eight_bytes import load
from zsight_core.files.number_kinds import BYTE, DOUBLE, FLOAT, POWERS, SIGNED, SIZES, TENS, UINT32, UNSIGNED
from zsight_core.jit import njit

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = [
    "DONE",
    "FEW_ROWS",
    "HARD",
    "JUNK",
    "LONG_ROW",
    "MANY_ROWS",
    "RANGE",
    "SHORT_ROW",
    "TAIL",
    "read_rows",
    "warm_up",
]

TAIL = 16
"""A text ends with so many line feeds more than it has, so that several letters can be looked at wherever one is."""

DONE, HARD, SHORT_ROW, LONG_ROW, JUNK, RANGE, FEW_ROWS, MANY_ROWS = range(8)

_LONGEST_WORD = 1100  # a double written out in full takes at most 1,077
_DOUBTFUL = 8  # steps of a double about the middle of two float32 within which the nearer is not certain
_FAR = np.int64(300)  # beyond these powers of ten a product may leave the range of double
_ONES = np.uint64(0x0101010101010101)
_HIGHS = np.uint64(0x8080808080808080)
_ZEROS = np.uint64(0x3030303030303030)
_ABOVE_NINE = np.uint64(0x4646464646464646)  # lifts what lies above a 9 over 127
_CAPITALS, _NAN = np.uint64(0xDFDFDF), np.uint64(int.from_bytes(b"NAN", "little"))
_0, _1, _2, _3, _8, _10 = (np.uint64(k) for k in (0, 1, 2, 3, 8, 10))  # a signed number beside them would make floats


def warm_up() -> None:
    """Compile the kernel, or load it from the cache."""
    text, kinds = np.full(2 * TAIL, ord("\n"), np.uint8), np.zeros(1, np.int64)
    read_rows(text, np.zeros(4, np.uint8), 1, 4, kinds, kinds, np.zeros(3, np.int64), np.zeros((1, 4), np.int64))


@njit(cache=True, nogil=True)
def read_rows(  # noqa: C901  one pass over the text with its six ways to end
    text: NDArray[np.uint8],
    records: NDArray[np.uint8],
    rows: int,
    record: int,
    kinds: NDArray[np.int64],
    places: NDArray[np.int64],
    state: NDArray[np.int64],
    hard: NDArray[np.int64],
) -> int:
    """Read rows until all are there, something is wrong, or the list of hard words may overflow.

    Args:
        text: uint8 (bytes,), the last `TAIL` of which are line feeds.
        records: uint8 (rows * record,), filled in little endian.
        rows: how many rows to read.
        record: bytes a record.
        kinds: int64 (columns,), kind of each number.
        places: int64 (columns,), its byte in the record; negative: read and dropped.
        state: int64 (3,): byte of the text and row to go on at, number of hard words found; changed.
        hard: int64 (M, 4): row, column, first byte and byte behind the last of words that take exact arithmetic.

    Returns:
        One of the codes of this file.
    """
    at, row = state[0], state[1]
    end = len(text) - TAIL + 1  # line feeds follow, so that inner loops need not look for the end
    width, found = len(kinds), 0
    while row < rows:
        at, row = _plain_rows(text, at, row, rows, records, record, kinds, places)
        if row == rows:
            break
        at = _skip_blanks(text, at)
        if text[at] == 10:  # an empty line, or the end
            at += 1
            if at >= end:
                state[0], state[1], state[2] = at, row, found
                return FEW_ROWS
            continue
        if found + width > len(hard):
            state[0], state[1], state[2] = at, row, found
            return HARD
        for column in range(width):
            at = _skip_blanks(text, at)
            if text[at] == 10:
                state[0], state[1], state[2] = at, row, found
                return SHORT_ROW
            start = at
            kind = kinds[column]
            at, code, bits = _word(text, at, kind)
            if code == HARD:
                hard[found, 0], hard[found, 1], hard[found, 2], hard[found, 3] = row, column, start, at
                found += 1
            elif code != DONE:
                state[0], state[1], state[2] = start, row, found
                return code
            place = places[column]
            if place >= 0:
                for k in range(SIZES[kind]):
                    records[row * record + place + k] = bits & BYTE
                    bits >>= np.uint64(8)
        at = _skip_blanks(text, at)
        if text[at] != 10:
            state[0], state[1], state[2] = at, row, found
            return LONG_ROW
        at += 1
        row += 1
    state[0], state[1], state[2] = at, row, found
    while at < end:
        if text[at] > 32:
            return MANY_ROWS
        at += 1
    return DONE


@njit(cache=True, nogil=True)
def _skip_blanks(text: NDArray[np.uint8], at: int) -> int:
    while text[at] == 32 or text[at] == 9 or text[at] == 13:
        at += 1
    return at


@njit(cache=True, nogil=True)
def _plain_rows(  # noqa: C901  in one piece, because calls for each number would take longer than the reading
    text: NDArray[np.uint8],
    start: int,
    row: int,
    rows: int,
    records: NDArray[np.uint8],
    record: int,
    kinds: NDArray[np.int64],
    places: NDArray[np.int64],
) -> tuple[Any, int]:
    """Read rows of usual words, such as -12.345, 1234567 and nan, up to the first with another one.

    Up to eight digits are taken at once, after Lemire (Number parsing at a gigabyte per second, 2021).

    Returns:
        The place in the text and the number of the first row that was not read.
    """
    at, behind = np.uint64(start), np.int64(start)
    plain: Any = True  # of two types for mypy, of one for numba
    while plain and row < rows:
        for column in range(len(kinds)):
            while text[at] == 32 or text[at] == 9:
                at += _1
            letters, kind = load(text, at), kinds[column]
            if kind == FLOAT and letters & _CAPITALS == _NAN and text[at + _3] <= 32:
                at += _3
                bits = np.uint32(0x7FC00000)
            else:
                negative = letters & BYTE == np.uint64(45)
                if negative:
                    at += _1
                    letters = load(text, at)
                number, count = (letters & BYTE) - np.uint64(48), _1
                if number < _10 and (letters >> _8) & BYTE == np.uint64(46):  # one digit and a point
                    at += _1
                else:
                    # a high bit in the first byte that is no digit, and perhaps in some behind it
                    others = ((letters + _ABOVE_NINE) | (letters - _ZEROS)) & _HIGHS
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
                if kind == FLOAT:
                    scale, exponent = _0, np.int64(0)
                    if text[at] == 46:
                        at += _1
                        letters = load(text, at)
                        others = ((letters + _ABOVE_NINE) | (letters - _ZEROS)) & _HIGHS
                        below = (others & (~others + _1)) - _1
                        scale = (((below & _ONES) * _ONES) >> np.uint64(56)) - _1 if others != _0 else _8
                        digits = (letters - _ZEROS) << (_8 * (_8 - scale)) if scale > _0 else _0
                        digits = ((digits * np.uint64(2561)) >> np.uint64(8)) & np.uint64(0x00FF00FF00FF00FF)
                        digits = ((digits * np.uint64(6553601)) >> np.uint64(16)) & np.uint64(0x0000FFFF0000FFFF)
                        number = number * TENS[scale] + ((digits * np.uint64(42949672960001)) >> np.uint64(32))
                        at += scale
                        while scale >= _8 and 48 <= text[at] <= 57 and count + scale < np.uint64(18):
                            number = number * _10 + np.uint64(text[at] - 48)
                            at += _1
                            scale += _1
                    if text[at] | 32 == 101:  # e
                        downward = text[at + _1] == 45
                        at += _2 if downward or text[at + _1] == 43 else _1
                        plain = 48 <= text[at] <= 57
                        while 48 <= text[at] <= 57 and exponent < 1000:
                            exponent = exponent * 10 + np.int64(text[at]) - 48
                            at += _1
                        exponent = -exponent if downward else exponent
                    power = exponent - np.int64(scale)
                    if power < 0:
                        value = np.float64(np.int64(number)) / POWERS[min(-power, _FAR)]
                    else:
                        value = np.float64(np.int64(number)) * POWERS[min(power, _FAR)]
                    nearest = _nearest_single(value)
                    plain = plain and count + scale > _0 and nearest >= 0 and -_FAR <= power <= _FAR
                    bits = np.uint32(np.uint64(nearest) | np.uint64(negative) << np.uint64(31))
                else:
                    plain = count > _0 and kind == UINT32 and not negative and number <= np.uint64(0xFFFFFFFF)
                    bits = np.uint32(number)
                plain = plain and text[at] <= 32
                if not plain:
                    break
            place = places[column]
            if place >= 0:
                _put_word(records, row * record + place, bits)
        while text[at] == 32 or text[at] == 9 or text[at] == 13:
            at += _1
        plain = plain and text[at] == 10
        if plain:
            at += _1
            behind = np.int64(at)
            row += 1
    return behind, row


@njit(cache=True, nogil=True)
def _put_word(records: NDArray[np.uint8], at: int, bits: np.uint32) -> None:
    place = np.uint64(at)
    records[place] = np.uint8(bits)
    records[place + np.uint64(1)] = np.uint8(bits >> np.uint32(8))
    records[place + np.uint64(2)] = np.uint8(bits >> np.uint32(16))
    records[place + np.uint64(3)] = np.uint8(bits >> np.uint32(24))


@njit(cache=True, nogil=True)
def _word(text: NDArray[np.uint8], at: int, kind: int) -> tuple[int, int, np.uint64]:
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
    if kind >= SIGNED:
        if not whole:
            return start, JUNK, np.uint64(0)
        return _integer(at, negative, mantissa, kept, scale, kind)
    if kind == DOUBLE:
        return _double(at, negative, mantissa, kept, scale)
    return _single(at, negative, mantissa, scale)


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
    if kind >= SIGNED:
        return start, JUNK, np.uint64(0)
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
        return start, JUNK, np.uint64(0)
    value = np.nan if nan else np.inf
    if kind == FLOAT:
        bits = np.uint64(np.float32(value).view(np.uint32))
        return end, DONE, bits | np.uint64(1 << 31) if negative else bits
    bits = np.float64(value).view(np.uint64)
    return end, DONE, bits | np.uint64(1 << 63) if negative else bits


@njit(cache=True, nogil=True)
def _integer(
    at: int, negative: bool, mantissa: np.uint64, kept: int, scale: int, kind: int
) -> tuple[int, int, np.uint64]:
    """An integer in two's complement, if its type holds it; 20 digits are those of 2^64 and need care."""
    size = 1 << (kind - SIGNED) if kind < UNSIGNED else 1 << (kind - UNSIGNED)
    bits = np.uint64(8 * size)
    if kept > 20 or scale > 1:
        return at, RANGE, np.uint64(0)
    if scale == 1:
        return at, HARD, np.uint64(0)
    if kind >= UNSIGNED:
        if (negative and mantissa != 0) or (size < 8 and mantissa >> bits != 0):
            return at, RANGE, np.uint64(0)
        return at, DONE, mantissa
    limit = np.uint64(1) << (bits - np.uint64(1))
    if mantissa > limit or (mantissa == limit and not negative):
        return at, RANGE, np.uint64(0)
    return at, DONE, ~mantissa + np.uint64(1) if negative else mantissa


@njit(cache=True, nogil=True)
def _double(at: int, negative: bool, mantissa: np.uint64, kept: int, scale: int) -> tuple[int, int, np.uint64]:
    """Clinger's fast path: both factors are exact doubles, so that one operation rounds correctly."""
    value = 0.0
    if mantissa != 0:
        if kept > 19 or mantissa > np.uint64(1 << 53) or not -22 <= scale <= 22:
            return at, HARD, np.uint64(0)
        value = np.float64(mantissa)
        value = value / POWERS[-scale] if scale < 0 else value * POWERS[scale]
    bits = np.float64(value).view(np.uint64)
    return at, DONE, bits | np.uint64(1 << 63) if negative else bits


@njit(cache=True, nogil=True)
def _single(at: int, negative: bool, mantissa: np.uint64, scale: int) -> tuple[int, int, np.uint64]:
    """In double with an error of a few units in the last place, which matters only next to the middle of two float32.

    19 digits of mantissa, one power of ten and one product err by less than 2 units together.
    """
    sign = np.uint64(1 << 31) if negative else np.uint64(0)
    if mantissa == 0:
        return at, DONE, sign
    if not -_FAR <= scale <= _FAR:
        return at, HARD, np.uint64(0)
    value = np.float64(mantissa)
    value = value / POWERS[-scale] if scale < 0 else value * POWERS[scale]
    nearest = _nearest_single(value)
    if nearest < 0:
        return at, HARD, np.uint64(0)
    return at, DONE, np.uint64(nearest) | sign


@njit(cache=True, nogil=True)
def _nearest_single(value: float) -> np.int64:
    """Bits of the float32 nearest to a number known to some units of its last place; -1 where that is not certain.

    It is not next to the middle of two float32 and where the largest ends.
    """
    if value < 1.1754943508222875e-38:  # below the normal float32: count steps of 2^-149
        steps = value * 7.136238463529799e44  # 2^149
        below = np.floor(steps)
        if abs(steps - below - 0.5) < 1e-6:
            return np.int64(-1)
        return np.int64(below + (steps - below > 0.5))
    tail = np.int64(np.float64(value).view(np.uint64) & np.uint64((1 << 29) - 1))
    if abs(tail - (1 << 28)) <= _DOUBTFUL or value > 3.4028234e38:
        return np.int64(-1)
    return np.int64(np.float32(value).view(np.uint32))
