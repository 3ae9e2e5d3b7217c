"""A table of processes from a TOML file: what ``zsight up`` starts on this host."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from zsight.errors import UsageError
from zsight.services import service
from zsight.settings import parse
from zsight_protocol.channels import require_name
from zsight_protocol.errors import KeyNameError

if TYPE_CHECKING:
    from pathlib import Path

__all__ = ["DEFAULT_TABLE", "CellFile", "ProcessEntry", "read"]


@dataclass(frozen=True)
class ProcessEntry:
    """One process: its name, its service, and the settings that differ from the service's own."""

    name: str
    service: str
    settings: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        try:
            require_name(self.name, "process")
        except KeyNameError as error:
            raise UsageError(str(error)) from None
        parse(service(self.service).settings(), self.settings)


@dataclass(frozen=True)
class CellFile:
    """The processes of this host, and where the cell is."""

    processes: tuple[ProcessEntry, ...]
    namespace: str | None = None
    connect: tuple[str, ...] | None = None
    listen: tuple[str, ...] | None = None


DEFAULT_TABLE = CellFile(
    tuple(ProcessEntry(name, name) for name in ("router", "camera", "voxel", "planes", "finder")),
)


def read(path: Path) -> CellFile:
    """The table in a file.

    The file has ``namespace``, ``connect`` and ``listen`` (one endpoint or a list; all may be left out), and a table
    ``[process.NAME]`` for each process, with ``service`` (left out: its name) and the service's settings.

    Raises:
        UsageError: the file is not readable, or names something unknown.
    """
    try:
        entries = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise UsageError(f"{path}: cannot be read ({error.strerror})") from None
    except (UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise UsageError(f"{path}: not TOML: {error}") from None
    unknown = set(entries) - {"namespace", "connect", "listen", "process"}
    if unknown:
        raise UsageError(
            f"{path}: {', '.join(sorted(unknown))} is unknown; expected namespace, connect, listen, process"
        )
    processes = entries.get("process", {})
    if not isinstance(processes, dict) or not processes:
        raise UsageError(f"{path}: no [process.NAME] table; expected one for each process")
    try:
        return CellFile(
            tuple(_entry(name, settings) for name, settings in processes.items()),
            _namespace(entries.get("namespace")),
            _endpoints("connect", entries.get("connect")),
            _endpoints("listen", entries.get("listen")),
        )
    except (UsageError, KeyNameError) as error:
        raise UsageError(f"{path}: {error}") from None


def _entry(name: str, settings: Any) -> ProcessEntry:
    if not isinstance(settings, dict):
        raise UsageError(f"process {name} is {settings!r}; expected a table of settings")
    wanted = settings.get("service", name)
    if not isinstance(wanted, str):
        raise UsageError(f"service of process {name} is {wanted!r}; expected a name")
    return ProcessEntry(name, wanted, {k: v for k, v in settings.items() if k != "service"})


def _namespace(value: Any) -> str | None:
    if value is not None and not isinstance(value, str):
        raise UsageError(f"namespace is {value!r}; expected a name")
    return None if value is None else require_name(value, "namespace")


def _endpoints(what: str, value: Any) -> tuple[str, ...] | None:
    if value is None:
        return None
    endpoints = [value] if isinstance(value, str) else value
    if not isinstance(endpoints, list) or not endpoints or not all(isinstance(part, str) for part in endpoints):
        raise UsageError(f"{what} is {value!r}; expected an endpoint such as 'tcp/192.0.2.7:7447', or a list of them")
    return tuple(endpoints)
