"""Keys, hosts and origins: who is admitted, decided without a network."""

import pytest

from ikservo.apps.page.page_app import ViewApp
from ikservo.apps.page.served_arms import ArmAtPort
from ikservo.apps.page.server.auth import (
    AccessTokens,
    Permission,
    challenge_response,
    is_allowed_origin,
    new_nonce,
)
from ikservo.errors import BadValueError
from ikservo.model import load_model

LOCAL = ("127.0.0.1", 8420)

OWN_HOSTS = ["127.0.0.1:8420", "localhost:8420", "[::1]:8420", "LOCALHOST:8420"]

FOREIGN_HOSTS = [
    "", "evil.example", "evil.example:8420", "127.0.0.1", "127.0.0.1:80", "127.0.0.1:8421",
    "127.0.0.1.evil.example:8420", "localhost.evil.example:8420", "evil-localhost:8420",
    "127.0.0.2:8420", "127.1:8420", "2130706433:8420", "0x7f000001:8420", "0177.0.0.1:8420",
    "0.0.0.0:8420", "[::]:8420", "[::ffff:127.0.0.1]:8420", "[0:0:0:0:0:0:0:1]:8420",
    "192.168.0.2:8420", "localhost.:8420", "127.0.0.1:8420:8420", "user@127.0.0.1:8420",
    "127.0.0.1:8420/", " 127.0.0.1:8420", "rebound.example:8420",
]  # fmt: skip

FOREIGN_ORIGINS = [
    "null", "", "http://evil.example", "http://evil.example:8420", "https://127.0.0.1:8420",
    "http://127.0.0.1", "http://127.0.0.1:8421", "http://localhost:8420",
    "http://127.0.0.1:8420.evil.example", "http://127.0.0.1:8420/", "file://", "ws://127.0.0.1:8420",
    "http://[::1]:8420", "http://2130706433:8420", "http://user@127.0.0.1:8420",
    "HTTP://127.0.0.1:8420", "http://127.0.0.1:8420 http://evil.example",
    "chrome-extension://abcdef", "http://0.0.0.0:8420", "http://127.0.0.1:08420",
]  # fmt: skip


def server(host="127.0.0.1:8420", origin=None, *, upgrade=True, local=LOCAL, **more):
    headers = [(b"host", host.encode())]
    if origin is not None:
        headers.append((b"origin", origin.encode()))
    headers += [(name.replace("_", "-").encode(), value.encode()) for name, value in more.items()]
    return is_allowed_origin(headers, local, upgrade=upgrade)


@pytest.mark.parametrize("host", OWN_HOSTS)
def test_page_is_accepted_under_every_loopback_name(host):
    assert server(host, f"http://{host.lower()}")


def test_foreign_host_is_refused_even_with_matching_origin():
    assert [host for host in FOREIGN_HOSTS if server(host, f"http://{host}")] == []


def test_foreign_host_may_not_read_page():
    assert [host for host in FOREIGN_HOSTS if server(host, upgrade=False)] == []


def test_websocket_of_foreign_origin_is_refused():
    assert [origin for origin in FOREIGN_ORIGINS if server(origin=origin)] == []


def test_foreign_origin_may_not_fetch_page():
    assert [origin for origin in FOREIGN_ORIGINS if server(origin=origin, upgrade=False)] == []


def test_websocket_without_origin_is_refused():
    assert not server(origin=None)


def test_page_can_be_opened_without_origin():
    assert server(upgrade=False)


def test_link_from_other_site_may_open_page():
    assert server(upgrade=False, sec_fetch_site="cross-site", sec_fetch_mode="navigate",
                sec_fetch_dest="document")  # fmt: skip


@pytest.mark.parametrize("site", ["cross-site", "same-site"])
def test_other_site_may_not_embed_scripts_of_page(site):
    assert not server(upgrade=False, sec_fetch_site=site, sec_fetch_mode="no-cors",
                    sec_fetch_dest="script")  # fmt: skip


def test_other_site_may_not_show_page_in_frame():
    assert not server(upgrade=False, sec_fetch_site="cross-site", sec_fetch_mode="navigate",
                    sec_fetch_dest="iframe")  # fmt: skip


@pytest.mark.parametrize("name", [b"host", b"origin"])
def test_repeated_header_is_refused(name):
    headers = [(b"host", b"127.0.0.1:8420"), (b"origin", b"http://127.0.0.1:8420")]
    assert not is_allowed_origin([*headers, (name, b"127.0.0.1:8420")], LOCAL, upgrade=True)


def test_listening_address_is_the_only_allowed_host():
    local = ("192.168.0.7", 8420)
    assert server("192.168.0.7:8420", "http://192.168.0.7:8420", local=local)
    assert not server("localhost:8420", "http://localhost:8420", local=local)


@pytest.mark.parametrize("listen", ["0.0.0.0", "::", "evil.example", "", "127.0.0.1:80"])
def test_listen_address_must_be_one_specific_address(listen):
    with pytest.raises(BadValueError, match="--listen"):
        ViewApp([ArmAtPort(load_model("planar2"), "sim")], listen)


def test_each_access_key_gives_its_own_permission():
    keys, nonce = AccessTokens.generate(), new_nonce()
    assert keys.authorise(nonce, challenge_response(keys.control, nonce)) is Permission.CONTROL
    assert keys.authorise(nonce, challenge_response(keys.watch, nonce)) is Permission.WATCH


@pytest.mark.parametrize("shown", ["", "0" * 64, "ü" * 64])
def test_wrong_key_proof_does_not_give_permission(shown):
    assert AccessTokens.generate().authorise(new_nonce(), shown) is None


def test_proof_for_another_nonce_does_not_give_permission():
    keys = AccessTokens.generate()
    assert keys.authorise(new_nonce(), challenge_response(keys.control, new_nonce())) is None


def test_keys_have_at_least_128_bits():
    assert len(AccessTokens.generate().control) * 6 >= 128


def test_access_keys_of_two_sessions_differ():
    assert AccessTokens.generate() != AccessTokens.generate()
