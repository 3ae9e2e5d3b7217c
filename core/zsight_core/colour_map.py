"""Colours for numbers: a gradient whose lightness only rises, so that it is read without telling red from green."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["graded", "spread"]

_STOPS = np.array([[68, 1, 84], [59, 82, 139], [33, 145, 140], [94, 201, 98], [253, 231, 37]], dtype=np.float64)
_TABLE = np.stack([np.interp(np.linspace(0, 4, 256), np.arange(5.0), _STOPS[:, c]) for c in range(3)], axis=-1).astype(
    np.uint8
)


def graded(values: NDArray[np.floating], low: float, high: float) -> NDArray[np.uint8]:
    """Colours (..., 3) of values (...): dark at low and below, light at high and above; dark where NaN.

    Method: five stops of viridis (Smith and van der Walt 2015), linear between.
    """
    share = np.nan_to_num(np.clip((values - low) / max(high - low, 1e-9), 0, 1))
    return np.asarray(_TABLE[(share * 255).astype(np.uint8)])


def spread(values: NDArray[np.floating]) -> tuple[float, float]:
    """What most values lie between: the 2nd and the 98th percentile of those that are finite; 0 and 1 of none."""
    finite = values[np.isfinite(values)]
    if not finite.size:
        return 0.0, 1.0
    low, high = np.percentile(finite, [2, 98])
    return float(low), float(high)
