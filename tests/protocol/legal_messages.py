"""Hypothesis strategies for every legal message, drawn from the models themselves."""

from __future__ import annotations

import importlib
import math
import pkgutil
import types
from enum import Enum
from typing import TYPE_CHECKING, Annotated, Any, Union, get_args, get_origin

import annotated_types
from hypothesis import strategies as st
from pydantic import JsonValue, StringConstraints
from pydantic.fields import FieldInfo

import zsight_protocol
from zsight_protocol.geometry import Quaternion, Region
from zsight_protocol.message import Header, Message
from zsight_protocol.object_type import ShapeOf
from zsight_protocol.point_cloud import Datatype, PointCloud2, PointField

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["MODULES", "all_kinds", "clouds", "messages"]

MODULES = sorted(module.name for module in pkgutil.iter_modules(zsight_protocol.__path__, "zsight_protocol."))

JSON: st.SearchStrategy[Any] = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**63), 2**64 - 1) | st.floats(allow_nan=False) | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=8), inner, max_size=3),
    max_leaves=8,
)


def all_kinds() -> list[type[Message]]:
    """Every kind of message in the package that can be sent."""
    for module in MODULES:
        importlib.import_module(module)
    waiting, found = [Message], []
    while waiting:
        for kind in waiting.pop().__subclasses__():
            waiting.append(kind)
            is_template = bool(kind.__pydantic_generic_metadata__["parameters"])
            if kind.__module__.startswith("zsight_protocol.") and not is_template:
                found.append(kind)
    return sorted(found, key=lambda kind: kind.__name__)


def messages(kind: type[Message]) -> st.SearchStrategy[Any]:
    """Legal messages of one kind."""
    if kind in LAWS:
        return LAWS[kind]()
    return st.builds(kind, **{n: values(f.annotation, f.metadata) for n, f in kind.model_fields.items()})


def values(annotation: Any, marks: list[Any]) -> st.SearchStrategy[Any]:
    """Legal values of one field."""
    origin, arguments = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        inner = [m for mark in arguments[1:] for m in (mark.metadata if isinstance(mark, FieldInfo) else [mark])]
        return values(arguments[0], [*inner, *marks])
    if annotation is JsonValue:
        return JSON
    if origin in (Union, types.UnionType):
        return st.one_of(*(values(argument, marks) for argument in arguments))
    if origin is tuple:
        return _tuples(arguments, marks)
    if origin is dict:
        return st.dictionaries(st.text(max_size=8), values(arguments[1], []), max_size=3)
    return _scalars(annotation, marks)


def _tuples(arguments: tuple[Any, ...], marks: list[Any]) -> st.SearchStrategy[Any]:
    if arguments[-1] is not Ellipsis:
        return st.tuples(*(values(argument, []) for argument in arguments))
    low = _mark(marks, annotated_types.MinLen, "min_length", 0)
    high = _mark(marks, annotated_types.MaxLen, "max_length", low + 2)
    return st.lists(values(arguments[0], []), min_size=low, max_size=min(high, low + 2)).map(tuple)


def _scalars(annotation: Any, marks: list[Any]) -> st.SearchStrategy[Any]:
    if annotation is type(None):
        return st.none()
    if annotation is bool:
        return st.booleans()
    if annotation is int:
        return st.integers(*_bounds(marks, 1))
    if annotation is float:
        low, high = _bounds(marks, None)
        open_end = any(isinstance(mark, annotated_types.Gt) for mark in marks)
        return st.floats(low, high, exclude_min=open_end, allow_nan=False, allow_infinity=False)
    if annotation is str:
        return _texts(marks)
    if annotation is bytes:
        return st.binary(max_size=16)
    if issubclass(annotation, Enum):
        return st.sampled_from(list(annotation))
    if issubclass(annotation, Message):
        return messages(annotation)
    raise NotImplementedError(f"no strategy for {annotation}: add one here")


def _bounds(marks: list[Any], step: int | None) -> tuple[Any, Any]:
    """Smallest and greatest value; a whole number steps off an open bound, a float leaves that to its strategy."""
    low = _mark(marks, annotated_types.Ge, "ge", None)
    above = _mark(marks, annotated_types.Gt, "gt", None)
    high = _mark(marks, annotated_types.Le, "le", None)
    below = _mark(marks, annotated_types.Lt, "lt", None)
    if step is None:
        return low if low is not None else above, high if high is not None else below
    return low if low is not None else above + step, high if high is not None else below - step


def _texts(marks: list[Any]) -> st.SearchStrategy[str]:
    for mark in marks:
        if isinstance(mark, StringConstraints) and mark.pattern:
            return st.from_regex(str(mark.pattern).removesuffix("$") + r"\Z", alphabet=st.characters(codec="utf-8"))
    low = _mark(marks, annotated_types.MinLen, "min_length", 0)
    return st.text(min_size=low, max_size=low + 12)


def _mark(marks: list[Any], kind: type[Any], name: str, otherwise: Any) -> Any:
    return next((getattr(mark, name) for mark in marks if isinstance(mark, kind)), otherwise)


@st.composite
def quaternions(draw: st.DrawFn) -> Quaternion:
    """Unit quaternions."""
    parts = draw(st.tuples(*[st.floats(-1, 1)] * 4).filter(lambda q: math.hypot(*q) > 1e-3))
    length = math.hypot(*parts)
    return Quaternion(**{axis: part / length for axis, part in zip("xyzw", parts, strict=True)})


@st.composite
def regions(draw: st.DrawFn) -> Region:
    """Boxes with a volume."""
    edges = st.lists(st.floats(-1e6, 1e6), min_size=2, max_size=2, unique=True).map(sorted)
    low, high = zip(*(draw(edges) for _ in range(3)), strict=True)
    return Region(low=low, high=high)


@st.composite
def shapes(draw: st.DrawFn) -> ShapeOf:
    """One shape of those that there are."""
    name = draw(st.sampled_from(sorted(ShapeOf.model_fields)))
    kind = next(a for a in get_args(ShapeOf.model_fields[name].annotation) if a is not type(None))
    return ShapeOf(**{name: draw(messages(kind))})


@st.composite
def clouds(draw: st.DrawFn) -> PointCloud2:
    """Clouds with any fields, gaps between them, any size, any bytes (NaN payloads too) in any kind of buffer."""
    names = draw(st.lists(st.text(min_size=1, max_size=8), min_size=1, max_size=5, unique=True))
    fields: list[PointField] = []
    end = 0
    for name in names:
        offset = end + draw(st.integers(0, 5))
        datatype, count = draw(st.sampled_from(list(Datatype))), draw(st.integers(1, 3))
        fields.append(PointField(name=name, offset=offset, datatype=datatype, count=count))
        end = fields[-1].end
    point_step = end + draw(st.integers(0, 5))
    height, width = draw(st.integers(1, 4)), draw(st.integers(1, 4))
    size = height * width * point_step
    buffer = draw(st.sampled_from([bytes, bytearray, memoryview]))
    return PointCloud2(
        header=draw(messages(Header)),
        height=height,
        width=width,
        fields=tuple(draw(st.permutations(fields))),
        is_bigendian=False,
        point_step=point_step,
        row_step=width * point_step,
        is_dense=draw(st.booleans()),
        data=buffer(draw(st.binary(min_size=size, max_size=size))),
    )


# Kinds whose fields hang together.
LAWS: dict[type[Message], Callable[[], st.SearchStrategy[Any]]] = {
    Quaternion: quaternions,
    Region: regions,
    ShapeOf: shapes,
    PointCloud2: clouds,
}
