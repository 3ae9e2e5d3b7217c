"""Where the network is, by the environment."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from zsight.bus.zenoh_link import open_link
from zsight.errors import UsageError
from zsight.network import DEFAULT_ENDPOINT, Network, endpoints_given

if TYPE_CHECKING:
    from pathlib import Path

VARIABLES = (
    "ZSIGHT_CONNECT",
    "ZSIGHT_LISTEN",
    "ZSIGHT_NAMESPACE",
    "ZENOH_CONFIG",
    "ZSIGHT_KEYS",
    "ZSIGHT_OPEN",
    "ZSIGHT_MULTICAST",
    "ZSIGHT_CONFIG",
)


@pytest.fixture(autouse=True)
def _clean(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    for name in VARIABLES:
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "home"))
    monkeypatch.chdir(tmp_path)


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


def test_an_option_of_no_endpoint_is_told() -> None:
    for option in ("", " , "):
        with pytest.raises(UsageError, match=r"--connect is .*; expected an endpoint such as tcp/"):
            endpoints_given(option, "--connect")
    assert endpoints_given("tcp/a:1, tcp/b:2", "--connect") == ("tcp/a:1", "tcp/b:2")


def test_a_zenoh_file_that_is_not_there_is_named() -> None:
    with pytest.raises(UsageError, match=r"ZENOH_CONFIG names nope\.json5, and there is no such file"):
        open_link(Network(config_file="nope.json5"))


def test_processes_inherit_the_network(monkeypatch: pytest.MonkeyPatch) -> None:
    network = Network(
        ("tcp/192.0.2.7:1", "tcp/192.0.2.8:1"),
        ("tcp/0.0.0.0:1",),
        namespace="cell7",
        config_file="z.json5",
        keys="keys/eye",
        open=True,
        multicast=True,
    )
    for name, value in network.environment().items():
        monkeypatch.setenv(name, value)
    assert Network.from_environment() == network


def test_one_endpoint_for_everybody() -> None:
    network = Network(namespace="cell7").on("tcp/192.0.2.7:1")
    assert (network.connect, network.listen, network.namespace) == (("tcp/192.0.2.7:1",), ("tcp/192.0.2.7:1",), "cell7")


# zsight.toml


def test_a_file_here_says_where_the_router_is(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "zsight.toml").write_text('connect = "tls/192.0.2.7:7447"\nnamespace = "lab"\nkeys = "desk"\n')
    network = Network.from_environment()
    assert network == Network(("tls/192.0.2.7:7447",), ("tls/127.0.0.1:7447",), namespace="lab", keys="desk")
    monkeypatch.setenv("ZSIGHT_CONNECT", "tls/192.0.2.8:1")
    assert Network.from_environment().connect == ("tls/192.0.2.8:1",)


def test_the_users_file_holds_where_none_is_here(tmp_path: Path) -> None:
    (tmp_path / "home" / "zsight").mkdir(parents=True)
    (tmp_path / "home" / "zsight" / "zsight.toml").write_text('connect = ["tcp/a:1", "tcp/b:1"]\nkeys = "desk"\n')
    network = Network.from_environment()
    assert network.connect == ("tcp/a:1", "tcp/b:1")
    assert network.keys == str(tmp_path / "home" / "zsight" / "desk")  # beside the file


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("connect =", "cannot be read"),
        ("connect = 5", "connect is 5; expected connect, listen"),
        ("listen = []", "listen is "),
        ("conect = 'tcp/a:1'", "conect is 'tcp/a:1'; expected connect"),
        ("open = 'yes'", "open is 'yes'"),
        ("keys = true", "keys is True"),
    ],
)
def test_a_mistake_in_the_file_is_named(tmp_path: Path, text: str, words: str) -> None:
    (tmp_path / "zsight.toml").write_text(text)
    with pytest.raises(UsageError, match=words):
        Network.from_environment()


def test_a_file_that_is_named_must_be_there(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ZSIGHT_CONFIG", "absent.toml")
    with pytest.raises(UsageError, match=r"absent\.toml cannot be read"):
        Network.from_environment()
