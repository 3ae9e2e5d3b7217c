"""A flood of events: a few get through, the rest is counted, other places are not silenced."""

from __future__ import annotations

import io
import logging

import pytest

from zsight.log_flood import FEW, SPAN, LogFlood


class Told:
    """A logger with two handlers, and what the first has written."""

    def __init__(self) -> None:
        self.now = 0.0
        self.logger = logging.getLogger(f"flood.{id(self)}")
        self.logger.propagate = False
        self.logger.setLevel("INFO")
        self.streams = (io.StringIO(), io.StringIO())
        for stream in self.streams:
            handler = logging.StreamHandler(stream)
            handler.addFilter(LogFlood(lambda: self.now))
            self.logger.addHandler(handler)

    def lines(self, number: int = 0) -> list[str]:
        return self.streams[number].getvalue().splitlines()


@pytest.fixture
def told() -> Told:
    return Told()


def test_a_few_get_through_and_the_next_tells_of_the_others(told: Told) -> None:
    def complain(number: int) -> None:
        told.logger.warning("bad request %d", number)

    for number in range(FEW + 5):
        complain(number)
    told.now = SPAN / 2
    complain(98)
    assert told.lines() == [f"bad request {number}" for number in range(FEW)]
    told.now = SPAN
    complain(99)
    complain(100)
    for which in (0, 1):
        assert told.lines(which)[FEW:] == ["bad request 99 (and 6 more like this before)", "bad request 100"]


def test_other_places_are_heard(told: Told) -> None:
    for _ in range(FEW + 1):
        told.logger.warning("noise")
    told.logger.error("fire")
    assert told.lines()[-2:] == ["noise", "fire"]


def test_nothing_is_said_of_a_span_that_held_few(told: Told) -> None:
    for number in range(3 * FEW):
        told.now = number * SPAN / FEW
        told.logger.warning("slow")
    assert told.lines() == ["slow"] * 3 * FEW


def test_what_is_no_complaint_is_never_left_out(told: Told) -> None:
    for _ in range(3 * FEW):
        told.logger.info("found")
    assert len(told.lines()) == 3 * FEW
