"""A question that its server answers at once."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeVar

from zsight.errors import DeadlinePassed
from zsight_protocol.codec import decode, encode
from zsight_protocol.message import Message

if TYPE_CHECKING:
    from zsight.bus import Bus

__all__ = ["ask_question"]

_TIMEOUT = 2.0  # seconds

M = TypeVar("M", bound=Message)


def ask_question(bus: Bus, key: str, request: Message, kind: type[M], *, everyone: bool) -> list[M]:
    """Every answer to a question.

    Raises:
        DeadlinePassed: no answer, or not all of them, in time.
        RequestRefused: a server refused it.
    """
    replies = bus.ask(key, encode(request), _TIMEOUT, everyone=everyone)
    answers: list[M] = []
    try:
        while (payload := replies.take(_TIMEOUT)) is not None:
            answers.append(decode(kind, payload))
    except TimeoutError:
        replies.close()
        raise DeadlinePassed(f"no answer on {key} within {_TIMEOUT:g} s") from None
    return answers
