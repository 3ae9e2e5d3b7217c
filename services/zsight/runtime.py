"""What every process has in common: logging, the session, the liveliness token, the health beat, signals, exit code."""

from __future__ import annotations

import contextlib
import gc
import logging
import math
import os
import signal
import socket
import threading
import time
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING

from zsight import shared_memory
from zsight.bus import Bus
from zsight.bus.zenoh_link import open_link, open_router
from zsight.errors import ConnectionLost, UsageError, ZsightError
from zsight.keys.identity import Roster, read_identity
from zsight.log_book import LogBook, start_logging
from zsight.network import Network
from zsight.parameters import Parameters, Saved, serve_parameters
from zsight.stop_signals import stop_signals
from zsight_core.errors import CoreError
from zsight_protocol.channels import Cell
from zsight_protocol.codec import encode
from zsight_protocol.errors import ProtocolError
from zsight_protocol.health import Health, Level
from zsight_protocol.message import Header, Time

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from zsight.bus import RawRequest
    from zsight.bus.link import Closable
    from zsight.services import Service
    from zsight.settings import Settings

__all__ = ["SUPERVISED", "host_name", "join", "run_service", "version"]

log = logging.getLogger("zsight")

SUPERVISED = "ZSIGHT_SUPERVISED"
"""Environment variable that tells a process to end when its standard input does: it never outlives its supervisor."""

_BEAT = 1.0  # seconds between health beats
_RETRY = 0.1  # seconds between attempts to reach the router
_LOOK = 0.2  # seconds between two looks at a router's list of hosts
_SILENT = 2.0  # seconds that a process waits for the router without a word


def version() -> str:
    """Version of this distribution."""
    return metadata.version("zsight")


def host_name() -> str:
    """This host's name as it stands in keys: that of its certificate, where it has one."""
    keys = Network.from_environment().keys
    if keys:
        return read_identity(Path(keys)).host
    name = os.environ.get("ZSIGHT_HOST") or socket.gethostname()
    legal = "".join(c if (c.isascii() and c.isalnum()) or c in "-_." else "-" for c in name.lower())
    return legal.strip(".-") or "host"


def join(network: Network, *, wait: float = 0.0, stopping: threading.Event | None = None) -> Bus:
    """A bus on the network; tries again for wait seconds while no router answers.

    Raises:
        ConnectionLost: none did.
    """
    stop = stopping or threading.Event()
    started = time.monotonic()
    told = False
    while True:
        waited = time.monotonic() - started
        last = waited >= wait
        try:
            return Bus(open_link(network, explain=last), Cell(network.namespace))
        except ConnectionLost:
            if last or stop.wait(_RETRY):
                raise
            if waited > _SILENT and not told:
                told = True
                limit = "" if wait == math.inf else f", up to {wait:g} s"
                log.info("waiting for a router at %s%s", ", ".join(network.connect), limit)


def run_service(
    service: Service,
    settings: Settings,
    process: str,
    network: Network,
    *,
    loop: Callable[[Bus, Settings], None] | None = None,
    wait: float = 30.0,
) -> int:
    """Run one service until it is told to stop.

    Args:
        service: row of the table.
        settings: of the service.
        process: its name in the keys.
        network: where the router is.
        loop: what is run; left out: the service's own.
        wait: seconds that it waits for a router.

    Returns:
        The exit code.
    """
    start_logging(process)
    stopping = threading.Event()
    _stop_on_signals(stopping)
    loop = loop or service.run()
    try:
        while _served(lambda: _open(service, network, wait, stopping), loop, service, settings, process, stopping):
            log.info("the list of hosts has changed: opened anew")
    except (ZsightError, CoreError, ProtocolError) as error:
        if isinstance(error, ConnectionLost) and stopping.is_set():
            return 0
        log.error("%s", error)
        return getattr(error, "exit_code", UsageError.exit_code)
    finally:
        stopping.set()
    shared_memory.remove_orphans()
    log.info("stopped")
    return 0


def _open(service: Service, network: Network, wait: float, stopping: threading.Event) -> Bus:
    if service.name == "router":
        return Bus(open_router(network), Cell(network.namespace))
    return join(network, wait=wait, stopping=stopping)


def _served(
    open_bus: Callable[[], Bus],
    loop: Callable[[Bus, Settings], None],
    service: Service,
    settings: Settings,
    process: str,
    stopping: threading.Event,
) -> bool:
    """Run a service on a session of its own; true where a router is to be opened anew, for other hosts."""
    bus = open_bus()
    keys = Network.from_environment().keys
    roster = Roster(keys) if service.name == "router" and keys else None
    parameters = Parameters(settings, Saved(bus.cell.namespace, process))
    with bus, LogBook(host_name(), process).on(bus), _beating(bus, service, process, settings):
        serve_parameters(bus, host_name(), process, service.name, parameters)
        threading.Thread(target=_stop_bus, args=(stopping, bus, roster), name="stop", daemon=True).start()
        try:
            loop(bus, settings)
        except (ZsightError, CoreError, ProtocolError) as error:
            if not bus.is_ready or isinstance(error, ConnectionLost):
                raise
            raise ZsightError(str(error)) from error  # its settings made sense: it is worth starting again
    return roster is not None and roster.changed and not stopping.is_set()


def _stop_on_signals(stopping: threading.Event) -> None:
    for number in stop_signals():
        signal.signal(number, lambda *_: stopping.set())
    if os.environ.get(SUPERVISED):
        threading.Thread(target=_stop_with_input, args=(stopping,), name="supervised", daemon=True).start()


def _stop_with_input(stopping: threading.Event) -> None:
    with contextlib.suppress(OSError, ValueError):
        while os.read(0, 64):
            pass
    stopping.set()


def _stop_bus(stopping: threading.Event, bus: Bus, roster: Roster | None) -> None:
    """Stop the bus when the process is to stop, or when other hosts are welcome than it was opened for."""
    while not stopping.wait(None if roster is None else _LOOK) and not bus.stopping.is_set():
        if roster is not None and roster.has_changed():
            break
    bus.stop()


@contextlib.contextmanager
def _beating(bus: Bus, service: Service, process: str, settings: Settings) -> Iterator[None]:
    """Health beats while the service runs, and its liveliness token from the moment it is ready."""
    host = host_name()
    errors = _ErrorCounter()
    logging.getLogger().addHandler(errors)
    key = bus.cell.alive(host, process)
    bus.on_ready = lambda: _declare_ready(bus, key)
    writer = bus.writer(bus.cell.health(host, process), Health)
    started = Time.now()

    def health() -> Health:
        return Health(
            header=Header(stamp=Time.now()),
            host=host,
            process=process,
            service=service.name,
            pid=os.getpid(),
            version=version(),
            started=started,
            level=Level.WARN if errors.count else Level.OK,
            last_error=errors.last,
            errors=errors.count,
            memory_bytes=_resident_bytes(),
            writers=tuple(counter.health() for counter in bus.writers),
            readers=tuple(counter.health() for counter in bus.readers),
            settings=settings.model_dump(mode="json"),
        )

    def asked(request: RawRequest) -> None:
        request.reply(encode(health()))
        request.close()

    def beat() -> None:
        while not bus.stopping.wait(_BEAT):
            with contextlib.suppress(ConnectionLost):
                writer.send(health())

    bus.serve(bus.cell.health(host, process), asked)

    thread = threading.Thread(target=beat, name="health", daemon=True)
    thread.start()
    try:
        yield
    finally:
        bus.stop()
        thread.join()
        logging.getLogger().removeHandler(errors)


def _declare_ready(bus: Bus, key: str) -> Closable:
    """The token; what has been made up to now stays, and the garbage collector need not look at it again."""
    if not gc.isenabled():
        gc.freeze()
        gc.enable()
    return bus.link.declare_alive(key)


class _ErrorCounter(logging.Handler):
    """Keeps the last warning or error, and how many there were."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.count = 0
        self.last = ""

    def emit(self, record: logging.LogRecord) -> None:
        self.count += 1
        self.last = record.getMessage()[:500]


def _resident_bytes() -> int:
    """Memory of this process that is in use now; 0 where the system does not say."""
    try:
        pages = Path("/proc/self/statm").read_text(encoding="ascii").split()[1]
        return int(pages) * os.sysconf("SC_PAGE_SIZE")
    except (OSError, ValueError, IndexError):
        return 0
