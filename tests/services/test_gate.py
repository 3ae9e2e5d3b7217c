"""Requests beyond their greatest size or rate are refused at once and in words."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import pytest

from zsight import limits
from zsight.bus import Bus
from zsight.bus.gate import Gate
from zsight.bus.memory_link import MemoryLink, MemoryNetwork
from zsight.errors import RequestRefused

if TYPE_CHECKING:
    from zsight.bus import RawRequest


@dataclass
class Request:
    """A request that keeps why it was refused."""

    payload: bytes = b""
    key: str = "cell/catalog/*"
    refused: list[str] = field(default_factory=list)

    def reply(self, payload: bytes) -> None:
        raise AssertionError(payload)

    def refuse(self, words: str) -> None:
        self.refused.append(words)

    def close(self) -> None:
        raise AssertionError


class Clock:
    now = 100.0

    def __call__(self) -> float:
        return self.now


def test_a_seconds_worth_may_come_at_once_and_no_more(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(limits, "REQUESTS_PER_SECOND", 3.0)
    clock = Clock()
    through: list[RawRequest] = []
    gate = Gate(through.append, clock)
    requests = [Request() for _ in range(8)]
    for request in requests[:5]:
        gate(request)
    assert through == requests[:3]
    assert [len(request.refused) for request in requests[:5]] == [0, 0, 0, 1, 1]
    assert "more than 3 requests a second" in requests[3].refused[0]
    clock.now += 1 / 3 + 1e-6
    for request in requests[5:7]:
        gate(request)
    assert through == [*requests[:3], requests[5]]


def test_a_big_request_is_refused_by_any_server() -> None:
    network = MemoryNetwork()
    server, client = Bus(MemoryLink(network)), Bus(MemoryLink(network))
    server.serve(server.cell.catalog("*"), lambda request: request.reply(b"taken"))
    assert client.ask(client.cell.catalog("*"), bytes(limits.REQUEST_BYTES), 1.0).take(1.0) == b"taken"
    with pytest.raises(RequestRefused, match="a request of 1048577 bytes; expected at most 1048576"):
        client.ask(client.cell.catalog("*"), bytes(limits.REQUEST_BYTES + 1), 1.0).take(1.0)
