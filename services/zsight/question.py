"""A question that is answered at once: by the best server, or by all of them."""

from __future__ import annotations

import logging
import time
from typing import TYPE_CHECKING, TypeVar

from zsight.errors import DeadlinePassed, NobodyAnswers, RequestRefused
from zsight.hosts.beats import present
from zsight_protocol.codec import decode, encode
from zsight_protocol.errors import ProtocolError
from zsight_protocol.message import Message

if TYPE_CHECKING:
    from zsight.bus import Bus

__all__ = ["PATIENCE", "ask_question", "nobody"]

log = logging.getLogger(__name__)

PATIENCE = 10.0  # seconds; a server that is there answers within milliseconds, unless its host is overloaded

M = TypeVar("M", bound=Message)


def ask_question(
    bus: Bus, key: str, question: Message, kind: type[M], *, everyone: bool, timeout: float = PATIENCE
) -> list[M]:
    """Every answer; at least one. What a server of another version says or does not understand is logged and skipped.

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
        RequestRefused: a server could not read the question, or its answer could not be read, and no other answered.
        ConnectionLost: this process was cut off meanwhile.
    """
    replies = bus.ask(key, encode(question), timeout, everyone=everyone)
    deadline = time.monotonic() + timeout
    answers: list[M] = []
    refused: list[str] = []
    ended = False
    try:
        while (everyone or not answers) and not ended:
            try:
                payload = replies.take(deadline - time.monotonic())
                if payload is None:
                    ended = True
                else:
                    answers.append(decode(kind, payload))
            except (ProtocolError, RequestRefused) as error:
                refused.append(str(error))
    except TimeoutError:
        replies.close()
    words = "; ".join(dict.fromkeys(refused))
    if answers and refused:
        log.warning("answers on %s are left out: %s", key, words)
    if answers:
        return answers
    if refused:
        raise RequestRefused(words)
    if ended:
        raise nobody(bus, key)
    raise DeadlinePassed(f"whoever serves {key} did not answer within {timeout:g} s; {present(bus)}")


def nobody(bus: Bus, key: str) -> NobodyAnswers:
    """The error that nobody serves a key, with those who are there."""
    return NobodyAnswers(f"nobody answers on {key}: is the service running? {present(bus)}")
