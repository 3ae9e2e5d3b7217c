"""Every error that zsight_protocol raises.

ProtocolError
├── DecodeError     bytes that are not the message they should be
└── KeyNameError    a name that cannot be part of a key
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pydantic import ValidationError

__all__ = ["DecodeError", "KeyNameError", "ProtocolError"]


class ProtocolError(Exception):
    """Base of all errors of this package; the message says what was got, what was expected and what to do."""


class DecodeError(ProtocolError):
    """Bytes that are not the message they should be."""

    @classmethod
    def from_validation(cls, kind: str, error: ValidationError) -> DecodeError:
        """The first few complaints of pydantic in one line; never the payload itself."""
        complaints = error.errors(include_url=False, include_input=False, include_context=False)
        words = [f"{'.'.join(str(part) for part in c['loc']) or 'message'}: {c['msg']}" for c in complaints[:3]]
        more = f" (and {len(complaints) - 3} more)" if len(complaints) > 3 else ""
        return cls(f"not a {kind}: {'; '.join(words)}{more}")


class KeyNameError(ProtocolError):
    """A name that cannot be part of a key."""
