"""The kernel that writes rows of numbers.

Each number is put together in two 64-bit words, sixteen letters, and then stored: functions that are handed arrays
would cost more than the spelling, because numba counts references at each call.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from zsight_core.files.eight_bytes import store
from zsight_core.files.number_kinds import FLOAT, POWERS, SIZES, TENS, TEXT, UNSIGNED
from zsight_core.jit import njit

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["ROOM", "TEXT_WIDTH", "WIDTHS", "spell_rows", "warm_up"]

TEXT_WIDTH = 25
"""Bytes of a number that comes as text, ended by a zero byte where it is shorter."""

WIDTHS = np.array([16, 0, 4, 6, 11, 20, 3, 5, 10, 20, TEXT_WIDTH], np.int64)
"""The most letters of a number of each kind; doubles come as text."""

ROOM = 32
"""So many letters more than that are needed, because several are stored at once."""

Count = int | np.int64

_POINT, _MINUS, _ZERO, _E = (np.uint64(ord(letter)) for letter in ".-0e")
_ZEROS = np.uint64(0x3030303030303030)
_0, _1, _8, _10 = (np.uint64(k) for k in (0, 1, 8, 10))  # a signed number beside them would make floats
_EIGHT_DIGITS, _SIXTEEN_DIGITS = np.uint64(10**8), np.uint64(10**16)
_ALL = np.uint64(2**64 - 1)
_NAN, _INF = (np.uint64(int.from_bytes(word, "little")) for word in (b"nan", b"inf"))


def warm_up() -> None:
    """Compile the kernel, or load it from the cache."""
    kinds = np.zeros(1, np.int64)
    spell_rows(np.zeros((1, 4), np.uint8), kinds, kinds, np.zeros(16 + ROOM, np.uint8))


@njit(cache=True, nogil=True)
def spell_rows(
    records: NDArray[np.uint8], kinds: NDArray[np.int64], places: NDArray[np.int64], letters: NDArray[np.uint8]
) -> int:
    """Write rows.

    Args:
        records: uint8 (rows, bytes a record), little endian.
        kinds: int64 (columns,), kind of each number, not DOUBLE.
        places: int64 (columns,), its byte in the record.
        letters: uint8, room for rows times the sum of WIDTHS and one, and ROOM.

    Returns:
        Number of letters written.
    """
    out: Count = 0
    for row in range(len(records)):
        for column in range(len(kinds)):
            kind, place = kinds[column], places[column]
            if kind == TEXT:
                for k in range(place, place + TEXT_WIDTH):
                    if records[row, k] == 0:
                        break
                    letters[out] = records[row, k]
                    out += 1
                letters[out] = 32
                out += 1
                continue
            bits, size = _0, SIZES[kind]
            for k in range(size):
                bits |= np.uint64(records[row, place + k]) << np.uint64(8 * k)
            if _is_negative(bits, kind, size):
                letters[out] = 45
                out += 1
                bits = (
                    bits & np.uint64(0x7FFFFFFF) if kind == FLOAT else (~bits + _1) & (_ALL >> np.uint64(64 - 8 * size))
                )
            if kind == FLOAT:
                low, high, length = _spell_single(bits)
            elif bits < _SIXTEEN_DIGITS:
                low, high, length = _spell_integer(bits)
            else:
                low, high, length = _spell_integer(bits // _SIXTEEN_DIGITS)
                store(letters, out, low)
                out += length
                rest = bits % _SIXTEEN_DIGITS
                low, high, length = _eight_digits(rest // _EIGHT_DIGITS), _eight_digits(rest % _EIGHT_DIGITS), 16
            store(letters, out, low)
            store(letters, out + 8, high)
            out += length
            letters[out] = 32
            out += 1
        letters[out - 1] = 10
    return int(out)


@njit(cache=True, nogil=True)
def _is_negative(bits: np.uint64, kind: int, size: int) -> bool:
    """True of numbers to be written with a minus; NaN has no sign."""
    if kind == FLOAT:
        return bool(np.uint64(0x80000000) <= bits <= np.uint64(0xFF800000))
    return bool(kind < UNSIGNED and bits >> np.uint64(8 * size - 1) != _0)


@njit(cache=True, nogil=True)
def _eight_digits(number: np.uint64) -> np.uint64:
    """Eight letters, with zeros in front, of a number below 10^8: halves, pairs and digits side by side."""
    halves = number // np.uint64(10000) | (number % np.uint64(10000)) << np.uint64(32)
    hundreds = ((halves * np.uint64(10486)) >> np.uint64(20)) & np.uint64(0x0000007F0000007F)
    pairs = hundreds | (halves - np.uint64(100) * hundreds) << np.uint64(16)
    tens = ((pairs * np.uint64(103)) >> np.uint64(10)) & np.uint64(0x000F000F000F000F)
    return (tens | (pairs - _10 * tens) << _8) | _ZEROS


@njit(cache=True, nogil=True)
def _count_digits(number: np.uint64) -> int:
    """How many digits a number below 10^9 has."""
    count = 1
    while count < 9 and number >= TENS[count]:
        count += 1
    return count


@njit(cache=True, nogil=True)
def _first(count: Count) -> np.uint64:
    """A mask of so many first letters, 1 to 8."""
    return _ALL >> np.uint64(64 - 8 * count)


@njit(cache=True, nogil=True)
def _spell_integer(number: np.uint64) -> tuple[np.uint64, np.uint64, Count]:
    """Up to sixteen digits without zeros in front."""
    front, back = number // _EIGHT_DIGITS, number % _EIGHT_DIGITS
    if front == _0:
        count = _count_digits(back)
        return _eight_digits(back) >> np.uint64(64 - 8 * count), _0, count
    count = _count_digits(front)
    return _append(_eight_digits(front) >> np.uint64(64 - 8 * count), _0, count, _eight_digits(back), 8)


@njit(cache=True, nogil=True)
def _append(
    low: np.uint64, high: np.uint64, length: Count, more: np.uint64, count: Count
) -> tuple[np.uint64, np.uint64, Count]:
    """Letters (low, high), of which so many count and the rest are zero, with up to eight more behind them."""
    if length < 8:
        low |= more << np.uint64(8 * length)
        high |= more >> _8 >> np.uint64(56 - 8 * length)  # in two steps, since one of 64 bits is none
    else:
        high |= more << np.uint64(8 * length - 64)
    return low, high, length + count


@njit(cache=True, nogil=True)
def _spell_single(bits: np.uint64) -> tuple[np.uint64, np.uint64, Count]:
    """A float32 without its sign: plainly where that is short (0.00123, 12.5, 1230000), else as 1.25e-09."""
    if bits >= np.uint64(0x7F800000):
        return _INF if bits == np.uint64(0x7F800000) else _NAN, _0, 3
    if bits == _0:
        return _ZERO, _0, 1
    number, count, power = _nine_digits(np.uint32(bits))
    rest = _eight_digits(number % _EIGHT_DIGITS)
    low, high = (_ZERO + number // _EIGHT_DIGITS) | rest << _8, rest >> np.uint64(56)  # nine letters
    if 0 <= power < 9:
        if count <= power + 1:
            return low, high, power + 1
        low, high = _with_point(low, high, power + 1)
        return low, high, count + 1
    if -5 <= power < 0:
        front = (_ZERO | _POINT << _8 | _ZEROS << np.uint64(16)) & _first(1 - power)
        ahead, behind, length = _append(front, _0, 1 - power, low, 8)
        return ahead, behind | high << np.uint64(8 * (1 - power)), length + count - 8
    if count > 1:
        low, high = _with_point(low, high, 1)
        count += 1
    low, high = low & _first(min(count, 8)), high & _first(count - 8) if count > 8 else _0
    exponent, size = _spell_exponent(power)
    return _append(low, high, count, exponent, size)


@njit(cache=True, nogil=True)
def _with_point(low: np.uint64, high: np.uint64, at: Count) -> tuple[np.uint64, np.uint64]:
    """Nine letters with a point put in behind the first 1 to 8."""
    kept = low & _first(at)
    high = high << _8
    if at == 8:
        return kept, high | _POINT
    return kept | _POINT << np.uint64(8 * at) | (low - kept) << _8, high | low >> np.uint64(56)


@njit(cache=True, nogil=True)
def _spell_exponent(power: Count) -> tuple[np.uint64, Count]:
    """The letter e and a power of ten of up to two digits."""
    text, length = _E, 1
    if power < 0:
        text |= _MINUS << _8
        power, length = -power, 2
    if power >= 10:
        text |= (_ZERO + np.uint64(power // 10)) << np.uint64(8 * length)
        length += 1
    return text | (_ZERO + np.uint64(power % 10)) << np.uint64(8 * length), length + 1


@njit(cache=True, nogil=True)
def _nine_digits(bits: np.uint32) -> tuple[np.uint64, int, Count]:
    """Digits d1 .. d9, how many of them count, and a power p, so that d1.d2 .. d9 x 10^p reads back as this float32.

    Seven digits count, or eight, or nine: the fewest of those that lie within half a step of the number; then zeros at
    the end do not count either. Nine always do: their spacing is below a third of that of float32, and the double
    arithmetic errs by 1e-15 only.
    """
    value = np.float64(np.uint32(bits).view(np.float32))
    smaller = np.float64(np.uint32(bits - np.uint32(1)).view(np.float32))  # the closer neighbour at powers of two
    if bits >= np.uint32(0x800000):
        power = ((np.int64(bits >> np.uint32(23)) - 127) * 1233) >> 12  # 2^x as 10^p: right or one too low
    else:
        power = np.int64(np.floor(np.log10(value)))
    shift = 8 - power
    scale = POWERS[shift] if shift >= 0 else 1 / POWERS[-shift]
    scaled, half_step = value * scale, 0.4995 * (value - smaller) * scale  # a little less than half: rounding errs, too
    if scaled >= 999999999.5:
        scaled, half_step, power = scaled * 0.1, half_step * 0.1, power + 1
    seven, eight = 100 * np.rint(scaled * 0.01), 10 * np.rint(scaled * 0.1)
    shorter = seven if abs(seven - scaled) < half_step else eight
    digits = shorter if abs(shorter - scaled) < half_step else np.rint(scaled)
    if digits >= 1e9:
        digits, power = 1e8, power + 1  # 9999999.6 has become 10000000
    number, count = np.uint64(np.int64(digits)), 9
    significant = number
    while significant % _10 == _0:
        significant //= _10
        count -= 1
    return number, count, power
