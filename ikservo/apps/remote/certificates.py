"""Certificates that the user's own authority issues, and their permissions."""

from __future__ import annotations

import datetime
import ipaddress
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from ikservo.apps.remote import key_expressions as keys
from ikservo.apps.remote.address import Endpoint, check_host
from ikservo.apps.remote.zenoh_session import Certificate
from ikservo.errors import IkservoError, InputError
from ikservo.files.reading import config_dir
from ikservo.files.writing import write_all_atomic
from ikservo.remedies import install_command

if TYPE_CHECKING:
    from cryptography import x509
    from cryptography.hazmat.primitives.asymmetric import ec

Role = Literal["server", "operator", "watcher"]
ROLES: tuple[Role, ...] = ("server", "operator", "watcher")
"""Roles of certificates, used as their common names."""

_AUTHORITY = "authority"
_ISSUER = "ikservo authority"
_VARIABLE = "IKSERVO_KEYS"
_DAYS = 825  # longest validity that common TLS libraries accept
_ANYWHERE = ("localhost", "127.0.0.1", "::1")


def keys_folder() -> Path:
    """Return the folder of this machine's certificates: ``IKSERVO_KEYS``, or the default folder."""
    own = os.environ.get(_VARIABLE)
    return Path(own) if own else config_dir() / "keys"


def client_certificate(endpoint: Endpoint) -> Certificate | None:
    """Return this machine's certificate for connections: an operator's, or else a watcher's.

    Raises:
        InputError: TLS needs a certificate, and there is none.
    """
    if endpoint.protocol == "tcp":
        return None
    for role in ("operator", "watcher"):
        found = _find(role)
        if found is not None:
            return found
    raise _missing("an operator or watcher")


def server_certificate(endpoint: Endpoint) -> Certificate | None:
    """Return the certificate with which an arm is served at an endpoint; None without TLS.

    Raises:
        InputError: TLS needs a certificate, and there is none.
    """
    if endpoint.protocol == "tcp":
        return None
    found = _find("server")
    if found is None:
        raise _missing("a server")
    return found


def _find(role: str) -> Certificate | None:
    folder = keys_folder()
    files = Certificate(
        folder / f"{_AUTHORITY}.pem", folder / f"{role}.pem", folder / f"{role}.key"
    )
    return files if files.certificate.exists() and files.key.exists() else None


def _missing(role: str) -> InputError:
    return InputError(
        f"There is no certificate for {role} in {keys_folder()}.",
        "Make certificates once with: ikservo net keys. Then copy the folder for this machine's "
        "role.",
    )


@dataclass(frozen=True, slots=True)
class _Signed:
    certificate: x509.Certificate
    key: ec.EllipticCurvePrivateKey


def make_keys(folder: Path, hosts: Sequence[str], *, overwrite: bool = False) -> list[Path]:
    """Make an authority, and a folder with a certificate for each role; return the folders.

    They are ``authority``, ``server``, ``operator`` and ``watcher``. This machine is always one of
    the server's hosts. Earlier certificates that are overwritten become useless.

    Raises:
        InputError: There are already certificates, or a host is not valid.
        IkservoError: The extra ``net`` is not installed.
        FileWriteError: A file cannot be written; existing certificates are unchanged.
    """
    if (folder / _AUTHORITY).exists() and not overwrite:
        raise InputError(f"{folder} already has certificates.", "Choose another folder.")
    for host in hosts:
        check_host(host)
    if find_spec("cryptography") is None:
        text = "Certificates need the package cryptography, which is not installed."
        raise IkservoError(text, f"Install it: {install_command('net')}")
    authority = _sign(None, _ISSUER, (), datetime.timedelta(days=10 * _DAYS))
    signed = {_AUTHORITY: authority}
    for role in ROLES:
        names = (*_ANYWHERE, *hosts) if role == "server" else ()
        signed[role] = _sign(authority, role, names, datetime.timedelta(days=_DAYS))
    files: dict[Path, bytes] = {}
    for name, own in signed.items():
        files |= _files_of(folder / name, name, own, authority)
    write_all_atomic(files, private=True)
    return [folder / name for name in signed]


def _sign(
    authority: _Signed | None, subject: str, names: Sequence[str], lifetime: datetime.timedelta
) -> _Signed:
    """Return a certificate signed by an authority, or a new authority's self-signed one."""
    from cryptography import x509  # noqa: PLC0415  # from an extra
    from cryptography.hazmat.primitives import hashes  # noqa: PLC0415
    from cryptography.hazmat.primitives.asymmetric import ec  # noqa: PLC0415
    from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID  # noqa: PLC0415

    key, is_authority = ec.generate_private_key(ec.SECP256R1()), authority is None
    end = datetime.datetime.now(datetime.UTC) + lifetime
    start = min(end, datetime.datetime.now(datetime.UTC)) - datetime.timedelta(days=1)
    own, issuer = (
        x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, text)]) for text in (subject, _ISSUER)
    )
    path_length = 0 if is_authority else None
    builder = (
        x509.CertificateBuilder(issuer, own, key.public_key(), x509.random_serial_number())
        .not_valid_before(start)
        .not_valid_after(end)
        .add_extension(x509.BasicConstraints(is_authority, path_length), critical=True)
        .add_extension(_key_usage(signs=is_authority), critical=True)
    )
    if not is_authority:
        usage = ExtendedKeyUsageOID.SERVER_AUTH if names else ExtendedKeyUsageOID.CLIENT_AUTH
        builder = builder.add_extension(x509.ExtendedKeyUsage([usage]), critical=False)
    listed: list[x509.GeneralName] = []
    for name in dict.fromkeys(names):
        try:
            listed.append(x509.IPAddress(ipaddress.ip_address(name)))
        except ValueError:
            listed.append(x509.DNSName(name))
    if listed:
        builder = builder.add_extension(x509.SubjectAlternativeName(listed), critical=False)
    return _Signed(builder.sign(authority.key if authority else key, hashes.SHA256()), key)


def _key_usage(*, signs: bool) -> x509.KeyUsage:
    from cryptography import x509  # noqa: PLC0415

    return x509.KeyUsage(
        digital_signature=not signs,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        key_cert_sign=signs,
        crl_sign=signs,
        encipher_only=False,
        decipher_only=False,
    )


def _files_of(folder: Path, name: str, own: _Signed, authority: _Signed) -> dict[Path, bytes]:
    """Return the files of a role: certificate, private key and the authority's certificate."""
    from cryptography.hazmat.primitives import serialization as forms  # noqa: PLC0415

    pem = forms.Encoding.PEM
    private = own.key.private_bytes(pem, forms.PrivateFormat.PKCS8, forms.NoEncryption())
    return {
        folder / f"{_AUTHORITY}.pem": authority.certificate.public_bytes(pem),
        folder / f"{name}.pem": own.certificate.public_bytes(pem),
        folder / f"{name}.key": private,
    }


def access_control(name: str) -> Mapping[str, object]:
    """Return Zenoh's access control for a served arm; everything that is not listed is refused.

    A watcher may ask for states and stop the arm; an operator may also drive it. Only the server
    may publish states, progress and streams, and answer requests.
    """
    watching = [keys.watch(name, "*"), keys.watch("*", "*"), keys.stop(name), keys.stop("*")]
    driving = [keys.drive(name, "*")]
    news, tokens = [keys.news(name, "*")], [keys.server(name), keys.server("*")]
    rules = (
        ("requests", "query", "ingress", watching),
        ("answers", "reply", "egress", watching),
        ("queryables", "declare_queryable", "egress", watching),
        ("reading", "declare_subscriber", "ingress", news),
        ("news", "put", "egress", news),
        ("presence", "liveliness_query", "ingress", tokens),
        ("served", "liveliness_token", "egress", tokens),
        ("drive", "query", "ingress", driving),
        ("driving", "declare_queryable", "egress", driving),
        ("driven", "reply", "egress", driving),
        ("goals", "put", "ingress", [keys.setpoint(name)]),
        ("taking", "declare_subscriber", "egress", [keys.setpoint(name)]),
        ("alive", "liveliness_token", "ingress", [keys.operator(name, "*")]),
        ("watched", "declare_liveliness_subscriber", "egress", [keys.operator(name, "*")]),
    )
    names = [rule for rule, *_ in rules]
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": [
            {
                "id": rule,
                "permission": "allow",
                "messages": [message],
                "flows": [flow],
                "key_exprs": expressions,
            }
            for rule, message, flow, expressions in rules
        ],
        "subjects": [
            {"id": "operator", "cert_common_names": ["operator"]},
            {"id": "watcher", "cert_common_names": ["watcher"]},
        ],
        "policies": [
            {"rules": names, "subjects": ["operator"]},
            {"rules": names[: names.index("drive")], "subjects": ["watcher"]},
        ],
    }
