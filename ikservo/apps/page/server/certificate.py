"""The self-signed certificate of the page, made once and kept in the user's folder."""

from __future__ import annotations

import ipaddress
import os
import socket
import ssl
import stat
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import NameOID

from ikservo.errors import IkservoError, InputError
from ikservo.files.reading import config_dir
from ikservo.files.writing import write_atomic

_FILE_NAME = "view-certificate.pem"
_VALID_DAYS = 3650
_OTHERS = stat.S_IRWXG | stat.S_IRWXO


class CertificateError(InputError):
    """The stored certificate cannot be used."""

    def __init__(self, path: Path, why: str) -> None:
        super().__init__(
            f"The certificate of the page in {path} cannot be used: {why}.",
            "Delete the file: the next start makes a new one, with another fingerprint.",
        )


@dataclass(frozen=True, slots=True)
class PageCertificate:
    """A certificate with its private key.

    Attributes:
        path: The PEM file with certificate and key.
        fingerprint: SHA-256 of the certificate as browsers show it: pairs of hex digits.
        is_new: Whether the certificate was just made.
    """

    path: Path
    fingerprint: str
    is_new: bool = False


def load_or_make_certificate(address: str, folder: Path | None = None) -> PageCertificate:
    """Load the stored certificate, or make one if there is none.

    A browser that has accepted the certificate recognises it by its fingerprint, so the certificate
    is kept even when the machine's address changes. A new certificate is valid for ``address``; the
    default folder is the user's own.

    Raises:
        CertificateError: The stored certificate is damaged, expired, or readable by others.
        FileWriteError: A new certificate cannot be written.
    """
    path = (folder or config_dir()) / _FILE_NAME
    is_new = not path.exists()
    if is_new:
        write_atomic(path, _make_pem(address), private=True)
    return PageCertificate(path, _checked_fingerprint(path), is_new)


def _make_pem(address: str) -> str:
    """Make a new private key (P-256) and its certificate (RFC 5280)."""
    key = ec.generate_private_key(ec.SECP256R1())
    name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "ikservo view")])
    now, host = datetime.now(UTC), socket.gethostname()
    ips = dict.fromkeys((address.partition("%")[0], "127.0.0.1", "::1"))
    names: list[x509.GeneralName] = [x509.IPAddress(ipaddress.ip_address(ip)) for ip in ips]
    names += [x509.DNSName(each) for each in (host, "localhost") if each.isascii()]
    certificate = (
        x509.CertificateBuilder()
        .subject_name(name)
        .issuer_name(name)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - timedelta(days=1))  # clocks of other machines may be slow
        .not_valid_after(now + timedelta(days=_VALID_DAYS))
        .add_extension(x509.SubjectAlternativeName(names), critical=False)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .sign(key, hashes.SHA256())
    )
    private = key.private_bytes(
        serialization.Encoding.PEM,
        serialization.PrivateFormat.PKCS8,
        serialization.NoEncryption(),
    )
    return (private + certificate.public_bytes(serialization.Encoding.PEM)).decode("ascii")


def _checked_fingerprint(path: Path) -> str:
    """Return the fingerprint of a stored certificate."""
    try:
        if os.name == "posix" and path.stat().st_mode & _OTHERS:
            raise CertificateError(path, "other users can read its key")
        certificate = x509.load_pem_x509_certificate(path.read_bytes())
        ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER).load_cert_chain(path)  # checks the key, too
    except IkservoError:
        raise
    except ssl.SSLError as error:
        why = "it holds no private key that matches the certificate"
        raise CertificateError(path, why) from error
    except OSError as error:
        raise CertificateError(path, error.strerror or "it cannot be read") from error
    except ValueError as error:
        raise CertificateError(path, "it holds no certificate") from error
    if certificate.not_valid_after_utc < datetime.now(UTC):
        raise CertificateError(path, f"it expired on {certificate.not_valid_after_utc:%Y-%m-%d}")
    return certificate.fingerprint(hashes.SHA256()).hex(":").upper()
