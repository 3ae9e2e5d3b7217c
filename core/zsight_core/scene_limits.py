"""What the scene stage takes for a thing on a surface."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any, Self

if TYPE_CHECKING:
    from collections.abc import Mapping

__all__ = ["SceneLimits"]


@dataclass(frozen=True)
class SceneLimits:
    """Limits of things; what is given if nothing is said suits a table at 0.5 to 2 m before a depth camera."""

    lowest: float = 0.003
    """Metres above a surface from which a pixel is of a thing, besides three standard deviations of its depth."""
    highest: float = 0.6
    """Metres above a surface up to which things are looked at."""
    margin: float = 0.015
    """Metres beyond a surface's outline that things may hang over."""
    smallest: int = 60
    """Pixels of a 640 x 480 image; smaller things are noise."""
    largest: float = 0.7
    """Metres; a longer thing is a wall or furniture."""

    @classmethod
    def of(cls, values: Mapping[str, Any]) -> Self:
        """The limits among many values by name; others are passed over."""
        return cls(**{field.name: values[field.name] for field in fields(cls) if field.name in values})
