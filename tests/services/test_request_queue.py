"""Requests are answered one after the other away from the link's thread, and those that find no room are refused."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING

import pytest
from tests.services.waiting import Arrivals

from zsight import limits
from zsight.bus.request_queue import RequestQueue
from zsight.errors import RequestRefused

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from zsight.bus import Bus, RawRequest

WAIT = 10.0


class Held:
    """Answers each request with its own bytes, once it may."""

    def __init__(self) -> None:
        self.begun: Arrivals[bytes] = Arrivals()
        self.go_on = threading.Event()

    def __call__(self, request: RawRequest) -> None:
        self.begun.add(request.payload)
        assert self.go_on.wait(WAIT)
        if request.payload == b"bad":
            raise RuntimeError(request.payload)
        request.reply(request.payload)
        request.close()


@pytest.fixture
def held() -> Iterator[Held]:
    held = Held()
    yield held
    held.go_on.set()


def serve(bus: Bus, held: Held, threads: int = 1) -> RequestQueue:
    queue = RequestQueue("test", threads=threads)
    bus.serve(bus.cell.catalog("*"), lambda request: queue.put(request, held))
    return queue


def test_all_are_answered_in_order_and_no_more_wait_than_there_is_room_for(
    join_memory: Callable[[], Bus], held: Held, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(limits, "WAITING", 2)
    server, client = join_memory(), join_memory()
    queue = serve(server, held)
    key = client.cell.catalog("*")
    asked = [client.ask(key, b"0", WAIT)]
    held.begun.wait(1)
    asked += [client.ask(key, b"%d" % number, WAIT) for number in (1, 2)]
    with pytest.raises(RequestRefused, match="2 requests wait already"):
        client.ask(key, b"3", WAIT).take(WAIT)
    held.go_on.set()
    assert [replies.take(WAIT) for replies in asked] == [b"0", b"1", b"2"]
    assert held.begun.all == [b"0", b"1", b"2"]
    queue.close()


def test_an_answer_that_fails_ends_no_other(join_memory: Callable[[], Bus], held: Held) -> None:
    server, client = join_memory(), join_memory()
    queue = serve(server, held)
    held.go_on.set()
    assert client.ask(client.cell.catalog("*"), b"bad", WAIT).take(WAIT) is None
    assert client.ask(client.cell.catalog("*"), b"good", WAIT).take(WAIT) == b"good"
    queue.close()


def test_so_many_are_answered_at_once(join_memory: Callable[[], Bus], held: Held) -> None:
    server, client = join_memory(), join_memory()
    queue = serve(server, held, threads=3)
    asked = [client.ask(client.cell.catalog("*"), b"%d" % number, WAIT) for number in range(4)]
    assert len(held.begun.wait(3)) == 3
    held.go_on.set()
    assert [replies.take(WAIT) for replies in asked] == [b"0", b"1", b"2", b"3"]
    queue.close()


def test_who_waits_at_the_end_is_told(join_memory: Callable[[], Bus], held: Held) -> None:
    server, client = join_memory(), join_memory()
    queue = serve(server, held)
    first, second = (client.ask(client.cell.catalog("*"), payload, WAIT) for payload in (b"first", b"second"))
    held.begun.wait(1)
    closing = threading.Thread(target=queue.close)
    closing.start()
    assert queue._closed.wait(WAIT)
    held.go_on.set()
    assert first.take(WAIT) == b"first"
    with pytest.raises(RequestRefused, match="stops"):
        second.take(WAIT)
    closing.join()
