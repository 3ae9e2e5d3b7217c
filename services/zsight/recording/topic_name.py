"""Keys as ROS topics and back, without loss.

ROS allows letters, digits and single underscores, and no digit at the beginning of a part; our keys are lower case. So
a capital stands for what ROS does not allow: ``A`` for '@', ``D`` for '-', ``P`` for '.', ``U`` for a further
underscore, ``N`` before a digit at the beginning, and ``X2aX`` for the character with that number in hexadecimal.
"""

from __future__ import annotations

import re

__all__ = ["key_of", "topic_of"]

_WORDS = {"@": "A", "-": "D", ".": "P"}
_CHARACTERS = {"A": "@", "D": "-", "P": ".", "U": "_", "N": ""}
_TOKEN = re.compile(r"X([0-9a-f]+)X|([ADPUN])|(.)", re.DOTALL)


def topic_of(key: str) -> str:
    """The topic of a key: ``/zsight/kinect/points`` of ``zsight/kinect/points``."""
    return "".join(f"/{_chunk(chunk)}" for chunk in key.split("/"))


def _chunk(chunk: str) -> str:
    written = "".join(_character(c, chunk[i - 1] if i else "") for i, c in enumerate(chunk))
    return f"N{written}" if written[:1].isdigit() else written


def _character(character: str, before: str) -> str:
    if character == "_" and before == "_":
        return "U"
    if character in _WORDS:
        return _WORDS[character]
    legal = character == "_" or (character.isascii() and (character.islower() or character.isdigit()))
    return character if legal else f"X{ord(character):x}X"


def key_of(topic: str) -> str:
    """The key of a topic; of one that was not made here, its name without the first slash."""
    return _TOKEN.sub(_original, topic.removeprefix("/"))


def _original(match: re.Match[str]) -> str:
    number, word, plain = match.groups()
    if number:
        return chr(int(number, 16)) if int(number, 16) < 0x110000 else match[0]
    return _CHARACTERS[word] if word else str(plain)
