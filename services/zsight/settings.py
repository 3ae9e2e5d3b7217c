"""The base of every service's settings, and how they are read from text."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError

from zsight.errors import UsageError

if TYPE_CHECKING:
    from collections.abc import Mapping

__all__ = ["Settings", "describe", "parse"]


class Settings(BaseModel):
    """Settings of a service: read-only, each with its unit and range in its description."""

    model_config = ConfigDict(frozen=True, extra="forbid")


S = TypeVar("S", bound=Settings)


def parse(kind: type[S], values: Mapping[str, Any]) -> S:
    """Settings from names and values, which may be text.

    Raises:
        UsageError: a name is unknown or a value is out of range; says which are known.
    """
    try:
        return kind.model_validate({name.replace("-", "_"): value for name, value in values.items()})
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        name = ".".join(str(part) for part in first["loc"])
        if first["type"] == "extra_forbidden":
            raise UsageError(f"no setting is called {name}; known are {', '.join(kind.model_fields)}") from None
        raise UsageError(f"setting {name} is {first['input']!r}: {first['msg']}") from None


def describe(kind: type[Settings]) -> list[tuple[str, str, str]]:
    """Name, default ("-" for none) and description of each setting."""
    return [
        (name.replace("_", "-"), _text(field.default), field.description or "")
        for name, field in kind.model_fields.items()
    ]


def _text(default: Any) -> str:
    """A default as it would be typed."""
    if default is None or default == "":
        return "-"
    return str(default).lower() if isinstance(default, bool) else str(default)
