"""The signals that tell a process to end: Ctrl-C, a request, and a terminal that is closed or whose line is cut."""

from __future__ import annotations

import signal

__all__ = ["stop_signals"]


def stop_signals() -> list[signal.Signals]:
    """SIGINT, SIGTERM, and SIGHUP where it is not to be ignored, as nohup has it."""
    if signal.getsignal(signal.SIGHUP) is signal.SIG_IGN:
        return [signal.SIGINT, signal.SIGTERM]
    return [signal.SIGINT, signal.SIGTERM, signal.SIGHUP]
