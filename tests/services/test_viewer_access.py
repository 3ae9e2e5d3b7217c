"""Who gets the page: the one with the token, by a name of this host, from the page itself."""

from __future__ import annotations

import http.client
import socket
import stat
from typing import TYPE_CHECKING

import pytest

from zsight.errors import UsageError
from zsight.viewer import access
from zsight.viewer.access import Gate, kept_token
from zsight.viewer.server import Server, open_server
from zsight.viewer.settings import Settings

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

GATE = Gate("secret", ("robot.example",))


@pytest.fixture(scope="module")
def server() -> Iterator[Server]:
    with open_server(Settings(port=0)) as running:
        yield running


class Answer:
    """What the server says to one request."""

    def __init__(self, server: Server, path: str, headers: dict[str, str]) -> None:
        connection = http.client.HTTPConnection("127.0.0.1", server.port, timeout=10)
        connection.request("GET", path, headers=headers)
        response = connection.getresponse()
        self.status, self.headers, self.body = response.status, dict(response.getheaders()), response.read()
        connection.close()


def cookie(server: Server) -> str:
    answer = Answer(server, server.link.split(str(server.port))[1], {})
    assert (answer.status, answer.headers["Location"]) == (303, "/")
    assert "HttpOnly" in answer.headers["Set-Cookie"]
    return answer.headers["Set-Cookie"].split(";")[0]


def upgrade(**more: str) -> dict[str, str]:
    return {
        "Upgrade": "websocket",
        "Connection": "Upgrade",
        "Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ==",
        "Sec-WebSocket-Version": "13",
        **more,
    }


def test_the_link_opens_the_page_and_leaves_no_token_in_the_address(server: Server) -> None:
    page = Answer(server, "/", {"Cookie": cookie(server)})
    assert page.status == 200
    assert b"<html" in page.body[:1000].lower()
    assert "connect-src 'self'" in page.headers["Content-Security-Policy"]


@pytest.mark.parametrize("path", ["/", "/?token=wrong", "/?token=", "/index.html", "/assets/x.js"])
def test_without_the_token_nothing_is_shown(server: Server, path: str) -> None:
    answer = Answer(server, path, {})
    assert answer.status == 401
    assert b"zsight view" in answer.body


def test_the_socket_is_guarded_too(server: Server) -> None:
    own = f"http://127.0.0.1:{server.port}"
    assert Answer(server, "/", upgrade()).status == 401
    assert Answer(server, "/", upgrade(Cookie=cookie(server), Origin="http://evil.example")).status == 403
    good = upgrade(Cookie=cookie(server), Origin=own, **{"Sec-WebSocket-Protocol": "viser-v0"})
    with socket.create_connection(("127.0.0.1", server.port), timeout=10) as connection:
        lines = [f"{name}: {value}" for name, value in {"Host": own[7:], **good}.items()]
        connection.sendall("\r\n".join(["GET / HTTP/1.1", *lines, "", ""]).encode())
        assert connection.recv(12) == b"HTTP/1.1 101"


@pytest.mark.parametrize("host", ["evil.example", "127.0.0.1.evil.example", "", "localhost.evil"])
def test_another_name_is_refused_with_the_token_too(server: Server, host: str) -> None:
    assert Answer(server, "/", {"Cookie": cookie(server), "Host": host}).status == 403


@pytest.mark.parametrize("origin", ["http://evil.example", "null", "http://127.0.0.1:1"])
def test_another_page_is_refused_with_the_token_too(server: Server, origin: str) -> None:
    assert Answer(server, "/", {"Cookie": cookie(server), "Origin": origin}).status == 403


@pytest.mark.parametrize("host", ["localhost:80", "127.0.0.1:80", "[::1]:80", "192.0.2.7", "robot.example:80"])
def test_names_of_this_host(host: str) -> None:
    assert GATE.check("/", {"host": host, "cookie": "a=b; zsight_80=secret"}, 80) is None


def test_a_cookie_of_another_port_is_none() -> None:
    refusal = GATE.check("/", {"host": "localhost", "cookie": "zsight_81=secret"}, 80)
    assert refusal is not None
    assert refusal.status == 401


def test_a_busy_port_is_an_error_and_not_another_port(server: Server) -> None:
    with (
        pytest.raises(UsageError, match=rf"127\.0\.0\.1:{server.port} \(address already in use\).*--port"),
        open_server(Settings(port=server.port)),
    ):
        pass


def test_the_token_outlives_a_restart_and_is_this_users_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    first = kept_token(8008)
    assert len(first) > 20
    assert kept_token(8008) == first
    assert kept_token(8009) != first
    path = next(tmp_path.glob("*8008*"))
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    path.chmod(0o644)
    with pytest.raises(UsageError, match="can be read by others"):
        kept_token(8008)


def test_no_page_may_be_published_through_a_foreign_host(server: Server) -> None:
    handlers = server.viser._websock_server._incoming_handlers
    assert "ShareUrlRequest" not in {kind.__name__ for kind, entries in handlers.items() if entries}
    assert "frame-ancestors 'none'" in access.SAFETY_HEADERS["Content-Security-Policy"]
