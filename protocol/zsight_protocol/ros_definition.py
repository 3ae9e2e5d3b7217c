"""Definitions of messages as ROS writes them (.msg): the fields of each type, in order."""

from __future__ import annotations

import re
from dataclasses import dataclass

from zsight_protocol.errors import DecodeError, shortened

__all__ = ["PRIMITIVES", "SEPARATOR", "STRINGS", "Definitions", "RosField", "parse_definition", "short_name"]

PRIMITIVES = {
    "bool": "?",
    "byte": "B",
    "char": "B",
    "int8": "b",
    "uint8": "B",
    "int16": "h",
    "uint16": "H",
    "int32": "i",
    "uint32": "I",
    "int64": "q",
    "uint64": "Q",
    "float32": "f",
    "float64": "d",
}
"""Numbers that ROS knows, each with its letter in the struct module."""

STRINGS = ("string", "wstring")

SEPARATOR = "=" * 80
"""Between the definitions of a message and of those that it is made of."""

_FIELD = re.compile(r"(?P<type>[\w/]+)(<=\d+)?(?P<many>\[(?P<bound><=)?(?P<length>\d*)\])?\s+(?P<name>[A-Za-z]\w*)")
_CONSTANT = re.compile(r"\S+\s+[A-Za-z]\w*\s*=")


@dataclass(frozen=True)
class RosField:
    """One field: its type (``package/Name`` for a message), and whether it is an array or a sequence of them."""

    name: str
    type: str
    length: int | None = None
    is_sequence: bool = False
    bound: int | None = None

    @property
    def text(self) -> str:
        """Its line of a definition."""
        bound = "" if self.bound is None else f"<={self.bound}"
        many = f"[{bound}]" if self.is_sequence else "" if self.length is None else f"[{self.length}]"
        return f"{self.type}{many} {self.name}"


Definitions = dict[str, tuple[RosField, ...]]
"""Fields by the name of their message, ``package/Name``."""


def parse_definition(name: str, text: str) -> Definitions:
    """The fields of a message and of all that it is made of.

    Args:
        name: of the message, ``package/Name`` or ``package/msg/Name``.
        text: its definition, then those of others, each behind a line of ``=`` and a line ``MSG: package/Name``.

    Raises:
        DecodeError: a line is not understood.
    """
    parts = re.split(r"^={80}\n", text, flags=re.MULTILINE)
    found = {short_name(name): _fields(parts[0], short_name(name))}
    for part in parts[1:]:
        head, _, body = part.partition("\n")
        if not head.startswith("MSG: "):
            raise DecodeError(f"a definition begins with {shortened(head)!r}; expected MSG: package/Name")
        inner = short_name(head.removeprefix("MSG: ").strip())
        found[inner] = _fields(body, inner)
    return found


def short_name(name: str) -> str:
    """``package/Name`` of ``package/msg/Name``."""
    return name.replace("/msg/", "/")


def _fields(text: str, name: str) -> tuple[RosField, ...]:
    lines = [line.partition("#")[0].strip() for line in text.splitlines()]
    return tuple(_field(line, name) for line in lines if line and not _CONSTANT.match(line))


def _field(line: str, name: str) -> RosField:
    match = _FIELD.match(line)
    if match is None:
        raise DecodeError(f"the definition of {name} has the line {shortened(line)!r}; expected a type and a name")
    kind = _full_type(match["type"], name.partition("/")[0])
    length = int(match["length"]) if match["length"] else None
    if match["many"] and (match["bound"] or length is None):
        return RosField(match["name"], kind, is_sequence=True, bound=length)
    return RosField(match["name"], kind, length)


def _full_type(written: str, package: str) -> str:
    if written in PRIMITIVES or written in STRINGS:
        return written
    if written == "Header":
        return "std_msgs/Header"
    return short_name(written) if "/" in written else f"{package}/{written}"
