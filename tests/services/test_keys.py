"""Keys: who is let in, who is refused and is told why, and what each role may do."""

from __future__ import annotations

import shutil
import socket
import stat
from typing import TYPE_CHECKING

import pytest
from tests.services.waiting import DEADLINE, soon

from zsight.bus import Bus
from zsight.bus.zenoh_link import open_link, open_router
from zsight.errors import ConnectionLost, NotAllowed, UsageError
from zsight.keys.authority import Authority, expiry
from zsight.keys.identity import Identity, Roster, read_hosts, read_identity
from zsight.keys.roles import ROLES, access_rules, grants_of
from zsight.network import Network
from zsight.services import SERVICES
from zsight_protocol.channels import CHANNELS, Cell, Delivery
from zsight_protocol.errors import KeyNameError
from zsight_protocol.geometry import TransformList
from zsight_protocol.point_cloud import PointCloud2

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from zsight.bus import RawRequest

CELL = "zsight"


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Authority:
    """An authority with a host for each role that these tests need."""
    authority = Authority(tmp_path_factory.mktemp("keys") / "authority")
    authority.init(["127.0.0.1"], days=30, cell=CELL)
    for host, roles in (("eye", ["camera"]), ("mind", ["finder"]), ("tape", ["recorder"]), ("desk", ["operator"])):
        authority.add(host, roles, days=30, cells=[CELL])
    authority.add("old", ["camera"], days=0, cells=[CELL])
    return authority


@pytest.fixture
def authority(made: Authority, tmp_path: Path) -> Authority:
    """A copy that a test may change."""
    shutil.copytree(made.folder, tmp_path / "authority")
    return Authority(tmp_path / "authority")


def port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        free: int = probe.getsockname()[1]
        return free


@pytest.fixture(scope="module")
def endpoint(made: Authority) -> Iterator[str]:
    """Where a router with keys listens."""
    where = f"tls/127.0.0.1:{port()}"
    router = open_router(Network(listen=(where,), keys=str(made.folder / "router")))
    yield where
    router.close()


@pytest.fixture
def join_as(made: Authority, endpoint: str) -> Iterator[Callable[[str], Bus]]:
    """Join with the keys of a host."""
    buses: list[Bus] = []

    def join(host: str) -> Bus:
        buses.append(Bus(open_link(Network(connect=(endpoint,), keys=str(made.folder / host))), Cell(CELL)))
        return buses[-1]

    yield join
    for bus in buses:
        bus.close()


# What the authority makes.


def test_every_host_has_a_folder_that_says_who_it_is(made: Authority) -> None:
    assert read_identity(made.folder / "eye") == Identity("eye", ("camera",), (CELL,))
    assert [host.host for host in read_hosts(made.folder / "router")] == [
        "router",
        "eye",
        "mind",
        "tape",
        "desk",
        "old",
    ]
    for secret in (made.folder / "ca.key", made.folder / "eye" / "key.pem"):
        assert stat.S_IMODE(secret.stat().st_mode) == 0o600
    assert (
        28
        < (expiry(made.folder / "eye" / "certificate.pem") - expiry(made.folder / "old" / "certificate.pem")).days
        <= 30
    )


@pytest.mark.parametrize("name", ["../eye", "a/b", "", "..", ".hidden", "Eye", "a\0b"])
def test_a_host_of_an_impossible_name_gets_no_folder(authority: Authority, name: str) -> None:
    before = sorted(authority.folder.rglob("*"))
    for act in (lambda: authority.add(name, ["camera"], days=1, cells=[CELL]), lambda: authority.revoke(name)):
        with pytest.raises(KeyNameError):
            act()
    assert sorted(authority.folder.rglob("*")) == before


def test_mistakes_are_named(authority: Authority, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"no authority in .* make one with: zsight keys init"):
        Authority(tmp_path / "none").hosts()
    with pytest.raises(UsageError, match="an authority already"):
        authority.init(["127.0.0.1"], days=1, cell=CELL)
    with pytest.raises(UsageError, match="eye has keys"):
        authority.add("eye", ["camera"], days=1, cells=[CELL])
    with pytest.raises(UsageError, match="roles are king; expected some of camera"):
        authority.add("new", ["king"], days=1, cells=[CELL])
    with pytest.raises(UsageError, match="no host is called new; known are eye, mind"):
        authority.revoke("new")
    with pytest.raises(UsageError, match="make one with: zsight keys init"):
        Authority(tmp_path / "none").add("new", ["camera"], days=1, cells=[CELL])
    with pytest.raises(UsageError, match=r"which has no ca\.pem"):
        read_identity(tmp_path)


def test_every_service_has_a_role() -> None:
    assert {row.name for row in SERVICES} <= set(ROLES)


def test_every_channel_has_a_role_that_fills_it() -> None:
    services = [grants_of(Identity("*", (row.name,), (CELL,))) for row in SERVICES]
    filled = {key for granted in services for key in (*granted.publish, *granted.serve, *granted.hold)}
    by_people = {"*/selected_points"}
    assert {row.pattern for row in CHANNELS} - by_people <= filled


def test_a_router_sees_that_its_hosts_have_changed(authority: Authority) -> None:
    roster = Roster(str(authority.folder / "router"))
    assert not roster.has_changed()
    authority.revoke("eye")
    assert roster.has_changed()


def test_a_host_has_rules_in_its_own_cells_alone() -> None:
    rules = access_rules([Identity("eye", ("camera",), ("left", "right"))])
    assert rules["default_permission"] == "deny"
    assert {key.split("/")[0] for rule in rules["rules"] for key in rule["key_exprs"]} == {"left", "right"}


# Who is let in.


def test_hosts_with_keys_exchange_what_their_roles_allow(join_as: Callable[[str], Bus]) -> None:
    eye, mind = join_as("eye"), join_as("mind")
    static = eye.writer(eye.cell.tf_static, TransformList)
    static.send(TransformList(transforms=()))
    seen = mind.reader(mind.cell.points("kinect"), PointCloud2)
    clouds = eye.link.writer(eye.cell.points("kinect"), Delivery.LATEST)
    assert soon(clouds.has_readers)
    assert mind.reader(mind.cell.tf_static, TransformList).take(DEADLINE) is not None  # a late joiner
    clouds.put(b"no cloud", b"", b"")
    assert soon(lambda: seen.take(0.1) is None and seen.counter.refused == 1)


def answer_well(request: RawRequest) -> None:
    request.reply(b"well")
    request.close()


def test_an_operator_asks_every_host(join_as: Callable[[str], Bus]) -> None:
    eye, mind, desk = join_as("eye"), join_as("mind"), join_as("desk")
    for bus, host in ((eye, "eye"), (mind, "mind")):
        bus.serve(bus.cell.health(host, "process"), answer_well)
    heard: list[bytes] = []

    def both_answer() -> bool:
        replies = desk.ask(desk.cell.health("*", "*"), b"", DEADLINE, everyone=True)
        heard[:] = iter(lambda: replies.take(DEADLINE), None)
        return len(heard) == 2

    assert soon(both_answer)


def refused(endpoint: str, keys: str = "") -> str:
    with pytest.raises(ConnectionLost) as caught:
        open_link(Network(connect=(endpoint,), keys=keys))
    return str(caught.value)


def test_a_client_without_a_certificate_is_refused(endpoint: str) -> None:
    assert "asks for keys: give their folder with ZSIGHT_KEYS" in refused(endpoint)
    assert "does it want keys, tls/...?" in refused(endpoint.replace("tls/", "tcp/"))


def test_an_expired_certificate_is_refused(endpoint: str, made: Authority) -> None:
    assert "certificate: this host's time is over" in refused(endpoint, str(made.folder / "old"))


def test_a_certificate_of_another_authority_is_refused(endpoint: str, made: Authority, tmp_path: Path) -> None:
    other = Authority(tmp_path / "other")
    other.init(["127.0.0.1"], days=30, cell=CELL)
    stranger = other.add("eye", ["camera"], days=30, cells=[CELL])
    assert "certificate: the router's is not good here" in refused(endpoint, str(stranger))
    shutil.copy(made.folder / "ca.pem", stranger / "ca.pem")  # it believes the router, which does not believe it
    assert "certificate: it does not trust this host's" in refused(endpoint, str(stranger))


def test_a_revoked_certificate_is_refused(authority: Authority, tmp_path: Path) -> None:
    kept = tmp_path / "kept"
    shutil.copytree(authority.folder / "eye", kept)
    where = f"tls/127.0.0.1:{port()}"
    network = Network(connect=(where,), listen=(where,), keys=str(authority.folder / "router"))
    router = open_router(network)
    open_link(Network(connect=(where,), keys=str(kept))).close()
    authority.revoke("eye")
    router.close()
    router = open_router(network)
    assert "certificate: it does not trust this host's: it was revoked" in refused(where, str(kept))
    open_link(Network(connect=(where,), keys=str(authority.folder / "desk"))).close()
    router.close()


# What a role does not allow.


def test_a_camera_with_a_finders_certificate_is_told_and_reaches_nobody(
    join_as: Callable[[str], Bus], monkeypatch: pytest.MonkeyPatch
) -> None:
    rogue, eye, desk = join_as("mind"), join_as("eye"), join_as("desk")
    key = rogue.cell.points("kinect")
    with pytest.raises(
        NotAllowed, match=r"keys of mind do not allow to publish zsight/kinect/points: its roles are finder"
    ):
        rogue.writer(key, PointCloud2)
    seen = desk.reader(key, PointCloud2)
    monkeypatch.setattr("zsight.bus.zenoh_link.Guard.require", lambda *_: None)  # a program that does not look
    forged = rogue.link.writer(key, Delivery.LATEST)
    honest = eye.link.writer(key, Delivery.LATEST)
    assert soon(honest.has_readers)
    for _ in range(3):
        forged.put(b"forged", b"", b"")
    honest.put(b"honest", b"", b"")
    assert soon(lambda: seen.take(0.05) is None and seen.counter.refused >= 1)
    assert seen.counter.refused == 1  # one that is no cloud came: the honest one


@pytest.mark.parametrize(
    ("host", "act", "words"),
    [
        ("tape", lambda bus: bus.writer(bus.cell.points("kinect"), PointCloud2), "publish zsight/kinect/points"),
        ("tape", lambda bus: bus.ask(bus.cell.find_object("any"), b"", 1.0), "ask zsight/find_object/any"),
        ("eye", lambda bus: bus.serve(bus.cell.find_object("any"), lambda _: None), "serve zsight/find_object/any"),
        ("eye", lambda bus: bus.reader(bus.cell.points("kinect"), PointCloud2), "read zsight/kinect/points"),
        ("eye", lambda bus: bus.link.declare_alive(bus.cell.alive("desk", "camera")), "hold zsight/@alive/desk/camera"),
        ("mind", lambda bus: bus.ask(bus.cell.parameters("*", "*"), b"", 1.0), r"ask zsight/param/\*/\*"),
    ],
)
def test_who_is_denied_is_told(
    join_as: Callable[[str], Bus], host: str, act: Callable[[Bus], object], words: str
) -> None:
    with pytest.raises(NotAllowed, match=f"keys of {host} do not allow to {words}"):
        act(join_as(host))


def test_a_host_of_one_cell_may_nothing_in_another(made: Authority, endpoint: str) -> None:
    link = open_link(Network(connect=(endpoint,), keys=str(made.folder / "eye")))
    with pytest.raises(NotAllowed, match="publish other/kinect/points"):
        link.writer(Cell("other").points("kinect"), Delivery.LATEST)
    link.close()


# Without keys.


@pytest.mark.parametrize(
    ("listen", "keys", "fine"),
    [
        ("tcp/127.0.0.1:7447", "", True),
        ("tcp/localhost:7447", "", True),
        ("tcp/[::1]:7447", "", True),
        ("unixsock-stream//tmp/z", "", True),
        ("tcp/0.0.0.0:7447", "", False),
        ("tcp/[::]:7447", "", False),
        ("tcp/192.0.2.7:7447", "", False),
        ("tcp/router:7447", "", False),
        ("tls/0.0.0.0:7447", "", False),
        ("tcp/0.0.0.0:7447", "keys", False),
        ("tls/0.0.0.0:7447", "keys", True),
    ],
)
def test_others_reach_a_router_with_keys_or_on_purpose(listen: str, keys: str, fine: bool) -> None:
    network = Network(listen=(listen,), keys=keys)
    if fine:
        network.require_guarded()
    else:
        with pytest.raises(UsageError, match=r"would ask nobody for a key: .* say --open"):
            network.require_guarded()
    Network(listen=(listen,), keys=keys, open=True).require_guarded()


def test_an_open_router_warns(caplog: pytest.LogCaptureFixture) -> None:
    open_router(Network(listen=(f"tcp/0.0.0.0:{port()}",), open=True)).close()
    assert "open to everybody who reaches tcp/0.0.0.0" in caplog.text
