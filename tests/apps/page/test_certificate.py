"""For other machines the page is served over TLS, with a certificate that is made once."""

import hashlib
import logging
import os
import resource
import socket
import ssl
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path

import httpx
import pytest
import websockets
from cryptography import x509

from ikservo.apps.page.page_app import ViewApp
from ikservo.apps.page.served_arms import ArmAtPort
from ikservo.apps.page.server import certificate as certificates
from ikservo.apps.page.server.auth import AccessTokens, is_allowed_origin
from ikservo.apps.page.server.certificate import CertificateError, load_or_make_certificate
from ikservo.apps.page.server.server import BoundAddress, make_app, serve_in_thread
from ikservo.clock import RealClock
from ikservo.errors import BadValueError
from ikservo.files.writing import FileWriteError
from ikservo.model import load_model
from tests.apps.page.socket_clients import RecordingController, SocketClient, arm_channel

ADDRESS = "192.168.0.7"


def test_certificate_is_made_once_and_kept(tmp_path):
    first = load_or_make_certificate(ADDRESS, tmp_path / "new")
    again = load_or_make_certificate("10.0.0.1", tmp_path / "new")
    assert (first.is_new, again.is_new) == (True, False)
    assert first.fingerprint == again.fingerprint
    assert first.fingerprint != load_or_make_certificate(ADDRESS, tmp_path).fingerprint


def test_certificate_fingerprint_is_sha256_as_browsers_show_it(tmp_path):
    made = load_or_make_certificate(ADDRESS, tmp_path)
    der = ssl.PEM_cert_to_DER_cert(
        made.path.read_text()[made.path.read_text().index("-----BEGIN CERT") :]
    )
    assert made.fingerprint.replace(":", "").lower() == hashlib.sha256(der).hexdigest()
    assert len(made.fingerprint.split(":")) == 32


def test_certificate_names_are_address_and_this_machine(tmp_path):
    made = load_or_make_certificate("fe80::1%eth0", tmp_path)
    names = x509.load_pem_x509_certificate(made.path.read_bytes()).extensions
    names = names.get_extension_for_class(x509.SubjectAlternativeName).value
    assert {"fe80::1", "127.0.0.1", "::1"} == {
        str(ip) for ip in names.get_values_for_type(x509.IPAddress)
    }
    assert "localhost" in names.get_values_for_type(x509.DNSName)


@pytest.mark.skipif(os.name != "posix", reason="modes of files")
def test_certificate_is_readable_only_by_owner(tmp_path):
    made = load_or_make_certificate(ADDRESS, tmp_path)
    assert made.path.stat().st_mode & 0o777 == 0o600
    made.path.chmod(0o640)
    with pytest.raises(CertificateError, match="other users can read its key"):
        load_or_make_certificate(ADDRESS, tmp_path)


def damage(path, kind):
    text = path.read_text()
    private, public = text[: text.index("-----BEGIN CERT")], text[text.index("-----BEGIN CERT") :]
    other = certificates._make_pem(ADDRESS)
    damaged = {
        "empty": "",
        "garbage": "this is no certificate",
        "without key": public,
        "another key": other[: other.index("-----BEGIN CERT")] + public,
        "cut off": private + public[:200],
    }
    path.write_text(damaged[kind])


@pytest.mark.parametrize("kind", ["empty", "garbage", "without key", "another key", "cut off"])
def test_damaged_certificate_is_reported_and_not_replaced(tmp_path, kind):
    made = load_or_make_certificate(ADDRESS, tmp_path)
    damage(made.path, kind)
    before = made.path.read_bytes()
    with pytest.raises(CertificateError, match="cannot be used: it holds no") as reported:
        load_or_make_certificate(ADDRESS, tmp_path)
    assert "Delete the file" in reported.value.command_hint
    assert made.path.read_bytes() == before


def test_expired_certificate_is_reported(tmp_path, monkeypatch):
    class Later(datetime):
        @classmethod
        def now(cls, tz=UTC):
            return datetime(2099, 1, 1, tzinfo=tz)

    load_or_make_certificate(ADDRESS, tmp_path)
    monkeypatch.setattr(certificates, "datetime", Later)
    with pytest.raises(CertificateError, match="it expired on 20"):
        load_or_make_certificate(ADDRESS, tmp_path)


def test_unwritable_certificate_folder_is_reported(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(FileWriteError, match="cannot be written"):
        load_or_make_certificate(ADDRESS, tmp_path / "file")


@pytest.fixture(scope="module")
def house(tmp_path_factory):
    made = load_or_make_certificate("127.0.0.1", tmp_path_factory.mktemp("certificate"))
    keys = AccessTokens.generate()
    app = make_app([arm_channel(RecordingController())], keys, RealClock())
    with serve_in_thread(app, BoundAddress("127.0.0.1", 0, made)) as url:
        yield url, keys, ssl.create_default_context(cafile=made.path)


def test_page_and_socket_are_served_by_tls(house):
    url, keys, trust = house
    assert url.startswith("https://127.0.0.1:")
    assert "<canvas" in httpx.get(url, verify=trust).text
    client = SocketClient(url, ssl=trust)
    assert client.prove(keys.control).receive_kind("scene")
    client.close()


@pytest.mark.full
@pytest.mark.parametrize("said", [b"", b"\x16\x03\x01\x02\x00\x01"])
def test_unfinished_tls_handshake_is_dropped(house, said):
    host, port = house[0].removeprefix("https://").split(":")
    with socket.create_connection((host, int(port)), timeout=10) as waiting:
        waiting.sendall(said)
        with suppress(ConnectionError):
            assert waiting.recv(1) == b""


def test_clients_in_tls_handshake_hold_bounded_open_files(house):
    host, port = house[0].removeprefix("https://").split(":")
    before = open_files()
    clients = [socket.create_connection((host, int(port)), timeout=10) for _ in range(150)]
    for _ in range(3):  # the last ones have been accepted
        assert httpx.get(house[0], verify=house[2]).status_code == 200
    assert open_files() - before - len(clients) <= 100
    for client in clients:
        client.close()


def open_files():
    return len([*Path("/proc/self/fd").iterdir()])


@pytest.mark.full
def test_failed_tls_handshakes_take_bounded_memory(house):
    host, port = house[0].removeprefix("https://").split(":")
    before_mb = resident_mb()
    for _ in range(600):
        with socket.create_connection((host, int(port)), timeout=10) as client:
            client.sendall(b"\x16\x03\x01\x02\x00\x01")
    assert httpx.get(house[0], verify=house[2]).status_code == 200
    assert resident_mb() - before_mb < 100


def resident_mb():
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * resource.getpagesize() / 2**20


def test_client_that_does_not_send_http_is_not_logged(house):
    assert not logging.getLogger("uvicorn.error").isEnabledFor(logging.WARNING)


def test_page_from_plain_http_does_not_get_socket_over_tls(house):
    url, _, trust = house
    with pytest.raises(websockets.InvalidStatus) as refused:
        SocketClient(url, ssl=trust, origin=url.replace("https", "http"))
    assert refused.value.response.status_code == 403


def test_plain_http_does_not_get_page_from_tls_server(house):
    with pytest.raises(httpx.HTTPError):
        httpx.get(house[0].replace("https", "http"))


def test_https_client_rejects_self_signed_certificate(house):
    with pytest.raises(httpx.ConnectError, match="self-signed"):
        httpx.get(house[0])


@pytest.mark.parametrize(
    ("origin", "secure", "allowed"),
    [("https://192.168.0.7", True, True), ("http://192.168.0.7", True, False),
     ("https://192.168.0.7", False, False)],
)  # fmt: skip
def test_allowed_origin_has_scheme_of_connection(origin, secure, allowed):
    headers = [(b"host", b"192.168.0.7"), (b"origin", origin.encode())]
    local = ("192.168.0.7", 443)
    assert is_allowed_origin(headers, local, upgrade=True, secure=secure) == allowed


@pytest.mark.full
@pytest.mark.parametrize(("listen", "insecure", "scheme"), [
    ("127.0.0.1", False, "http"), ("127.0.0.1", True, "http"), (None, False, "https"),
    (None, True, "http"),
])  # fmt: skip
def test_plain_http_on_other_address_needs_insecure_option(
    listen, insecure, scheme, own_address, tmp_path, monkeypatch
):
    monkeypatch.setenv("IKSERVO_HOME", str(tmp_path))
    app = ViewApp(
        [ArmAtPort(load_model("planar2"), "sim")], listen or own_address, insecure=insecure
    )
    with app as urls:
        assert urls.control.startswith(f"{scheme}://")
        assert bool(urls.fingerprint) == (scheme == "https")
        reported = " ".join(urls.warnings)
    assert ("alter the page" in reported) == (listen is None and insecure)
    assert ("fingerprint" in reported) == (scheme == "https")


def test_invalid_listen_address_does_not_make_certificate(tmp_path, monkeypatch):
    monkeypatch.setenv("IKSERVO_HOME", str(tmp_path))
    with pytest.raises(BadValueError):
        ViewApp([ArmAtPort(load_model("planar2"), "sim")], "evil.example")
    assert not list(tmp_path.iterdir())
