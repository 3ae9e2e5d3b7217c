"""Events of logs: kept, sent as they come, asked for later; lines for people and as JSON."""

from __future__ import annotations

import io
import json
import logging
from typing import TYPE_CHECKING

import pytest
from tests.services.waiting import soon

from zsight.errors import UsageError
from zsight.log_book import LogBook, ask_logs, start_logging
from zsight_protocol.channels import Delivery
from zsight_protocol.log_event import LogEvent

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from zsight.bus import Bus, Reader

log = logging.getLogger("test.book")


@pytest.fixture(autouse=True)
def _level() -> Iterator[None]:
    root = logging.getLogger()
    before, handlers = root.level, root.handlers[:]
    root.setLevel("INFO")
    yield
    root.setLevel(before)
    root.handlers[:] = handlers


def test_events_come_as_they_are_said_and_are_told_later(join: Callable[[], Bus]) -> None:
    process, test = join(), join()
    with LogBook("near", "eye").on(process):
        reader = test.reader(test.cell.log("*", "*"), LogEvent, delivery=Delivery.EVERY)
        heard: list[LogEvent] = []
        assert soon(lambda: bool(_say_until(reader, heard)))
        event = heard[0]
        assert (event.host, event.process, event.severity, event.logger, event.text) == (
            "near",
            "eye",
            "WARNING",
            "test.book",
            "dust on lens 1",
        )
        log.info("wiped")
        told = ask_logs(test)
        assert told[-1].text == "wiped"
        assert [one.number for one in told] == list(range(1, len(told) + 1))
        assert ask_logs(test, process="other", timeout=0.2) == []


def _say_until(reader: Reader[LogEvent], heard: list[LogEvent]) -> list[LogEvent]:
    """Say it once more, for a reader that has just come may not be known yet; what it has heard."""
    log.warning("dust on lens %d", 1)
    received = reader.take(0.1)
    if received is not None:
        heard.append(received.message)
    return heard


def test_only_the_last_events_are_kept(join_memory: Callable[[], Bus]) -> None:
    bus = join_memory()
    with LogBook("near", "eye").on(bus):
        for number in range(300):
            log.info("event %d", number)
        told = ask_logs(join_memory())
    assert (len(told), told[-1].text, told[-1].number) == (200, "event 299", 300)


def test_a_bad_event_harms_nothing(join_memory: Callable[[], Bus]) -> None:
    bus = join_memory()
    with LogBook("near", "eye").on(bus):
        log.info("x" * 100_000)
        log.info("\udc00 surrogate")
        told = ask_logs(join_memory())
    assert len(told[0].text) == 8000


@pytest.mark.parametrize("form", ["", "json"])
def test_a_line_is_for_people_or_for_programs(monkeypatch: pytest.MonkeyPatch, form: str) -> None:
    stream = io.StringIO()
    monkeypatch.setattr("sys.stderr", stream)
    monkeypatch.setenv("ZSIGHT_LOG_FORMAT", form)
    monkeypatch.setenv("ZSIGHT_LOG", "info")
    start_logging("eye")
    log.info("two\nlines, %s", "ä")
    log.debug("not said")
    if form:
        (line,) = stream.getvalue().splitlines()
        entry = json.loads(line)
        assert entry.pop("time") > 1e9
        assert entry == {"severity": "INFO", "process": "eye", "logger": "test.book", "text": "two\nlines, ä"}
    else:
        assert "INFO    eye: two" in stream.getvalue()


@pytest.mark.parametrize(("name", "value"), [("ZSIGHT_LOG", "LOUD"), ("ZSIGHT_LOG_FORMAT", "xml")])
def test_a_severity_or_form_that_there_is_not_is_told(monkeypatch: pytest.MonkeyPatch, name: str, value: str) -> None:
    monkeypatch.setenv(name, value)
    with pytest.raises(UsageError, match=f"{name} is {value}; expected"):
        start_logging("eye")
