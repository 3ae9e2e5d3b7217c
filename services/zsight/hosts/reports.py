"""What the supervisors of all hosts tell of their processes."""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING

from zsight_protocol.codec import decode
from zsight_protocol.errors import ProtocolError
from zsight_protocol.host_report import HostReport

if TYPE_CHECKING:
    from zsight.bus import Bus

__all__ = ["ask_hosts"]


def ask_hosts(bus: Bus, timeout: float = 1.0) -> list[HostReport]:
    """The report of every supervisor that answers within timeout seconds, by host."""
    reports: list[HostReport] = []
    for payload in bus.ask(bus.cell.host("*"), b"", timeout, everyone=True).within(timeout):
        with contextlib.suppress(ProtocolError):
            reports.append(decode(HostReport, payload))
    return sorted(reports, key=lambda report: report.host)
