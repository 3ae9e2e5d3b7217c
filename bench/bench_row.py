"""One figure of a measurement, as ``zsight bench --json`` prints it."""

from __future__ import annotations

from typing import Any

__all__ = ["print_rows", "row"]


def row(
    name: str,
    value: float,
    unit: str = "ms",
    target: float | None = None,
    *,
    least: bool = False,
    peer: str | None = None,
    peer_value: float | None = None,
    **more: Any,
) -> dict[str, Any]:
    """A figure beside its target, and beside a peer's where there is one.

    Args:
        name: what was measured.
        value: the figure.
        unit: of the figure.
        target: what it must not be above.
        least: it must not be below the target instead.
        peer: who did the same.
        peer_value: their figure.
        more: what else is told of it.
    """
    holds = None if target is None else value >= target if least else value <= target
    ratio = None if peer_value is None else value / peer_value
    return {
        "name": name,
        "value": round(float(value), 4),
        "unit": unit,
        "peer": peer,
        "peer_value": None if peer_value is None else round(float(peer_value), 4),
        "ratio": None if ratio is None else round(ratio, 4),
        "target": target,
        "holds": holds,
        **more,
    }


def print_rows(rows: list[dict[str, Any]]) -> None:
    """The rows for people: name, figure, target and whether it holds."""
    for one in rows:
        figure = f"{one['name']:66} {one['value']:10} {one['unit']:16}"
        print(f"{figure} target {one['target']} {one['holds']}" if one["target"] is not None else figure)
