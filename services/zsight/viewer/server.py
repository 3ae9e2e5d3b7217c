"""The web server of the page: viser's, behind the gate, on a port that is ours."""

from __future__ import annotations

import contextlib
import io
import secrets
import socket
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any
from unittest import mock

import viser
from viser import _messages
from websockets.asyncio import server as websockets_server
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

from zsight.errors import UsageError
from zsight.viewer.access import SAFETY_HEADERS, Gate, Refusal, kept_token

if TYPE_CHECKING:
    from collections.abc import Iterator

    from zsight.viewer.settings import Settings

__all__ = ["Server", "open_server", "set_value"]


@dataclass(frozen=True)
class Server:
    """A running page: viser's handles, and the link that opens it."""

    viser: viser.ViserServer
    port: int
    link: str


@contextlib.contextmanager
def open_server(settings: Settings) -> Iterator[Server]:
    """Serve the page until the end of the block.

    Raises:
        UsageError: the port is taken, or the address is not this host's.
    """
    listener = _listen(settings.host, settings.port)
    port: int = listener.getsockname()[1]
    token = settings.token or (kept_token(port) if settings.port else secrets.token_urlsafe(24))
    gate = Gate(token, tuple(name.strip().lower() for name in settings.names.split(",") if name.strip()))
    with _behind(gate, listener, port), contextlib.redirect_stdout(io.StringIO()):
        page = viser.ViserServer(host=settings.host, port=port, label="zsight", verbose=False)
    # The button for it is not shown, but a message would be enough to publish the page through a foreign host.
    for message in (_messages.ShareUrlRequest, _messages.ShareUrlDisconnect):
        page._websock_server.unregister_handler(message)  # noqa: SLF001  viser offers no switch
    host = f"[{settings.host}]" if ":" in settings.host else settings.host
    try:
        yield Server(page, port, f"http://{host}:{port}/?token={gate.token}")
    finally:
        with contextlib.redirect_stdout(io.StringIO()):
            page.stop()
        listener.close()


def set_value(handle: Any, value: Any) -> None:
    """Set what an input of the page shows; viser's setter is one that type checkers take for missing."""
    handle.value = value


def _listen(host: str, port: int) -> socket.socket:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    listener = socket.socket(family, socket.SOCK_STREAM)
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind((host, port))
        listener.listen(16)
    except OSError as error:
        listener.close()
        words = f"cannot serve the page on {host}:{port} ({error.strerror.lower() if error.strerror else error})"
        raise UsageError(f"{words}: is a viewer running there? Give another --port") from None
    return listener


@contextlib.contextmanager
def _behind(gate: Gate, listener: socket.socket, port: int) -> Iterator[None]:
    """While viser starts: its server listens on our socket, and every request passes the gate first.

    viser has no seam for either; left alone it takes the next port where one is busy, and lets everybody in.
    """
    serve = websockets_server.serve

    def guarded(handler: Any, _host: str, _port: int, **options: Any) -> Any:
        options["process_request"] = _gated(gate, port, options["process_request"])
        return serve(handler, sock=listener, **options)

    with mock.patch.object(websockets_server, "serve", guarded):
        yield


def _gated(gate: Gate, port: int, answer: Any) -> Any:
    def process_request(connection: websockets_server.ServerConnection, request: Request) -> Response | None:
        headers = {name.lower(): value for name, value in request.headers.raw_items()}
        refusal = gate.check(request.path, headers, port)
        if refusal is not None:
            return _response(refusal)
        response: Response | None = answer(connection, request)
        if response is not None:
            response.headers.update(SAFETY_HEADERS)
        return response

    return process_request


def _response(refusal: Refusal) -> Response:
    body = refusal.words.encode()
    headers = Headers([("Content-Type", "text/plain; charset=utf-8"), ("Content-Length", str(len(body)))])
    headers.update(SAFETY_HEADERS)
    for name, value in refusal.headers:
        headers[name] = value
    return Response(refusal.status.value, refusal.status.phrase, headers, body)
