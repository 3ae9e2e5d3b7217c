"""Every error that zsight_protocol raises.

ProtocolError
├── EncodeError     a message that no bytes can carry
├── DecodeError     bytes that are not the message they should be
└── KeyNameError    a name that cannot be part of a key
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pydantic import ValidationError

__all__ = ["DecodeError", "EncodeError", "KeyNameError", "ProtocolError", "shortened"]


class ProtocolError(Exception):
    """Base of all errors of this package; the message says what was got, what was expected and what to do."""


class EncodeError(ProtocolError):
    """A message that no bytes can carry."""


class DecodeError(ProtocolError):
    """Bytes that are not the message they should be."""

    @classmethod
    def from_validation(cls, kind: str, error: ValidationError) -> DecodeError:
        """The first few complaints of pydantic in one line; never the payload itself."""
        complaints = error.errors(include_url=False, include_input=False, include_context=False)
        words = [
            f"{_place(c['loc'])}: {shortened(c['msg'].removeprefix('Value error, '), 400)}" for c in complaints[:3]
        ]
        more = f" (and {len(complaints) - 3} more)" if len(complaints) > 3 else ""
        return cls(f"not a {kind}: {'; '.join(words)}{more}")


class KeyNameError(ProtocolError):
    """A name that cannot be part of a key."""


def shortened(text: str, length: int = 80) -> str:
    """Text from the network, cut so that no message or log grows with what a stranger sends."""
    return text if len(text) <= length else f"{text[:length]}... ({len(text)} characters)"


def _place(location: tuple[int | str, ...]) -> str:
    return shortened(".".join(str(part) for part in location)) or "message"
