"""The log of a process: lines on stderr for people or as JSON, and the same events on the network."""

from __future__ import annotations

import contextlib
import json
import logging
import os
import queue
import sys
import threading
from collections import deque
from typing import TYPE_CHECKING

from zsight.errors import UsageError, ZsightError
from zsight.log_flood import LogFlood
from zsight_protocol.codec import decode, encode
from zsight_protocol.errors import ProtocolError
from zsight_protocol.log_event import LogEvent, LogTail
from zsight_protocol.message import Header, Time

if TYPE_CHECKING:
    from collections.abc import Iterator

    from zsight.bus import Bus, RawRequest

__all__ = ["LogBook", "ask_logs", "start_logging"]

_KEPT = 200  # events that a process still tells of
_WAITING = 1000  # events that wait to be sent; more are left out


def start_logging(process: str) -> None:
    """One line an event on stderr: time, severity, process, words; or JSON where ZSIGHT_LOG_FORMAT says so.

    Raises:
        UsageError: ZSIGHT_LOG is no severity, or ZSIGHT_LOG_FORMAT no form.
    """
    level = os.environ.get("ZSIGHT_LOG", "").upper() or "INFO"
    if level not in logging.getLevelNamesMapping():
        raise UsageError(f"ZSIGHT_LOG is {level}; expected DEBUG, INFO, WARNING or ERROR")
    form = os.environ.get("ZSIGHT_LOG_FORMAT", "").lower()
    if form not in ("", "json"):
        raise UsageError(f"ZSIGHT_LOG_FORMAT is {form}; expected json, or nothing for words")
    logging.basicConfig(level=level, stream=sys.stderr, force=True)
    as_json = form == "json"
    words = f"%(asctime)s %(levelname)-7s {process}: %(message)s"
    for handler in logging.getLogger().handlers:
        handler.setFormatter(_JsonLines(process) if as_json else logging.Formatter(words))
        handler.addFilter(LogFlood())
    for talkative in ("numba", "asyncio", "zenoh"):
        logging.getLogger(talkative).setLevel("WARNING")


class _JsonLines(logging.Formatter):
    """One JSON object an event."""

    def __init__(self, process: str) -> None:
        super().__init__()
        self._process = process

    def format(self, record: logging.LogRecord) -> str:
        entry = {
            "time": record.created,
            "severity": record.levelname,
            "process": self._process,
            "logger": record.name,
            "text": record.getMessage(),
        }
        if record.exc_info:
            entry["traceback"] = self.formatException(record.exc_info)
        return json.dumps(entry, ensure_ascii=False)


class LogBook(logging.Handler):
    """Keeps the last events of this process, sends each on the bus, and answers who asks for them."""

    def __init__(self, host: str, process: str) -> None:
        """Args: host and process whose events they are."""
        super().__init__()
        self.addFilter(LogFlood())
        self._whose = (host, process)
        self._events: deque[LogEvent] = deque(maxlen=_KEPT)
        self._number = 0
        self._unsent: queue.Queue[LogEvent | None] = queue.Queue(_WAITING)

    def emit(self, record: logging.LogRecord) -> None:
        """Take an event down; called by logging, on any thread and under its lock."""
        self._number += 1
        host, process = self._whose
        event = LogEvent(
            header=Header(stamp=Time.from_ns(int(record.created * 1e9))),
            host=host,
            process=process,
            number=self._number,
            severity=record.levelname[:32],
            logger=record.name[:256],
            text=record.getMessage()[:8000].encode("utf-8", "replace").decode(),
        )
        self._events.append(event)
        with contextlib.suppress(queue.Full):
            self._unsent.put_nowait(event)

    @contextlib.contextmanager
    def on(self, bus: Bus) -> Iterator[None]:
        """Send and answer on a bus until the end of the block."""
        key = bus.cell.log(*self._whose)
        writer = bus.writer(key, LogEvent)

        def send() -> None:
            while (event := self._unsent.get()) is not None:
                with contextlib.suppress(ZsightError):
                    writer.send(event)

        served = bus.serve(key, self._asked)
        thread = threading.Thread(target=send, name="log", daemon=True)
        thread.start()
        logging.getLogger().addHandler(self)
        try:
            yield
        finally:
            logging.getLogger().removeHandler(self)
            self._unsent.put(None)
            thread.join()
            served.close()

    def _asked(self, request: RawRequest) -> None:
        request.reply(encode(LogTail(events=tuple(self._events))))
        request.close()


def ask_logs(bus: Bus, host: str = "*", process: str = "*", timeout: float = 1.0) -> list[LogEvent]:
    """The last events of every process that answers within timeout seconds, oldest first."""
    events: list[LogEvent] = []
    for payload in bus.ask(bus.cell.log(host, process), b"", timeout, everyone=True).within(timeout):
        with contextlib.suppress(ProtocolError):
            events += decode(LogTail, payload).events
    return sorted(events, key=lambda event: (event.header.stamp.ns, event.number))
