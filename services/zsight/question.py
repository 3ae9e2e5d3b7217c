"""A question that is answered at once: by the best server, or by all of them."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, TypeVar

from zsight.errors import DeadlinePassed, NobodyAnswers
from zsight.hosts.beats import present
from zsight_protocol.codec import decode, encode
from zsight_protocol.message import Message

if TYPE_CHECKING:
    from zsight.bus import Bus

__all__ = ["PATIENCE", "ask_question", "nobody"]

PATIENCE = 10.0  # seconds; a server that is there answers within milliseconds, unless its host is overloaded

M = TypeVar("M", bound=Message)


def ask_question(
    bus: Bus, key: str, question: Message, kind: type[M], *, everyone: bool, timeout: float = PATIENCE
) -> list[M]:
    """Every answer; at least one.

    Args:
        bus: where to ask.
        key: what the servers serve; may hold wildcards.
        question: what to ask.
        kind: of the answers.
        everyone: wait for all servers; otherwise the first answer is enough.
        timeout: seconds; answers that came before it are returned, whoever is still silent.

    Raises:
        NobodyAnswers: no server is there; tells who is.
        DeadlinePassed: a server is there, and none answered in time.
        RequestRefused: the server could not read the question.
        ConnectionLost: this process was cut off meanwhile.
    """
    replies = bus.ask(key, encode(question), timeout, everyone=everyone)
    deadline = time.monotonic() + timeout
    answers: list[M] = []
    ended = False
    try:
        while (everyone or not answers) and not ended:
            payload = replies.take(deadline - time.monotonic())
            if payload is None:
                ended = True
            else:
                answers.append(decode(kind, payload))
    except TimeoutError:
        replies.close()
    if answers:
        return answers
    if ended:
        raise nobody(bus, key)
    raise DeadlinePassed(f"whoever serves {key} did not answer within {timeout:g} s; {present(bus)}")


def nobody(bus: Bus, key: str) -> NobodyAnswers:
    """The error that nobody serves a key, with those who are there."""
    return NobodyAnswers(f"nobody answers on {key}: is the service running? {present(bus)}")
