"""Every error that zsight_core raises.

CoreError
├── PointsError      an array that is not a usable cloud (no x, y, z; wrong shape or dtype)
├── FileError        a file that cannot be read or written (also says which)
├── GeometryError    the points do not determine what was asked (fewer than 3, all on a line, no plane)
├── ModelError       an object model that makes no sense (size <= 0, mesh with no faces)
└── Cancelled        the caller asked a long computation to stop
"""

from __future__ import annotations

__all__ = ["Cancelled", "CoreError", "FileError", "GeometryError", "ModelError", "PointsError"]


class CoreError(Exception):
    """Base of all errors of this package; the message says what was got, what was expected and what to do."""


class PointsError(CoreError):
    """An array that is not a usable cloud."""


class FileError(CoreError):
    """A file that cannot be read or written."""

    def __init__(self, path: object, problem: str) -> None:
        """Args: path of the file; problem: what was got, what was expected, what to do."""
        super().__init__(f"{path}: {problem}")
        self.path = str(path)
        self.problem = problem


class GeometryError(CoreError):
    """The points do not determine what was asked."""


class ModelError(CoreError):
    """An object model that makes no sense."""


class Cancelled(CoreError):
    """The caller asked a long computation to stop."""
