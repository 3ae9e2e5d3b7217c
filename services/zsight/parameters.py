"""The settings of a process at run time: listed, read, set and saved, all from the declaration of its options."""

from __future__ import annotations

import json
import logging
import os
import threading
import types
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeVar, Union, get_args, get_origin

import annotated_types
from pydantic import ValidationError
from pydantic_core import to_jsonable_python

from zsight.errors import UsageError
from zsight.settings import Settings, is_live, mistake, parse, variable
from zsight_core.errors import CoreError
from zsight_core.files.atomic_file import atomic_file
from zsight_protocol.channels import require_name
from zsight_protocol.codec import decode, encode
from zsight_protocol.errors import ProtocolError
from zsight_protocol.parameter import Parameter, ParameterAnswer, ParameterRequest

if TYPE_CHECKING:
    from collections.abc import Mapping

    from zsight.bus import Bus, RawRequest
    from zsight.bus.link import Closable

__all__ = ["Parameters", "Saved", "limits", "load", "serve_parameters"]

log = logging.getLogger(__name__)

_SCALARS = {bool: "bool", int: "int", float: "float", str: "str"}

S = TypeVar("S", bound=Settings)


class Saved:
    """What was saved of the settings of one process: a JSON file that is there once something was."""

    def __init__(self, namespace: str, process: str) -> None:
        """Args: namespace of the cell; name of the process."""
        home = os.environ.get("XDG_CONFIG_HOME") or "~/.config"
        file = f"{require_name(process, 'process')}.json"
        self.path = Path(home).expanduser() / "zsight" / "saved" / require_name(namespace, "namespace") / file

    def read(self) -> dict[str, Any]:
        """Names and values.

        Raises:
            UsageError: the file is damaged.
        """
        try:
            values = json.loads(self.path.read_text(encoding="utf-8"))
        except FileNotFoundError:
            return {}
        except (OSError, ValueError) as error:
            raise UsageError(f"saved settings {self.path} cannot be read ({error}): repair or remove them") from None
        if not isinstance(values, dict):
            raise UsageError(f"saved settings {self.path} are no JSON object: repair or remove them")
        return values

    def keep(self, name: str, value: Any) -> None:
        """Save one value beside the others.

        Raises:
            FileError: the system refuses to write.
        """
        values = {**self.read(), name: value}
        self.path.parent.mkdir(parents=True, exist_ok=True)
        with atomic_file(self.path, overwrite=True) as file:
            file.write(json.dumps(values, indent=2).encode() + b"\n")


def load(kind: type[S], process: str, namespace: str, options: Mapping[str, Any]) -> S:
    """Settings of a process: options before what was saved, that before the environment, that before the defaults.

    Raises:
        UsageError: a name is unknown or a value is out of range.
    """
    named = {name: variable(process, name) for name in kind.model_fields}
    given = {name: os.environ[key] for name, key in named.items() if os.environ.get(key)}
    saved = Saved(namespace, process)
    kept = saved.read()
    if kept:
        log.info("%s as saved in %s", ", ".join(f"{name} {value}" for name, value in kept.items()), saved.path)
    chosen = {name.replace("-", "_"): value for name, value in options.items()}
    return parse(kind, {**given, **kept, **chosen})


class Parameters:
    """The settings of a running process; the live ones change in place, where the service reads them."""

    def __init__(self, settings: Settings, saved: Saved) -> None:
        """Args: settings that the service was started with; where changes are kept on request."""
        self._settings = settings
        self._saved = saved
        self._lock = threading.Lock()

    def list(self) -> tuple[Parameter, ...]:
        """All, in the order of their declaration."""
        return tuple(self.get(name) for name in type(self._settings).model_fields)

    def get(self, name: str) -> Parameter:
        """One of them as it is now.

        Raises:
            UsageError: there is none of this name.
        """
        kind = type(self._settings)
        field = kind.model_fields.get(name)
        if field is None:
            raise UsageError(f"no setting is called {name}; known are {', '.join(kind.model_fields) or 'none'}")
        return Parameter(
            name=name,
            kind=_kind(field.annotation),
            value=self._now()[name],
            default=to_jsonable_python(field.get_default(call_default_factory=True)),
            choices=_choices(field.annotation),
            live=is_live(kind, name),
            saved=name in self._saved.read(),
            description=field.description or "",
            **limits(field.metadata),
        )

    def set(self, name: str, value: Any, *, save: bool) -> str:
        """Change one, and keep it over a restart where asked; what became of it, in words.

        Raises:
            UsageError: there is none of this name, the value is out of range, or it is fixed while the process runs.
            FileError: it cannot be saved.
        """
        with self._lock:
            before = self.get(name)
            checked = self._checked(name, value)
            if not before.live and not save:
                raise UsageError(f"{name} is read at the start alone: save it, then restart the process")
            if save:
                self._saved.keep(name, to_jsonable_python(checked))
            if before.live:
                setattr(self._settings, name, checked)
        kept = ", saved" if save else ""
        return (
            f"{name} is {self.get(name).value}{kept}" if before.live else f"{name} is {checked} from the next start on"
        )

    def _checked(self, name: str, value: Any) -> Any:
        """The value as the service will see it."""
        kind = type(self._settings)
        try:
            return getattr(kind.model_validate({**self._now(), name: value}), name)
        except ValidationError as error:
            raise UsageError(mistake(kind, error)) from None

    def _now(self) -> dict[str, Any]:
        return self._settings.model_dump(mode="json")


def limits(marks: list[Any]) -> dict[str, Any]:
    """The range of a number, from the marks of its field."""
    found: dict[str, Any] = {}
    for mark in marks:
        if isinstance(mark, annotated_types.Ge | annotated_types.Gt):
            excluded = isinstance(mark, annotated_types.Gt)
            found |= {"minimum": float(mark.gt if excluded else mark.ge), "minimum_excluded": excluded}  # type: ignore[union-attr,arg-type]
        elif isinstance(mark, annotated_types.Le | annotated_types.Lt):
            excluded = isinstance(mark, annotated_types.Lt)
            found |= {"maximum": float(mark.lt if excluded else mark.le), "maximum_excluded": excluded}  # type: ignore[union-attr,arg-type]
    return found


def _kind(annotation: Any) -> str:
    """The kind of a setting's values; what may be absent has the kind of what is there."""
    kinds = {_SCALARS.get(part, "json") for part in _parts(annotation)}
    return kinds.pop() if len(kinds) == 1 else "json"


def _choices(annotation: Any) -> tuple[Any, ...]:
    """All values, where the type names them."""
    if get_origin(annotation) is Literal:
        return get_args(annotation)
    return tuple(member.value for member in annotation) if _is_enumeration(annotation) else ()


def _parts(annotation: Any) -> list[Any]:
    """The types of the values, without None."""
    choices = _choices(annotation)
    if choices:
        return [type(choice) for choice in choices]
    if get_origin(annotation) in (Union, types.UnionType):
        return [part for part in get_args(annotation) if part is not type(None)]
    return [annotation]


def _is_enumeration(annotation: Any) -> bool:
    return isinstance(annotation, type) and issubclass(annotation, Enum)


def serve_parameters(bus: Bus, host: str, process: str, service: str, parameters: Parameters) -> Closable:
    """Answer who asks for the settings of this process, and change them."""

    def asked(request: RawRequest) -> None:
        asks = None
        try:
            asks = decode(ParameterRequest, request.payload)
            found, message = _answer(asks, parameters)
        except (ProtocolError, UsageError, CoreError, OSError) as error:
            if asks is None or asks.action == "set":
                log.warning("refused a change of settings: %s", error)
            else:  # a name mistyped by whoever looks is no trouble of this process
                log.info("told nothing of its settings: %s", error)
            request.refuse(str(error))
            return
        answer = ParameterAnswer(host=host, process=process, service=service, parameters=found, message=message)
        request.reply(encode(answer))
        request.close()

    return bus.serve(bus.cell.parameters(host, process), asked)


def _answer(request: ParameterRequest, parameters: Parameters) -> tuple[tuple[Parameter, ...], str]:
    if request.action == "list":
        return parameters.list(), ""
    name = request.name.replace("-", "_")
    if request.action == "get":
        return (parameters.get(name),), ""
    message = parameters.set(name, request.value, save=request.save)
    log.info("%s, set over the network", message)
    return (parameters.get(name),), message
