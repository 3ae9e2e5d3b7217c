"""Who may see the page: the one who has its token, asked for by a name of this host, from the page itself."""

from __future__ import annotations

import ipaddress
import os
import secrets
import stat
from dataclasses import dataclass
from http import HTTPStatus
from typing import TYPE_CHECKING
from urllib.parse import parse_qs, urlsplit

from zsight import own_files
from zsight.errors import UsageError

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

__all__ = ["SAFETY_HEADERS", "Gate", "Refusal", "kept_token"]

SAFETY_HEADERS = {
    # The page works for itself alone: whatever it is made to load, the browser asks no other host.
    "Content-Security-Policy": (
        "default-src 'self' 'unsafe-inline' 'unsafe-eval' data: blob:; connect-src 'self' data: blob:; "
        "form-action 'none'; frame-ancestors 'none'"
    ),
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "Cache-Control": "no-store",
}


@dataclass(frozen=True)
class Refusal:
    """An answer that is not the page: why not, or where to go with which cookie."""

    status: HTTPStatus
    words: str
    headers: tuple[tuple[str, str], ...] = ()


@dataclass(frozen=True)
class Gate:
    """What is let in."""

    token: str
    names: tuple[str, ...] = ()

    def check(self, path: str, headers: Mapping[str, str], port: int) -> Refusal | None:
        """Nothing for a request that may go on; keys of the headers in lower case."""
        host = headers.get("host", "")
        if not self._is_own(host):
            return _forbidden(f"asked for by the name {host!r}; expected this host's: give others in the setting names")
        origin = headers.get("origin")
        if origin is not None and urlsplit(origin).netloc.lower() != host.lower():
            return _forbidden(f"a page of {origin} may not use this one")
        url = urlsplit(path)
        given = parse_qs(url.query).get("token", [""])[0]
        if given and self._is_token(given):
            cookie = f"{_cookie_name(port)}={self.token}; HttpOnly; SameSite=Lax; Path=/"
            return Refusal(HTTPStatus.SEE_OTHER, "", (("Location", url.path or "/"), ("Set-Cookie", cookie)))
        if self._is_token(_cookies(headers.get("cookie", "")).get(_cookie_name(port), "")):
            return None
        words = "This page needs its link, with the token in it.\nThe viewer prints it when it starts: zsight view\n"
        return Refusal(HTTPStatus.UNAUTHORIZED, words)

    def _is_token(self, given: str) -> bool:
        return secrets.compare_digest(given.encode(), self.token.encode())

    def _is_own(self, host: str) -> bool:
        """An address cannot be pointed elsewhere by a name server; of names only the known ones are taken."""
        name = urlsplit(f"//{host}").hostname or ""
        if name == "localhost" or name in self.names:
            return True
        try:
            ipaddress.ip_address(name)
        except ValueError:
            return False
        return True


def _forbidden(words: str) -> Refusal:
    return Refusal(HTTPStatus.FORBIDDEN, words + "\n")


def _cookie_name(port: int) -> str:
    return f"zsight_{port}"  # cookies know no ports, and a host may have several viewers


def _cookies(text: str) -> dict[str, str]:
    pairs = (part.partition("=") for part in text.split(";"))
    return {name.strip(): value.strip() for name, _, value in pairs}


def kept_token(port: int) -> str:
    """The token of this user and port: the same after a restart, so that open pages find their way back.

    Raises:
        UsageError: its file is not this user's own.
    """
    path = own_files.folder() / f"zsight-{os.getuid()}-view-{port}.token"
    try:
        handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    except FileExistsError:
        return _read_own(path)
    with os.fdopen(handle, "w", encoding="ascii") as file:
        token = secrets.token_urlsafe(24)
        file.write(token)
    return token


def _read_own(path: Path) -> str:
    with own_files.open_own(path) as file:
        if stat.S_IMODE(os.fstat(file.fileno()).st_mode) & 0o077:
            raise UsageError(f"{path} can be read by others: remove it, or give a token of your own")
        token = file.read().decode("ascii").strip()
    if not token:
        raise UsageError(f"{path} is empty: remove it")
    return token
