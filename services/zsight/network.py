"""How a process joins the network: endpoints, namespace, shared memory."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace

from zsight_protocol.channels import DEFAULT_NAMESPACE

__all__ = ["DEFAULT_ENDPOINT", "Network"]

DEFAULT_ENDPOINT = "tcp/127.0.0.1:7447"


@dataclass(frozen=True)
class Network:
    """Where the router is and which cell is meant.

    ``connect`` are the router's endpoints for everybody else, ``listen`` the endpoints of the router itself, ``peers``
    routers of other sites that it joins. ``config_file`` is a Zenoh configuration file to start from.
    """

    connect: tuple[str, ...] = (DEFAULT_ENDPOINT,)
    listen: tuple[str, ...] = (DEFAULT_ENDPOINT,)
    peers: tuple[str, ...] = ()
    namespace: str = DEFAULT_NAMESPACE
    multicast: bool = False
    shared_memory: bool = True
    config_file: str = ""

    @classmethod
    def from_environment(cls) -> Network:
        """From ZSIGHT_CONNECT and ZSIGHT_LISTEN (comma between endpoints), ZSIGHT_NAMESPACE and ZENOH_CONFIG."""
        return cls(
            connect=_endpoints(os.environ.get("ZSIGHT_CONNECT", "")) or (DEFAULT_ENDPOINT,),
            listen=_endpoints(os.environ.get("ZSIGHT_LISTEN", "")) or (DEFAULT_ENDPOINT,),
            namespace=os.environ.get("ZSIGHT_NAMESPACE") or DEFAULT_NAMESPACE,
            config_file=os.environ.get("ZENOH_CONFIG", ""),
        )

    def environment(self) -> dict[str, str]:
        """The same as environment variables, for processes to be started."""
        return {
            "ZSIGHT_CONNECT": ",".join(self.connect),
            "ZSIGHT_LISTEN": ",".join(self.listen),
            "ZSIGHT_NAMESPACE": self.namespace,
            **({"ZENOH_CONFIG": self.config_file} if self.config_file else {}),
        }

    def on(self, endpoint: str) -> Network:
        """The same network around one endpoint, for the router and for everybody else."""
        return replace(self, connect=(endpoint,), listen=(endpoint,))


def _endpoints(text: str) -> tuple[str, ...]:
    return tuple(part.strip() for part in text.split(",") if part.strip())
