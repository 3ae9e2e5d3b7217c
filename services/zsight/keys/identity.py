"""Who a host is on a network with keys: the folder that ``zsight keys`` made for it."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from zsight.errors import UsageError
from zsight_core.files.atomic_file import atomic_file

__all__ = ["Identity", "Roster", "read_hosts", "read_identity", "write_hosts"]

CA, CERTIFICATE, KEY, IDENTITY = "ca.pem", "certificate.pem", "key.pem", "identity.json"
TRUSTED, HOSTS = "trusted.pem", "hosts.json"
"""Files of a folder; the last two are the router's: whose certificates it takes, and what each may do."""


@dataclass(frozen=True)
class Identity:
    """A host by its certificate's name, what it may do, and in which cells."""

    host: str
    roles: tuple[str, ...]
    cells: tuple[str, ...]


class Roster:
    """Whether a router's list of hosts is still the one that it was opened with."""

    def __init__(self, folder: str) -> None:
        """Args: folder of the router's keys."""
        self._files = [Path(folder) / name for name in (TRUSTED, HOSTS)]
        self._seen = self._state()
        self.changed = False

    def has_changed(self) -> bool:
        """Whether it has changed since."""
        self.changed = self._state() != self._seen
        return self.changed

    def _state(self) -> list[tuple[int, int] | None]:
        return [(file.stat().st_mtime_ns, file.stat().st_ino) if file.exists() else None for file in self._files]


def read_identity(folder: Path) -> Identity:
    """Whose folder it is.

    Raises:
        UsageError: it is no folder of keys.
    """
    missing = [name for name in (CA, CERTIFICATE, KEY, IDENTITY) if not (folder / name).is_file()]
    if missing:
        raise UsageError(
            f"keys are to be in {folder}, which has no {', '.join(missing)}: make them with: zsight keys add"
        )
    return _identity(_read(folder / IDENTITY))


def read_hosts(folder: Path) -> list[Identity]:
    """All hosts that a router knows.

    Raises:
        UsageError: the folder is not a router's.
    """
    return [_identity(entry) for entry in _read(folder / HOSTS)]


def write_hosts(path: Path, hosts: list[Identity]) -> None:
    """Write the list of hosts whole or not at all."""
    with atomic_file(path, overwrite=True) as file:
        file.write(json.dumps([asdict(host) for host in hosts], indent=1).encode() + b"\n")


def _read(path: Path) -> Any:
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise UsageError(f"{path} cannot be read ({error}): make it anew with: zsight keys") from None


def _identity(entry: Any) -> Identity:
    try:
        return Identity(str(entry["host"]), tuple(entry["roles"]), tuple(entry["cells"]))
    except (TypeError, KeyError) as error:
        raise UsageError(f"no host is described by {entry!r}: {error}") from None
