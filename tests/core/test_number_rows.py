"""Rows of numbers as text: exact both ways."""

from __future__ import annotations

import struct
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from zsight_core.files.number_rows import TAIL, Column, RowsError, columns_of, format_rows, parse_rows

if TYPE_CHECKING:
    from numpy.typing import NDArray

FLOAT_BITS = st.one_of(
    st.integers(0, 2**32 - 1),
    st.sampled_from([0, 1, 0x7FFFFF, 0x800000, 0x800001, 0x7F7FFFFF, 0x7F800000, 0x7FC00000, 0xFF800000, 0x80000000]),
    st.builds(lambda power, step: (power << 23) + step, st.integers(1, 254), st.integers(-1, 1)),
)


def text_of(records: NDArray[Any]) -> bytes:
    return b"".join(piece.tobytes() for piece in format_rows(records))


def parse(text: bytes, dtype: np.dtype[Any], rows: int = 1, *, more: bool = False) -> NDArray[Any]:
    records = np.zeros(rows, dtype)
    cells = records.view(np.uint8).reshape(rows, dtype.itemsize)
    parse_rows(np.frombuffer(text + b"\n" * TAIL, np.uint8), cells, columns_of(dtype), more=more)
    return records


def one(word: str, number_type: str) -> Any:
    return parse(word.encode(), np.dtype([("x", f"<{number_type}")]))["x"][0]


def nearest_single(decimal: Fraction) -> np.float32:
    """The float32 nearest to a positive decimal, by bisection over the numbers' order; midway the even one."""
    low, high = 0, 0x7F800000

    def value(bits: int) -> Fraction:
        return Fraction(2**128) if bits == 0x7F800000 else Fraction(struct.unpack("<f", struct.pack("<I", bits))[0])

    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if value(middle) <= decimal else (low, middle)
    down, up = decimal - value(low), value(high) - decimal
    bits = low if down < up or (down == up and low % 2 == 0) else high
    return np.uint32(bits).view(np.float32)


@given(st.lists(FLOAT_BITS, min_size=1, max_size=40))
def test_float32_come_back_bit_by_bit(bits: list[int]) -> None:
    numbers = np.array(bits, np.uint32).view(np.dtype([("x", "<f4")]))
    back = parse(text_of(numbers), numbers.dtype, len(bits))
    nan = np.isnan(numbers["x"])
    np.testing.assert_array_equal(np.isnan(back["x"]), nan)
    np.testing.assert_array_equal(back["x"][~nan].view(np.uint32), numbers["x"][~nan].view(np.uint32))


@given(FLOAT_BITS)
def test_python_and_numpy_read_the_same_float32(bits: int) -> None:
    number = np.uint32(bits).view(np.float32)
    word = text_of(np.array([number]).view([("x", "<f4")])).decode().strip()
    with np.errstate(over="ignore"):
        np.testing.assert_array_equal(np.float32(float(word)), number)
    assert len(word) <= 16


@given(
    st.integers(0, 10**25),
    st.integers(-75, 45),
    st.booleans(),
)
@example(16777217, 0, False)  # midway between two float32
@example(16777219, 0, False)
@example(167772170000000000000000001, -19, False)  # a little above midway, beyond the digits of a double
@example(33554434999999999999999999, -18, False)
@example(7006492321624085354618649164, -73, False)  # half of the smallest float32
@example(3402823567797336616375393954498, 8, False)  # next to where infinity begins
@example(34028235677973366163753939545, 10, True)
@example(1175494350822287507, -56, False)
def test_float32_are_read_as_the_nearest(digits: int, power: int, pointed: bool) -> None:
    word = f"{digits}e{power}"
    if pointed:
        text = str(digits)
        word = f"{text[:1]}.{text[1:]}e{power + len(text) - 1}"
    assert one(word, "f4") == nearest_single(Fraction(digits) * Fraction(10) ** power)
    assert one(f"-{word}", "f4") == -one(word, "f4")


@given(st.integers(1, 2**24 - 1), st.integers(-140, 100), st.sampled_from([-1, 0, 1]))
def test_decimals_at_and_beside_the_middle_of_two_float32_are_read_as_the_nearest(m: int, e: int, side: int) -> None:
    middle = (2 * m + 1) * Fraction(2) ** e
    digits = 10**60 * middle.numerator // middle.denominator + side
    assert one(f"{digits}e-60", "f4") == nearest_single(Fraction(digits, 10**60))


@given(st.one_of(st.floats(), st.floats(-10, 10)), st.sampled_from(["r", ".17g", ".25e", ".3f", "g"]))
def test_float64_are_read_as_python_does(number: float, style: str) -> None:
    word = repr(number) if style == "r" else format(number, style)
    np.testing.assert_array_equal(one(word, "f8"), np.float64(float(word)))


@given(st.lists(st.floats(), min_size=1, max_size=20))
def test_float64_come_back(numbers: list[float]) -> None:
    records = np.array(numbers).view([("x", "<f8")])
    np.testing.assert_array_equal(parse(text_of(records), records.dtype, len(records))["x"], records["x"])


@given(st.sampled_from(["i1", "i2", "i4", "i8", "u1", "u2", "u4", "u8"]), st.data())
def test_integers_come_back_and_do_not_wrap(number_type: str, draw: st.DataObject) -> None:
    limits = np.iinfo(number_type)
    number = draw.draw(st.one_of(st.sampled_from([limits.min, limits.max, 0]), st.integers(limits.min, limits.max)))
    records = np.array([number], number_type).view([("x", f"<{number_type}")])
    assert text_of(records) == f"{number}\n".encode()
    assert int(one(str(number), number_type)) == number
    assert int(one(f"00{number}" if number >= 0 else f"-00{-number}", number_type)) == number
    for outside in (limits.max + 1, limits.min - 1, 10 * limits.max + 5, 10**40):
        with pytest.raises(RowsError, match="does not fit"):
            one(str(outside), number_type)


@pytest.mark.parametrize(
    ("word", "number"),
    [
        ("nan", np.nan),
        ("NaN", np.nan),
        ("-nan", np.nan),
        ("inf", np.inf),
        ("+Inf", np.inf),
        ("-INFINITY", -np.inf),
        ("1e400", np.inf),
        ("-1e400", -np.inf),
        ("1e-400", 0),
        ("0e99999999999999999999", 0),
        (".5", 0.5),
        ("5.", 5),
        ("+1", 1),
        ("1E2", 100),
        ("1e+2", 100),
        ("0" * 900 + "1", 1),
        ("0." + "0" * 30 + "1e31", 1),
    ],
)  # fmt: skip  one line a few spellings
@pytest.mark.parametrize("number_type", ["f4", "f8"])
def test_spellings(word: str, number: float, number_type: str) -> None:
    np.testing.assert_array_equal(one(word, number_type), np.dtype(number_type).type(number))


@pytest.mark.parametrize("number_type", ["f4", "f8", "i4", "u1"])
@pytest.mark.parametrize(
    "word",
    [
        "x",
        "--1",
        "+-1",
        "1-",
        "1e",
        "1e+",
        ".",
        "-",
        "e5",
        "0x10",
        "1,5",
        "nano",
        "infin",
        "1_000",
        "1" * 1200,
        "#",
        "\0",
    ],
)
def test_junk_is_refused_and_shown(word: str, number_type: str) -> None:
    with pytest.raises(RowsError, match=r"row 1 \(line 1 of the data\) holds"):
        one(word, number_type)


@pytest.mark.parametrize("word", ["1.0", "nan", "1e2", "inf"])
def test_integers_are_whole(word: str) -> None:
    with pytest.raises(RowsError, match="expected a number"):
        one(word, "i4")


PAIR = np.dtype([("a", "<f4"), ("b", "u1")])


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        (b"1 2\n3\n", r"row 2 \(line 2 of the data\) has too few"),
        (b"1 2 3\n4 5\n", r"row 1 .* has more than the 2"),
        (b"1 2\n\n\n", "end after 1 rows; the header promises 2"),
        (b"", "end after 0 rows"),
        (b"1 2\n3 4\n5 6\n", "more rows than the 2"),
        (b"1 2\n\n3 256", r"row 2 \(line 3 of the data\) holds '256'.*u1"),
        (b"1 2\n3 4 junk", "more than"),
    ],
)  # fmt: skip  one line a few cases
def test_rows_that_are_not_there_or_too_many(text: bytes, complaint: str) -> None:
    with pytest.raises(RowsError, match=complaint):
        parse(text, PAIR, 2)


@pytest.mark.parametrize("text", [b"1 2\r\n3 4\r\n", b"\t1\t 2  \n\n  \n3 4", b"\n\n1 2\n3 4\n\n \n", b"1 2\n3 4"])
def test_blanks_empty_lines_and_line_ends_do_not_matter(text: bytes) -> None:
    assert parse(text, PAIR, 2).tolist() == [(1, 2), (3, 4)]


def test_more_may_follow_where_the_reader_says_so() -> None:
    assert parse(b"1 2\n3 4 5\n", PAIR, 1, more=True).tolist() == [(1, 2)]


def test_dropped_columns_are_read_but_not_kept() -> None:
    records = np.full((2, 4), 7, np.uint8)
    text = np.frombuffer(b"1e400 1 9\nnan 2 9" + b"\n" * TAIL, np.uint8)
    parse_rows(text, records, [Column("f4", -1), Column("u1", 2), Column("u8", -1)])
    assert records.tolist() == [[7, 7, 1, 7], [7, 7, 2, 7]]


def test_more_hard_words_than_fit_at_once_are_all_read() -> None:
    numbers = np.random.default_rng(0).random(10_000)
    text = "\n".join(format(number, ".17g") for number in numbers).encode()
    back = parse(text, np.dtype([("x", "<f8")]), len(numbers))
    np.testing.assert_array_equal(back["x"], numbers)


def test_many_rows_are_written_in_pieces_without_a_seam() -> None:
    records = np.arange(100_000, dtype=np.uint32).view([("x", "<u4")])
    assert text_of(records) == b"".join(b"%d\n" % number for number in range(100_000))
