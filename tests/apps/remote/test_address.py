"""Addresses of arms on other machines, and addresses at which they may be served."""

import pytest

from ikservo.apps.remote.address import Endpoint, parse_address, parse_listen
from ikservo.errors import BadValueError, InputError


@pytest.mark.parametrize(
    ("text", "name", "endpoint"),
    [
        ("zenoh:desk@lab-pi", "desk", "tls/lab-pi:7448"),
        ("zenoh:desk@lab-pi.local:9000", "desk", "tls/lab-pi.local:9000"),
        ("zenoh:so_101@127.0.0.1", "so_101", "tcp/127.0.0.1:7448"),
        ("zenoh:desk@localhost:7000", "desk", "tcp/localhost:7000"),
        ("zenoh:desk@[::1]:7000", "desk", "tcp/[::1]:7000"),
        ("zenoh:desk@[fd00::2]", "desk", "tls/[fd00::2]:7448"),
        ("zenoh:desk@tls/127.0.0.1", "desk", "tls/127.0.0.1:7448"),
    ],
)
def test_remote_address_names_arm_and_endpoint(text, name, endpoint):
    address = parse_address(text)
    assert (address.name, str(address.endpoint)) == (name, endpoint)
    assert parse_address(str(address)) == address


@pytest.mark.parametrize(
    "text",
    ["zenoh:", "zenoh:desk", "zenoh:@lab-pi", "zenoh:desk@", "zenoh:a/b@lab-pi", "zenoh:*@lab-pi",
     "zenoh:desk@lab-pi:99999", "zenoh:desk@lab-pi:0", "zenoh:desk@lab pi", "zenoh:desk@lab-pi:x",
     "desk@lab-pi", "zenoh:desk@udp/lab-pi", "zenoh:desk@lab-pi;x=1",
     "zenoh:" + "a" * 65 + "@lab-pi"],
)  # fmt: skip
def test_invalid_address_is_refused_with_expected_form(text):
    with pytest.raises(BadValueError, match="Expected "):
        parse_address(text)


def test_serving_on_network_address_needs_certificates():
    assert parse_listen("tcp/127.0.0.1:7448") == Endpoint("tcp", "127.0.0.1", 7448)
    assert parse_listen("tls/0.0.0.0:7448") == Endpoint("tls", "0.0.0.0", 7448)
    with pytest.raises(InputError, match="ikservo net keys"):
        parse_listen("tcp/0.0.0.0:7448")


def test_listen_port_0_is_refused():
    with pytest.raises(BadValueError, match="Expected "):
        parse_listen("tcp/127.0.0.1:0")
