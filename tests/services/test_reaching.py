"""Why no router was reached, endpoint by endpoint."""

from __future__ import annotations

import socket
from typing import TYPE_CHECKING

import pytest

from zsight.bus.zenoh_link import open_link
from zsight.errors import ConnectionLost
from zsight.network import Network
from zsight.reaching import trouble_at, what_happened

if TYPE_CHECKING:
    from collections.abc import Iterator


@pytest.fixture
def somebody() -> Iterator[str]:
    """An endpoint where somebody listens who says nothing."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        yield f"tcp/127.0.0.1:{server.getsockname()[1]}"


@pytest.fixture
def nobody(somebody: str) -> str:
    """An endpoint of this host where nobody listens."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    assert not somebody.endswith(f":{port}")
    return f"tcp/127.0.0.1:{port}"


def test_nobody_listens(nobody: str) -> None:
    assert what_happened(nobody).startswith(f"{nobody}: refused: the host is there and nobody listens")
    assert trouble_at(nobody)


def test_somebody_else_listens(somebody: str) -> None:
    assert what_happened(somebody).startswith(f"{somebody}: somebody answers, but no router")
    assert trouble_at(somebody) is None


@pytest.mark.parametrize(
    ("endpoint", "words"),
    [
        ("tcp/no-such-host.invalid:7447", "no host is called no-such-host.invalid"),
        ("tcp/127.0.0.1", "no port; expected an endpoint such as tcp/192.0.2.7:7447"),
        ("quic/127.0.0.1:7447", "quic is not looked at more closely"),
    ],
)
def test_other_mistakes(endpoint: str, words: str) -> None:
    assert what_happened(endpoint) == f"{endpoint}: {words}"


def test_every_endpoint_that_was_tried_is_told(nobody: str) -> None:
    with pytest.raises(ConnectionLost) as caught:
        open_link(Network(connect=(nobody, "tcp/no-such-host.invalid:1")))
    assert f"{nobody}: refused" in str(caught.value)
    assert "tcp/no-such-host.invalid:1: no host is called" in str(caught.value)
