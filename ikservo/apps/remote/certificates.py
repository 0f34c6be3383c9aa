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
        raise IkservoError(
            "Certificates need the package cryptography, which is not installed.",
            f"Install it: {install_command('net')}",
        )
    authority = _make_authority()
    signed = {_AUTHORITY: authority}
    for role in ROLES:
        names = (*_ANYWHERE, *hosts) if role == "server" else ()
        signed[role] = _sign(authority, role, names, datetime.timedelta(days=_DAYS))
    files: dict[Path, bytes] = {}
    for name, own in signed.items():
        files |= _files_of(folder / name, name, own, authority)
    write_all_atomic(files, private=True)
    return [folder / name for name in signed]


def _make_authority() -> _Signed:
    from cryptography import x509  # noqa: PLC0415  # from an extra
    from cryptography.hazmat.primitives.asymmetric import ec  # noqa: PLC0415

    key = ec.generate_private_key(ec.SECP256R1())
    lifetime = datetime.timedelta(days=10 * _DAYS)
    builder = _builder("ikservo authority", "ikservo authority", key.public_key(), lifetime)
    builder = builder.add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
    builder = builder.add_extension(_key_usage(signs=True), critical=True)
    return _Signed(_signed(builder, key), key)


def _sign(
    authority: _Signed, role: str, names: Sequence[str], lifetime: datetime.timedelta
) -> _Signed:
    """Return a certificate for a role, signed by the authority."""
    from cryptography import x509  # noqa: PLC0415
    from cryptography.hazmat.primitives.asymmetric import ec  # noqa: PLC0415
    from cryptography.x509.oid import ExtendedKeyUsageOID  # noqa: PLC0415

    key = ec.generate_private_key(ec.SECP256R1())
    builder = _builder(role, "ikservo authority", key.public_key(), lifetime)
    builder = builder.add_extension(
        x509.BasicConstraints(ca=False, path_length=None), critical=True
    )
    builder = builder.add_extension(_key_usage(signs=False), critical=True)
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
    return _Signed(_signed(builder, authority.key), key)


def _builder(
    subject: str, issuer: str, public: ec.EllipticCurvePublicKey, lifetime: datetime.timedelta
) -> x509.CertificateBuilder:
    from cryptography import x509  # noqa: PLC0415

    end = datetime.datetime.now(datetime.UTC) + lifetime
    start = min(end, datetime.datetime.now(datetime.UTC)) - datetime.timedelta(days=1)
    return (
        x509.CertificateBuilder()
        .subject_name(_name(subject))
        .issuer_name(_name(issuer))
        .public_key(public)
        .serial_number(x509.random_serial_number())
        .not_valid_before(start)
        .not_valid_after(end)
    )


def _name(text: str) -> x509.Name:
    from cryptography import x509  # noqa: PLC0415
    from cryptography.x509.oid import NameOID  # noqa: PLC0415

    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, text)])


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


def _signed(builder: x509.CertificateBuilder, key: ec.EllipticCurvePrivateKey) -> x509.Certificate:
    from cryptography.hazmat.primitives import hashes  # noqa: PLC0415

    return builder.sign(key, hashes.SHA256())


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
    rules = [
        _rule("requests", ["query"], ["ingress"], watching),
        _rule("answers", ["reply"], ["egress"], watching),
        _rule("queryables", ["declare_queryable"], ["egress"], watching),
        _rule("reading", ["declare_subscriber"], ["ingress"], news),
        _rule("news", ["put"], ["egress"], news),
        _rule("presence", ["liveliness_query"], ["ingress"], tokens),
        _rule("served", ["liveliness_token"], ["egress"], tokens),
        _rule("drive", ["query"], ["ingress"], driving),
        _rule("driving", ["declare_queryable"], ["egress"], driving),
        _rule("driven", ["reply"], ["egress"], driving),
        _rule("goals", ["put"], ["ingress"], [keys.setpoint(name)]),
        _rule("taking", ["declare_subscriber"], ["egress"], [keys.setpoint(name)]),
        _rule("alive", ["liveliness_token"], ["ingress"], [keys.operator(name, "*")]),
        _rule("watched", ["declare_liveliness_subscriber"], ["egress"], [keys.operator(name, "*")]),
    ]
    names = [str(rule["id"]) for rule in rules]
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": [
            {"id": "operator", "cert_common_names": ["operator"]},
            {"id": "watcher", "cert_common_names": ["watcher"]},
        ],
        "policies": [
            {"rules": names, "subjects": ["operator"]},
            {"rules": names[: names.index("drive")], "subjects": ["watcher"]},
        ],
    }


def _rule(
    name: str, messages: Sequence[str], flows: Sequence[str], key_exprs: Sequence[str]
) -> dict[str, object]:
    return {
        "id": name,
        "permission": "allow",
        "messages": list(messages),
        "flows": list(flows),
        "key_exprs": list(key_exprs),
    }
