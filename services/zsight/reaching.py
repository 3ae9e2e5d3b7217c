"""What happens when a router is called at an endpoint: Zenoh says only that it was not reached."""

from __future__ import annotations

import contextlib
import errno
import socket
import ssl
from pathlib import Path

from zsight.keys.identity import CA, CERTIFICATE, KEY

__all__ = ["trouble_at", "what_happened"]

_PATIENCE = 1.0  # seconds for an answer
_ALERT = 0.2  # seconds that a router's refusal of a certificate takes at most to come behind the handshake

_NO_ROUTER = "somebody answers, but no router that this host may join: does it want keys, tls/...?"
_WORDS = {
    errno.ECONNREFUSED: "refused: the host is there and nobody listens on this port; start a router with: zsight up",
    errno.EHOSTUNREACH: "no route: the host is off, or its cable",
    errno.ENETUNREACH: "no route: this host has no network that leads there",
    errno.ETIMEDOUT: "no answer: the host is off, or something on the way lets nothing through",
    errno.ECONNRESET: "cut off at once: something else than a router, or a router that asks for keys",
}


def what_happened(endpoint: str, keys: str = "") -> str:
    """The endpoint, and what became of a call there.

    Args:
        endpoint: such as tcp/192.0.2.7:7447.
        keys: folder of this host's keys, for tls.
    """
    return f"{endpoint}: {trouble_at(endpoint, keys) or _NO_ROUTER}"


def trouble_at(endpoint: str, keys: str = "") -> str | None:
    """What goes wrong in a call, none where somebody answers."""
    protocol, _, rest = endpoint.partition("/")
    host, _, port = rest.partition("#")[0].partition("?")[0].rpartition(":")
    if protocol not in ("tcp", "tls"):
        return f"{protocol} is not looked at more closely"
    if not port.isdigit():
        return "no port; expected an endpoint such as tcp/192.0.2.7:7447"
    try:
        with socket.create_connection((host.strip("[]"), int(port)), _PATIENCE) as link:
            return _shake_hands(link, host.strip("[]"), keys) if protocol == "tls" else None
    except socket.gaierror:
        return f"no host is called {host}"
    except TimeoutError:
        return f"no answer within {_PATIENCE:g} s: the host is off, or something on the way lets nothing through"
    except OSError as error:
        return _WORDS.get(error.errno or 0, str(error.strerror or error))


def _shake_hands(link: socket.socket, host: str, keys: str) -> str | None:
    if not keys:
        return f"certificate: {_ALERTS['CERTIFICATE_REQUIRED']}"
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    try:
        context.load_verify_locations(Path(keys) / CA)
        context.load_cert_chain(Path(keys) / CERTIFICATE, Path(keys) / KEY)
    except (OSError, ssl.SSLError) as error:
        return f"keys in {keys} cannot be used: {error}"
    try:
        with context.wrap_socket(link, server_hostname=host) as secured:
            secured.settimeout(_ALERT)
            with contextlib.suppress(TimeoutError):
                secured.recv(1)  # a router that refuses this host's certificate says so behind the handshake
    except ssl.SSLCertVerificationError as error:
        return f"certificate: the router's is not good here: {error.verify_message}"
    except ssl.SSLError as error:
        return _refusal(error)
    except ConnectionError:
        return _WORDS[errno.ECONNRESET]
    return None


_ALERTS = {
    "CERTIFICATE_REQUIRED": "it asks for keys: give their folder with ZSIGHT_KEYS or in zsight.toml",
    "UNKNOWN_CA": "it does not trust this host's: it was revoked, or made by another authority",
    "CERTIFICATE_EXPIRED": "this host's time is over: make it anew with zsight keys revoke and add",
    "DECRYPT_ERROR": "it does not trust this host's: it was revoked, or made by another authority",
    "BAD_CERTIFICATE": "it does not take this host's",
}


def _refusal(error: ssl.SSLError) -> str:
    reason = (error.reason or str(error)).upper()
    for alert, words in _ALERTS.items():
        if alert in reason:
            return f"certificate: {words}"
    return f"certificate: {reason.lower().replace('_', ' ')}"
