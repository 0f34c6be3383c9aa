"""The page's server over real sockets: admission, refusals, dropped clients."""

import json
import socket
from contextlib import ExitStack, suppress

import httpx
import pytest
import websockets

from ikservo.apps.page.messages.page_messages import MAX_MESSAGE_BYTES
from ikservo.apps.page.server.auth import (
    MAX_PENDING_CONNECTIONS,
    AccessTokens,
    Permission,
    challenge_response,
)
from ikservo.apps.page.server.server import BoundAddress, make_app, serve_in_thread
from ikservo.clock import RealClock
from tests.apps.page.socket_clients import RecordingController, SocketClient, arm_channel
from tests.browser.page_operator import until

PAGES = ["/", "/page/main.js", "/page/style.css"]


@pytest.fixture(scope="module")
def keys():
    return AccessTokens.generate()


@pytest.fixture(scope="module")
def house(keys):
    everybody = RecordingController()
    with serve_in_thread(
        make_app([arm_channel(everybody)], keys, RealClock()), BoundAddress("127.0.0.1", 0)
    ) as url:
        yield everybody, url


@pytest.fixture
def url(house):
    return house[1]


@pytest.fixture
def controller(house):
    house[0].forget()
    return house[0]


@pytest.fixture
def visit(url, controller, request):
    def connect(**options):
        client = SocketClient(url, **options)
        request.addfinalizer(client.close)
        return client

    return connect


def refused_upgrade(url, **options):
    with pytest.raises(websockets.InvalidStatus) as refused:
        SocketClient(url, **options)
    return refused.value.response.status_code


def test_server_delivers_page(url):
    assert "<canvas" in httpx.get(url).text


@pytest.mark.parametrize("path", PAGES)
def test_content_security_policy_excludes_foreign_sources(url, path):
    policy = httpx.get(url + path).headers["content-security-policy"]
    assert "default-src 'none'" in policy
    assert "http" not in policy


def test_refused_websocket_upgrade_is_not_logged(url, caplog):
    refused_upgrade(url, origin="http://evil.example")
    assert not caplog.records


def test_server_does_not_send_cors_header(url):
    assert "access-control-allow-origin" not in httpx.get(url).headers


def test_server_does_not_set_cookies(url):
    assert "set-cookie" not in httpx.get(url).headers


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "PATCH", "OPTIONS"])
@pytest.mark.parametrize("path", ["/", "/page/main.js", "/live"])
def test_server_refuses_http_methods_that_write(url, method, path):
    assert httpx.request(method, url + path).status_code in (404, 405)


NO_PAGES = [
    "/page/", "/page/..%2Fserver.py", "/page/%2Fetc%2Fpasswd", "/server.py", "/page/x.js",
    "/page/%2e%2e/server.py", "/page/main.js%00", "/.git/config",
]  # fmt: skip


@pytest.mark.parametrize("path", NO_PAGES)
def test_server_does_not_serve_files_outside_page(url, path):
    assert httpx.get(url + path).status_code == 404


@pytest.mark.parametrize("path", PAGES)
def test_foreign_host_gets_403_for_every_page(url, path):
    assert httpx.get(url + path, headers={"host": "rebound.example"}).status_code == 403


@pytest.mark.parametrize("origin", ["http://evil.example", "null", "http://127.0.0.1:1"])
def test_client_of_foreign_origin_does_not_get_websocket(url, controller, origin):
    assert refused_upgrade(url, origin=origin) == 403
    assert not controller.rights


def test_client_without_origin_does_not_get_websocket(url):
    assert refused_upgrade(url, origin=None) == 403


def test_access_key_in_cookie_does_not_open_websocket(url, keys, visit):
    client = visit(additional_headers={"cookie": f"token={keys.control}"})
    client.send("{}")
    assert client.closing_code() == 4401


def test_client_with_control_key_gets_control(visit, controller, keys):
    visit().prove(keys.control).receive_kind("scene")
    assert controller.rights == [Permission.CONTROL]


def test_scene_updates_contain_only_changed_fields(visit, controller, keys):
    controller.show = [{"kind": "cross", "at": [1.0, 2.0]}]
    client = visit().prove(keys.control)
    scene = client.receive_kind("scene")
    assert scene["items"] == controller.show
    client.send_message("heartbeat", scene["seq"], visible=True)
    scene = client.receive_kind("scene")
    assert set(scene) == {"kind", "seq"}
    controller.show = []
    while "items" not in scene:
        client.send_message("heartbeat", scene["seq"], visible=True)
        scene = client.receive_kind("scene")
    assert scene["items"] == []


def test_client_with_watch_key_may_only_watch(visit, controller, keys):
    visit().prove(keys.watch).receive_kind("scene")
    assert controller.rights == [Permission.WATCH]


@pytest.mark.parametrize("hello", [
    "{}", "", '{"kind":"stop","seq":1,"seen":0}', '{"kind":"hello"}', '{"kind":"hello","proof":""}',
    '{"kind":"hello","proof":"' + "0" * 64 + '"}', "x" * MAX_MESSAGE_BYTES,
])  # fmt: skip
def test_client_without_key_proof_is_disconnected(visit, controller, hello):
    client = visit()
    client.send(hello)
    assert client.closing_code() == 4401
    assert not controller.rights


def test_key_of_another_session_is_refused(visit, controller):
    assert visit().prove(AccessTokens.generate().control).closing_code() == 4401
    assert not controller.rights


def test_key_proof_of_another_connection_is_refused(visit, keys, controller):
    overheard = challenge_response(keys.control, visit().nonce)
    client = visit()
    client.send(json.dumps({"kind": "hello", "proof": overheard}))
    assert client.closing_code() == 4401
    assert not controller.rights


def test_valid_message_is_received_and_unknown_one_refused(visit, controller, keys):
    client = visit().prove(keys.control)
    scene = client.receive_kind("scene")["seq"]
    client.send_message("stop", scene)
    client.send_message("fly", scene)
    client.receive_kind("refused")
    assert [message.kind for message in controller.received] == ["stop"]


def test_a_replayed_message_is_refused_and_not_received_again(visit, controller, keys):
    client = visit().prove(keys.control)
    client.send_message("stop")
    client.seq -= 1
    client.send_message("stop")
    assert "was received before" in client.receive_kind("refused")["message"]
    assert len(controller.received) == 1


def test_oversized_message_is_refused(visit, controller, keys):
    client = visit().prove(keys.control)
    client.send_message("stop", pad="x" * MAX_MESSAGE_BYTES)
    assert "too long" in client.receive_kind("refused")["message"]
    assert not controller.received


@pytest.mark.parametrize("size", [5 * MAX_MESSAGE_BYTES, 2_000_000])
def test_huge_page_message_ends_connection_without_being_read(visit, controller, keys, size):
    client = visit().prove(keys.control)
    with suppress(websockets.ConnectionClosed):  # before all of it was sent
        client.send_message("stop", pad="x" * size)
    assert client.closing_code() in (1009, 1006)  # told why, or cut off in mid-sentence
    assert not controller.received


def test_binary_message_ends_connection(visit, keys):
    client = visit().prove(keys.control)
    client.send(b"\x00\x01")
    assert client.closing_code() == 1008


def test_message_flood_ends_connection(visit, keys):
    client = visit().prove(keys.control)
    with suppress(websockets.ConnectionClosed):
        for _ in range(5_000):
            client.send_message("stop")
    assert client.closing_code() == 1008


def test_next_scene_waits_for_heartbeat_of_page(visit, keys):
    client = visit().prove(keys.control)
    numbers = [client.receive_kind("scene")["seq"], client.receive_kind("scene")["seq"]]
    client.send_message("heartbeat", numbers[-1], visible=True)
    assert [*numbers, client.receive_kind("scene")["seq"]] == [1, 2, 3]


def test_disconnected_client_is_removed_from_server(visit, controller, keys, url):
    client = SocketClient(url).prove(keys.control)
    client.receive_kind("scene")
    client.close()
    visit().prove(keys.watch).receive_kind("scene")
    until(lambda: controller.present == {2}, lambda: controller.present)


@pytest.mark.parametrize(("full", "free"), [("watch", "control"), ("control", "watch")])
def test_sixteen_clients_of_one_key_do_not_block_other_key(visit, keys, full, free):
    for _ in range(16):
        visit().prove(getattr(keys, full)).receive_kind("scene")
    assert visit().prove(getattr(keys, full)).closing_code() == 1013
    assert visit().prove(getattr(keys, free)).receive_kind("scene")


def test_unauthenticated_clients_do_not_lock_out_key_holder(visit, keys):
    strangers = [visit() for _ in range(16)]
    visit().prove(keys.control).receive_kind("scene")
    assert strangers[0].closing_code() == 1013


def test_two_hundred_idle_sockets_do_not_lock_out_client(url, visit, keys):
    with ExitStack() as open_sockets:
        idle_sockets(open_sockets, url, 200)
        client = visit().prove(keys.control)
        for _ in range(20):
            client.send_message("heartbeat", client.receive_kind("scene")["seq"], visible=True)


def test_only_latest_idle_sockets_stay_open(url):
    with ExitStack() as open_sockets:
        waiting = idle_sockets(open_sockets, url, 3 * MAX_PENDING_CONNECTIONS)
        httpx.get(url)  # the server has met them all
        assert sum(map(is_open, waiting)) < MAX_PENDING_CONNECTIONS


@pytest.mark.campaign  # it takes three seconds
def test_unfinished_http_request_is_dropped(url):
    with ExitStack() as open_sockets:
        (waiting,) = idle_sockets(open_sockets, url, 1)
        waiting.settimeout(10)
        with suppress(ConnectionError):
            assert waiting.recv(1) == b""


def idle_sockets(stack, url, count):
    """Open sockets that send nothing, or too little."""
    host, port = url.removeprefix("http://").split(":")
    waiting = []
    for i in range(count):
        waiting.append(stack.enter_context(socket.create_connection((host, int(port)))))
        with suppress(ConnectionError):
            waiting[-1].send(b"G" * (i % 2))
    return waiting


def is_open(waiting):
    waiting.setblocking(False)
    try:
        return waiting.recv(1) != b""
    except BlockingIOError:
        return True
    except ConnectionError:
        return False


def test_listen_address_in_use_is_reported(url):
    from ikservo.errors import PortError

    port = int(url.rpartition(":")[2])
    with pytest.raises(PortError, match="cannot be served"):
        BoundAddress("127.0.0.1", port)


def test_page_takes_next_port_if_usual_one_is_in_use(monkeypatch):
    with socket.create_server(("127.0.0.1", 0)) as other:
        taken = other.getsockname()[1]
        monkeypatch.setattr("ikservo.apps.page.server.server.USUAL_PORT", taken)
        monkeypatch.setattr(
            "ikservo.apps.page.server.server._USUAL_PORTS", range(taken, taken + 20)
        )
        page = BoundAddress("127.0.0.1", None)
        with page.socket:
            assert taken < int(page.url.rpartition(":")[2]) < taken + 20
            assert page.is_unusual
