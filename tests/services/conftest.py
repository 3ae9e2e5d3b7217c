"""Networks for the tests of services: in memory, and real Zenoh in this process."""

from __future__ import annotations

import itertools
import socket
from typing import TYPE_CHECKING

import pytest

from zsight.bus import Bus
from zsight.bus.memory_link import MemoryLink, MemoryNetwork
from zsight.bus.zenoh_link import open_link, open_router
from zsight.network import Network
from zsight_protocol.channels import Cell

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

_namespaces = (f"test{number}" for number in itertools.count())


@pytest.fixture(scope="session")
def free_port() -> int:
    """A port of this host that nobody listens on."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


@pytest.fixture(scope="session")
def zenoh_network(free_port: int) -> Iterator[Network]:
    """A Zenoh router in this process."""
    network = Network().on(f"tcp/127.0.0.1:{free_port}")
    router = open_router(network)
    yield network
    router.close()


@pytest.fixture
def join_memory() -> Iterator[Callable[[], Bus]]:
    """Each call is another process of one network in memory."""
    network, cell = MemoryNetwork(), Cell("test")
    buses: list[Bus] = []

    def join() -> Bus:
        buses.append(Bus(MemoryLink(network), cell))
        return buses[-1]

    yield join
    for bus in buses:
        bus.close()


@pytest.fixture
def join_zenoh(zenoh_network: Network) -> Iterator[Callable[[], Bus]]:
    """Each call is another session on the router, in a cell of this test's own."""
    cell = Cell(next(_namespaces))
    buses: list[Bus] = []

    def join() -> Bus:
        buses.append(Bus(open_link(zenoh_network), cell))
        return buses[-1]

    yield join
    for bus in buses:
        bus.close()


@pytest.fixture(params=["memory", "zenoh"])
def join(request: pytest.FixtureRequest) -> Callable[[], Bus]:
    """Join a network: every test that takes this runs on both kinds."""
    joined: Callable[[], Bus] = request.getfixturevalue(f"join_{request.param}")
    return joined


@pytest.fixture
def bus(join_memory: Callable[[], Bus]) -> Bus:
    """One process of a network in memory."""
    return join_memory()
