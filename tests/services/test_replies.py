"""Replies end when the network does."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

import pytest
from tests.services.waiting import DEADLINE

from zsight.bus import Bus
from zsight.bus.memory_link import MemoryLink
from zsight.errors import ConnectionLost, DeadlinePassed, RequestRefused
from zsight.question import ask_question, nobody
from zsight_protocol.action import CancelCode, CancelRequest, CancelResponse
from zsight_protocol.codec import encode

if TYPE_CHECKING:
    from zsight.bus.link import RawRequest, RequestHandler


@pytest.fixture
def link() -> MemoryLink:
    """The link of a process that is client and server at once."""
    return MemoryLink()


@pytest.fixture
def bus(link: MemoryLink) -> Bus:
    """That process."""
    return Bus(link)


def test_whoever_is_cut_off_learns_it_at_once(bus: Bus, link: MemoryLink) -> None:
    bus.serve(bus.cell.cancel("finder"), lambda _: link.cut())
    begin = time.monotonic()
    with pytest.raises(ConnectionLost, match="cut off"):
        bus.ask(bus.cell.cancel("finder"), b"", DEADLINE).take(DEADLINE)
    assert time.monotonic() - begin < DEADLINE / 2


def test_what_came_before_the_cut_is_still_taken(bus: Bus, link: MemoryLink) -> None:
    def answer(request: RawRequest) -> None:
        request.reply(b"here")
        link.cut()
        request.reply(b"too late")
        request.close()

    bus.serve(bus.cell.cancel("finder"), answer)
    replies = bus.ask(bus.cell.cancel("finder"), b"", DEADLINE)
    assert replies.take(DEADLINE) == b"here"
    with pytest.raises(ConnectionLost):
        replies.take(DEADLINE)


def test_who_is_cut_off_reaches_nobody(bus: Bus, link: MemoryLink) -> None:
    asked: list[RawRequest] = []
    bus.serve(bus.cell.cancel("finder"), asked.append)
    link.cut()
    assert bus.ask(bus.cell.cancel("finder"), b"", DEADLINE).take(DEADLINE) is None
    assert asked == []


def test_a_server_that_is_there_and_silent_is_told_from_none(bus: Bus) -> None:
    kept: list[object] = []
    bus.serve(bus.cell.cancel("finder"), kept.append)
    with pytest.raises(DeadlinePassed, match=r"did not answer within 0\.02 s"):
        ask_question(bus, bus.cell.cancel("finder"), CancelRequest(), CancelResponse, everyone=False, timeout=0.02)


def test_who_answers_is_heard_although_another_is_silent(bus: Bus) -> None:
    word = CancelResponse(code=CancelCode.NONE)
    kept: list[object] = []
    bus.serve(bus.cell.cancel("silent"), kept.append)
    bus.serve(bus.cell.cancel("loud"), lambda request: request.reply(encode(word)))
    answers = ask_question(bus, bus.cell.cancel("*"), CancelRequest(), CancelResponse, everyone=True, timeout=0.05)
    assert answers == [word]


def babble(request: RawRequest) -> None:
    request.reply(b"\xc1")
    request.close()


@pytest.mark.parametrize(
    ("other", "words"),
    [(babble, "not a CancelResponse"), (lambda request: request.refuse("what is that?"), "what is that")],
    ids=["not understood", "does not understand"],
)
def test_a_server_of_another_version_spoils_no_other_answer(
    bus: Bus, other: RequestHandler, words: str, caplog: pytest.LogCaptureFixture
) -> None:
    def ask() -> list[CancelResponse]:
        return ask_question(bus, bus.cell.cancel("*"), CancelRequest(), CancelResponse, everyone=True)

    bus.serve(bus.cell.cancel("other"), other)
    with pytest.raises(RequestRefused, match=words):
        ask()
    word = CancelResponse(code=CancelCode.NONE)

    def answer(request: RawRequest) -> None:
        request.reply(encode(word))
        request.close()

    bus.serve(bus.cell.cancel("known"), answer)
    assert ask() == [word]
    assert words in caplog.text


def test_an_error_that_tells_who_is_there_says_that_the_network_is_gone(bus: Bus, link: MemoryLink) -> None:
    bus.serve(bus.cell.health("desk", "voxel"), lambda _: link.cut())
    assert "cut off" in str(nobody(bus, bus.cell.cancel("finder")))
