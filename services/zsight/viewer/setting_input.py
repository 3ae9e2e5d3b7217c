"""An input that suits a setting."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable

    import viser

    from zsight_protocol.parameter import Parameter

__all__ = ["add_input", "slider_range"]


def add_input(gui: viser.GuiApi, parameter: Parameter, changed: Callable[[Parameter, Any], None]) -> None:
    """Add an input for a setting; what is fixed while the process runs is shown and cannot be changed.

    Args:
        gui: of the page.
        parameter: the setting.
        changed: told the value as soon as somebody changes it.
    """
    label = parameter.name.replace("_", " ")
    fixed: dict[str, Any] = {"hint": parameter.description, "disabled": not parameter.live}
    handle: Any
    if parameter.choices:
        handle = gui.add_dropdown(
            label, tuple(map(str, parameter.choices)), initial_value=str(parameter.value), **fixed
        )
    elif parameter.kind == "bool":
        handle = gui.add_checkbox(label, bool(parameter.value), **fixed)
    elif parameter.kind in ("int", "float") and isinstance(parameter.value, int | float):
        low, high, step = slider_range(parameter)
        handle = gui.add_slider(label, low, high, step, parameter.value, **fixed)
    else:
        handle = gui.add_text(label, "" if parameter.value is None else str(parameter.value), **fixed)
    handle.on_update(lambda _: changed(parameter, _typed(parameter, handle.value)))


def _typed(parameter: Parameter, value: Any) -> Any:
    """What was typed as the kind of setting that it is; nothing typed is no value."""
    if not isinstance(value, str) or parameter.kind == "str":
        return value
    if not value:
        return None
    try:
        return float(value) if parameter.kind == "float" else int(value) if parameter.kind == "int" else value
    except ValueError:
        return value  # the process says what it expected


def slider_range(parameter: Parameter) -> tuple[float, float, float]:
    """Least, greatest and step of a slider: within the legal range, a tenth to twenty times the present value.

    A length may legally be anything up to 10 m; a slider over all of that could not be set to a millimetre.
    """
    numbers = [float(v) for v in (parameter.value, parameter.default) if isinstance(v, int | float)]
    size = max(map(abs, numbers)) or 1.0
    is_bounded = parameter.minimum is not None and not parameter.minimum_excluded
    low = parameter.minimum if is_bounded and parameter.minimum is not None else size / 10
    high = 20 * size if parameter.maximum is None else min(20 * size, parameter.maximum)
    if parameter.kind == "int":
        return int(low), max(int(high), int(low) + 1), 1
    return min(low, *numbers), max(high, *numbers), 10.0 ** math.floor(math.log10(size / 10))
