"""Several hosts on one machine: network namespaces on a switch of their own, with cables that can be pulled.

Nothing is seen of them outside: the switch has a namespace too, and all go with the processes that hold them.
"""

from __future__ import annotations

import ctypes
import os
import shutil
import subprocess
from contextlib import ExitStack
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from types import TracebackType

__all__ = ["Hosts", "why_not"]

_NEW_NETWORK = 0x40000000  # CLONE_NEWNET


def why_not() -> str | None:
    """Why there can be no hosts here; none where there can."""
    if not hasattr(os, "geteuid") or os.geteuid() != 0:
        return "network namespaces need root"
    missing = [tool for tool in ("ip", "unshare", "nsenter") if shutil.which(tool) is None]
    if missing:
        return f"no {' or '.join(missing)} on this machine"
    done = subprocess.run(["unshare", "-n", "true"], capture_output=True, check=False)
    return None if done.returncode == 0 else f"no network namespaces here: {done.stderr.decode().strip()}"


class Hosts:
    """Hosts 1 to count at 10.77.0.1 and so on; a context manager that leaves nothing behind."""

    def __init__(self, count: int) -> None:
        self._count = count
        self._stack = ExitStack()

    def __enter__(self) -> Hosts:
        try:
            self._switch = self._hold()
            self._hosts = [self._hold() for _ in range(self._count)]
            self._ip(self._switch, "link add name switch type bridge")
            self._ip(self._switch, "link set switch up")
            for number, host in enumerate(self._hosts, start=1):
                self._ip(self._switch, f"link add name port{number} type veth peer name eth0 netns {host}")
                self._ip(self._switch, f"link set port{number} master switch up")
                self._ip(host, f"addr add {self.address(number)}/24 dev eth0")
                self._ip(host, "link set lo up")
                self._ip(host, "link set eth0 up")
        except BaseException:
            self._stack.close()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stack.close()

    def _hold(self) -> int:
        """A new namespace, held by a process of this number until it ends."""
        holder = subprocess.Popen(
            ["unshare", "-n", "sh", "-c", "echo; exec sleep infinity"], stdout=subprocess.PIPE, stdin=subprocess.DEVNULL
        )
        self._stack.callback(holder.wait)
        self._stack.callback(holder.kill)
        if holder.stdout is not None:
            self._stack.callback(holder.stdout.close)
            holder.stdout.readline()
        return holder.pid

    @staticmethod
    def _ip(holder: int, words: str) -> None:
        subprocess.run(["nsenter", "-t", str(holder), "-n", "ip", *words.split()], check=True)

    @staticmethod
    def address(host: int) -> str:
        return f"10.77.0.{host}"

    def command(self, host: int, *command: str) -> list[str]:
        """The command as it is run on a host."""
        return ["nsenter", "-t", str(self._hosts[host - 1]), "-n", *command]

    def cut(self, host: int) -> None:
        """Pull its cable."""
        self._ip(self._switch, f"link set port{host} down")

    def mend(self, host: int) -> None:
        """Plug it in again."""
        self._ip(self._switch, f"link set port{host} up")

    def enter(self, host: int) -> None:
        """Put this thread, and those that it starts, on a host for good."""
        with open(f"/proc/{self._hosts[host - 1]}/ns/net", "rb") as namespace:  # noqa: PTH123  its descriptor is wanted
            if ctypes.CDLL(None, use_errno=True).setns(namespace.fileno(), _NEW_NETWORK) != 0:
                raise OSError(ctypes.get_errno(), "setns")
