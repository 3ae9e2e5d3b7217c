"""Where the network is, by the environment."""

from __future__ import annotations

import pytest

from zsight.network import DEFAULT_ENDPOINT, Network

VARIABLES = ("ZSIGHT_CONNECT", "ZSIGHT_LISTEN", "ZSIGHT_NAMESPACE", "ZENOH_CONFIG")


@pytest.fixture(autouse=True)
def _clean(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in VARIABLES:
        monkeypatch.delenv(name, raising=False)


def test_without_variables_it_is_this_host() -> None:
    assert Network.from_environment() == Network()
    assert Network().connect == Network().listen == (DEFAULT_ENDPOINT,)


@pytest.mark.parametrize("empty", ["", " ", ","])
def test_an_empty_variable_says_nothing(monkeypatch: pytest.MonkeyPatch, empty: str) -> None:
    for name in VARIABLES[:2]:
        monkeypatch.setenv(name, empty)
    for name in VARIABLES[2:]:
        monkeypatch.setenv(name, "")
    assert Network.from_environment() == Network()


def test_processes_inherit_the_network(monkeypatch: pytest.MonkeyPatch) -> None:
    network = Network(
        ("tcp/192.0.2.7:1", "tcp/192.0.2.8:1"), ("tcp/0.0.0.0:1",), namespace="cell7", config_file="z.json5"
    )
    for name, value in network.environment().items():
        monkeypatch.setenv(name, value)
    assert Network.from_environment() == network


def test_one_endpoint_for_everybody() -> None:
    network = Network(namespace="cell7").on("tcp/192.0.2.7:1")
    assert (network.connect, network.listen, network.namespace) == (("tcp/192.0.2.7:1",), ("tcp/192.0.2.7:1",), "cell7")
