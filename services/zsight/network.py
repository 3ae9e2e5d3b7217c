"""How a process joins the network: endpoints, namespace, keys, shared memory."""

from __future__ import annotations

import ipaddress
import os
import tomllib
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from zsight.errors import UsageError
from zsight_protocol.channels import DEFAULT_NAMESPACE

__all__ = ["CONFIG_FILE", "DEFAULT_ENDPOINT", "Network", "endpoints_given", "endpoints_of"]

DEFAULT_ENDPOINT = "tcp/127.0.0.1:7447"
_DEFAULT_SECURE = "tls/127.0.0.1:7447"

CONFIG_FILE = "zsight.toml"
"""File of a host's network settings: here, else in the user's configuration folder; ZSIGHT_CONFIG names another."""

_FILE_ENTRIES = ("connect", "listen", "namespace", "keys", "multicast", "open")


@dataclass(frozen=True)
class Network:
    """Where the router is and which cell is meant.

    ``connect`` are the router's endpoints for everybody else, ``listen`` the endpoints of the router itself, ``peers``
    routers of other sites that it joins. ``keys`` is the folder of this host's keys; without keys a router that listens
    beyond its own host must be ``open`` on purpose. ``config_file`` is a Zenoh configuration file to start from.
    """

    connect: tuple[str, ...] = (DEFAULT_ENDPOINT,)
    listen: tuple[str, ...] = (DEFAULT_ENDPOINT,)
    peers: tuple[str, ...] = ()
    namespace: str = DEFAULT_NAMESPACE
    multicast: bool = False
    shared_memory: bool = True
    config_file: str = ""
    keys: str = ""
    open: bool = False

    @classmethod
    def from_environment(cls) -> Network:
        """From the environment, else from ``zsight.toml``, else this host alone.

        The variables are ZSIGHT_CONNECT and ZSIGHT_LISTEN (comma between endpoints), ZSIGHT_NAMESPACE, ZSIGHT_KEYS,
        ZSIGHT_OPEN, ZSIGHT_MULTICAST and ZENOH_CONFIG.

        Raises:
            UsageError: the file makes no sense.
        """
        file = _read_file()
        keys = os.environ.get("ZSIGHT_KEYS") or file.get("keys", "")
        default = (_DEFAULT_SECURE if keys else DEFAULT_ENDPOINT,)
        return cls(
            connect=endpoints_of(os.environ.get("ZSIGHT_CONNECT", "")) or file.get("connect") or default,
            listen=endpoints_of(os.environ.get("ZSIGHT_LISTEN", "")) or file.get("listen") or default,
            namespace=os.environ.get("ZSIGHT_NAMESPACE") or file.get("namespace", DEFAULT_NAMESPACE),
            config_file=os.environ.get("ZENOH_CONFIG", ""),
            keys=keys,
            open=_truth(os.environ.get("ZSIGHT_OPEN", "")) or file.get("open", False),
            multicast=_truth(os.environ.get("ZSIGHT_MULTICAST", "")) or file.get("multicast", False),
        )

    def environment(self) -> dict[str, str]:
        """The same as environment variables, for processes to be started."""
        return {
            "ZSIGHT_CONNECT": ",".join(self.connect),
            "ZSIGHT_LISTEN": ",".join(self.listen),
            "ZSIGHT_NAMESPACE": self.namespace,
            **({"ZENOH_CONFIG": self.config_file} if self.config_file else {}),
            **({"ZSIGHT_KEYS": self.keys} if self.keys else {}),
            **({"ZSIGHT_OPEN": "1"} if self.open else {}),
            **({"ZSIGHT_MULTICAST": "1"} if self.multicast else {}),
        }

    def on(self, endpoint: str) -> Network:
        """The same network around one endpoint, for the router and for everybody else."""
        return replace(self, connect=(endpoint,), listen=(endpoint,))

    def require_guarded(self) -> None:
        """That a router which others reach asks for keys, or is open on purpose.

        Raises:
            UsageError: it is neither.
        """
        wide = [endpoint for endpoint in self.listen if not _is_loopback(endpoint)]
        if not wide:
            return
        bare = [endpoint for endpoint in wide if not endpoint.startswith(("tls/", "quic/"))]
        if (bare or not self.keys) and not self.open:
            raise UsageError(
                f"{', '.join(bare or wide)} is reached from other hosts and would ask nobody for a key: make keys with "
                "zsight keys init and listen on tls/..., or say --open on a network whose members you trust"
            )


def endpoints_of(text: str) -> tuple[str, ...]:
    """Endpoints with commas between them."""
    return tuple(part.strip() for part in text.split(",") if part.strip())


def endpoints_given(text: str, option: str) -> tuple[str, ...]:
    """The same of an option, which says something where it is given.

    Raises:
        UsageError: it says nothing.
    """
    endpoints = endpoints_of(text)
    if not endpoints:
        raise UsageError(f"{option} is {text!r}; expected an endpoint such as {DEFAULT_ENDPOINT}")
    return endpoints


def _truth(text: str) -> bool:
    return text.strip().lower() in ("1", "true", "yes", "on")


def _is_loopback(endpoint: str) -> bool:
    protocol, _, rest = endpoint.partition("/")
    address = rest.partition("#")[0].partition("?")[0].rpartition(":")[0].strip("[]")
    if protocol.startswith("unix") or address == "localhost":
        return True
    try:
        return ipaddress.ip_address(address).is_loopback
    except ValueError:
        return False


def _read_file() -> dict[str, Any]:
    """What the configuration file says; nothing where there is none."""
    named = os.environ.get("ZSIGHT_CONFIG")
    home = Path(os.environ.get("XDG_CONFIG_HOME") or "~/.config").expanduser() / "zsight"
    places = [Path(named)] if named else [Path(CONFIG_FILE), home / CONFIG_FILE]
    path = next((place for place in places if named or place.is_file()), None)
    if path is None:
        return {}
    try:
        entries = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise UsageError(f"{path} cannot be read: {error}") from None
    return {name: _entry(path, name, value) for name, value in entries.items()}


def _entry(path: Path, name: str, value: Any) -> Any:
    """One entry as Network has it."""
    if name in ("connect", "listen"):
        parts = [value] if isinstance(value, str) else value
        if isinstance(parts, list) and parts and all(isinstance(part, str) for part in parts):
            return tuple(parts)
    elif name in ("multicast", "open"):
        if isinstance(value, bool):
            return value
    elif name in _FILE_ENTRIES and isinstance(value, str):
        return str(path.parent / Path(value).expanduser()) if name == "keys" else value
    expected = f"expected {', '.join(_FILE_ENTRIES)}: endpoints, names and true or false"
    raise UsageError(f"{path}: {name} is {value!r}; {expected}")
