"""A small certificate authority: a certificate for each host, from an issuer of its own, so that each can be revoked.

Zenoh knows no revocation lists. So every host's certificate is signed by an issuer that signs nothing else and whose
key is thrown away; hosts trust the authority, and the router trusts the issuers of the hosts that are welcome. To
revoke a host is to take its issuer off that list: its certificate is refused from then on as if nobody had signed it.
"""

from __future__ import annotations

import ipaddress
import json
import os
import shutil
from dataclasses import asdict, dataclass
from datetime import UTC, datetime, timedelta
from typing import TYPE_CHECKING

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from zsight.errors import UsageError
from zsight.keys.identity import CA, CERTIFICATE, HOSTS, IDENTITY, KEY, TRUSTED, Identity, read_hosts, write_hosts
from zsight.keys.roles import require_roles
from zsight_core.files.atomic_file import atomic_file
from zsight_protocol.channels import require_name

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

__all__ = ["Authority", "expiry", "name_in"]

_AUTHORITY_KEY = "ca.key"
_ISSUERS = "issuers"
_AUTHORITY_DAYS = 3650
_EARLIER = timedelta(minutes=5)  # hosts' clocks may be behind
_BOTH_ENDS = (ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH)
_HOST_END = (ExtendedKeyUsageOID.CLIENT_AUTH,)
ROUTER = "router"


@dataclass(frozen=True)
class _Signed:
    certificate: x509.Certificate
    key: ec.EllipticCurvePrivateKey


class Authority:
    """The folder of an authority: its key, and a folder for the router and for each host."""

    def __init__(self, folder: Path) -> None:
        """Args: folder, made by ``init``."""
        self.folder = folder

    def init(self, router: Sequence[str], *, days: int, cell: str) -> Path:
        """Make the authority and its router's folder.

        Args:
            router: names and addresses by which hosts reach the router.
            days: how long the router's certificate is good.
            cell: namespace of the cell.

        Raises:
            UsageError: there is an authority already.
        """
        if (self.folder / _AUTHORITY_KEY).exists():
            raise UsageError(f"{self.folder} is an authority already: add hosts with: zsight keys add HOST")
        self.folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        made = _sign("zsight authority", None, days=_AUTHORITY_DAYS, path_length=1)
        _write(self.folder / CA, _pem(made.certificate))
        _write_secret(self.folder / _AUTHORITY_KEY, _key_pem(made.key))
        (self.folder / _ISSUERS).mkdir(exist_ok=True)
        return self.add(ROUTER, [ROUTER], names=[*router, "localhost", "127.0.0.1"], days=days, cells=[cell])

    def add(
        self, host: str, roles: Sequence[str], *, names: Sequence[str] = (), days: int, cells: Sequence[str]
    ) -> Path:
        """Make a host's folder, and let the router know it.

        Raises:
            UsageError: there is no authority, the host is known, or a role is not.
            KeyNameError: the host cannot stand in a key.
        """
        identity = Identity(
            require_name(host, "host"), require_roles(roles), tuple(require_name(c, "namespace") for c in cells)
        )
        authority = self._load()
        place = self.folder / host
        if place.exists():
            raise UsageError(f"{host} has keys in {place}: revoke them first with: zsight keys revoke {host}")
        issuer = _sign(f"zsight issuer of {host}", authority, days=_AUTHORITY_DAYS, path_length=0)
        end = _BOTH_ENDS if ROUTER in identity.roles else _HOST_END
        own = _sign(host, issuer, days=days, names=[*names, host], usage=end)
        place.mkdir(mode=0o700)
        _write(place / CA, _pem(authority.certificate))
        _write(place / CERTIFICATE, _pem(own.certificate) + _pem(issuer.certificate))
        _write_secret(place / KEY, _key_pem(own.key))
        _write(place / IDENTITY, json.dumps(asdict(identity), indent=1).encode() + b"\n")
        _write(self.folder / _ISSUERS / f"{host}.pem", _pem(issuer.certificate))
        self._tell_router([*self.hosts(), identity])
        return place

    def revoke(self, host: str) -> None:
        """Let the router refuse a host's certificate from now on; its folder here is removed.

        Raises:
            UsageError: the host is not known.
        """
        issuer = self.folder / _ISSUERS / f"{require_name(host, 'host')}.pem"
        if not issuer.exists() or host == ROUTER:
            known = ", ".join(identity.host for identity in self.hosts() if identity.host != ROUTER)
            raise UsageError(f"no host is called {host}; known are {known or 'none'}")
        issuer.unlink()
        shutil.rmtree(self.folder / host, ignore_errors=True)
        self._tell_router([identity for identity in self.hosts() if identity.host != host])

    def hosts(self) -> list[Identity]:
        """All hosts that are welcome, the router among them.

        Raises:
            UsageError: there is no authority.
        """
        self._load()
        return read_hosts(self._router) if (self._router / HOSTS).exists() else []

    @property
    def _router(self) -> Path:
        return self.folder / ROUTER

    def _load(self) -> _Signed:
        try:
            certificate = x509.load_pem_x509_certificate((self.folder / CA).read_bytes())
            key = serialization.load_pem_private_key((self.folder / _AUTHORITY_KEY).read_bytes(), None)
        except (OSError, ValueError) as error:
            raise UsageError(f"no authority in {self.folder} ({error}): make one with: zsight keys init") from None
        if not isinstance(key, ec.EllipticCurvePrivateKey):
            raise UsageError(f"the key in {self.folder} is not an elliptic curve's: make an authority anew")
        return _Signed(certificate, key)

    def _tell_router(self, hosts: list[Identity]) -> None:
        """Both lists, each whole or not at all; the router looks at them again when they change."""
        issuers = b"".join((self.folder / _ISSUERS / f"{identity.host}.pem").read_bytes() for identity in hosts)
        _write(self._router / TRUSTED, issuers)
        write_hosts(self._router / HOSTS, hosts)


def expiry(certificate: Path) -> datetime:
    """When a certificate's time is over.

    Raises:
        UsageError: the file is none.
    """
    try:
        return x509.load_pem_x509_certificate(certificate.read_bytes()).not_valid_after_utc
    except (OSError, ValueError) as error:
        raise UsageError(f"{certificate} is no certificate: {error}") from None


def name_in(certificate: Path) -> str:
    """Whose certificate it is.

    Raises:
        UsageError: the file is none.
    """
    try:
        subject = x509.load_pem_x509_certificate(certificate.read_bytes()).subject
    except (OSError, ValueError) as error:
        raise UsageError(f"{certificate} is no certificate: {error}") from None
    return str(subject.get_attributes_for_oid(NameOID.COMMON_NAME)[0].value)


def _sign(
    name: str,
    issuer: _Signed | None,
    *,
    days: int,
    path_length: int | None = None,
    names: Sequence[str] = (),
    usage: Sequence[x509.ObjectIdentifier] = (),
) -> _Signed:
    """A certificate and its key; without an issuer it signs itself."""
    key = ec.generate_private_key(ec.SECP256R1())
    now = datetime.now(UTC)
    builder = (
        x509.CertificateBuilder()
        .subject_name(_named(name))
        .issuer_name(issuer.certificate.subject if issuer else _named(name))
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(min(now, now + timedelta(days=days)) - _EARLIER)
        .not_valid_after(now + timedelta(days=days))
        .add_extension(x509.BasicConstraints(path_length is not None, path_length), critical=True)
    )
    if names:
        builder = builder.add_extension(
            x509.SubjectAlternativeName([_general(entry) for entry in names]), critical=False
        )
    if usage:
        builder = builder.add_extension(x509.ExtendedKeyUsage(usage), critical=False)
    return _Signed(builder.sign(issuer.key if issuer else key, hashes.SHA256()), key)


def _named(name: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])


def _general(name: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(name))
    except ValueError:
        return x509.DNSName(name)


def _pem(certificate: x509.Certificate) -> bytes:
    return certificate.public_bytes(serialization.Encoding.PEM)


def _key_pem(key: ec.EllipticCurvePrivateKey) -> bytes:
    plain = serialization.NoEncryption()
    return key.private_bytes(serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, plain)


def _write(path: Path, content: bytes) -> None:
    with atomic_file(path, overwrite=True) as file:
        file.write(content)


def _write_secret(path: Path, content: bytes) -> None:
    """A file that only its owner reads, from the moment it is there."""
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    with os.fdopen(descriptor, "wb") as file:
        file.write(content)
