"""Every error that zsight raises at its users, with the exit code of each on the command line.

ZsightError                 1
├── UsageError              2   a request that makes no sense: unknown name, bad option, unreadable setting
├── ConnectionLost          3   no router, no network, a session that was closed
├── NobodyAnswers           3   the network is there and nobody serves the request
├── ServerLost              3   the server died or was cut off while it worked on the request
├── RequestRefused          2   the server says no: unknown type, bad frame, empty region
├── NotAllowed              2   this host's keys do not allow it
├── ServerBusy              3   the server has no room for another goal now
├── DeadlinePassed          4   no answer within the time allowed
└── GoalCancelled           5   the goal was cancelled
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from zsight_protocol.find_object import FindObjectResult

__all__ = [
    "ConnectionLost",
    "DeadlinePassed",
    "GoalCancelled",
    "NobodyAnswers",
    "NotAllowed",
    "RequestRefused",
    "ServerBusy",
    "ServerLost",
    "UsageError",
    "ZsightError",
]


class ZsightError(Exception):
    """Base of all errors of this package; the message says what was got, what was expected and what to do."""

    exit_code = 1


class UsageError(ZsightError):
    """A request that makes no sense."""

    exit_code = 2


class ConnectionLost(ZsightError):
    """No router, no network, or a session that was closed."""

    exit_code = 3


class NobodyAnswers(ZsightError):
    """The network is there and nobody serves the request."""

    exit_code = 3


class ServerLost(ZsightError):
    """The server died or was cut off while it worked on the request."""

    exit_code = 3


class RequestRefused(ZsightError):
    """The server says no."""

    exit_code = 2


class NotAllowed(ZsightError):
    """This host's keys do not allow it."""

    exit_code = 2


class ServerBusy(ZsightError):
    """The server has no room for another goal now."""

    exit_code = 3


class DeadlinePassed(ZsightError):
    """No answer within the time allowed; ``known`` is what the finder knew by then, where it could still say so."""

    exit_code = 4

    def __init__(self, message: str, known: FindObjectResult | None = None) -> None:
        """Args: what happened; the result that a finder gave in time, marked as deadline."""
        super().__init__(message)
        self.known = known


class GoalCancelled(ZsightError):
    """The goal was cancelled."""

    exit_code = 5
