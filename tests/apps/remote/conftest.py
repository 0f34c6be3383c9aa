"""Simulated arms that are served in this process, and their clients."""

import contextlib
import socket
import time

import pytest

import ikservo
from ikservo.apps.remote.address import ArmAddress, Endpoint
from ikservo.apps.remote.arm_server import ArmServer
from ikservo.apps.remote.client_connection import Connection
from ikservo.apps.remote.zenoh_session import open_server


@pytest.fixture(autouse=True, scope="module")
def _own_folder(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("IKSERVO_HOME", str(tmp_path_factory.mktemp("home")))
        for name in ("IKSERVO_PORT", "IKSERVO_FLEET", "IKSERVO_KEYS"):
            patch.delenv(name, raising=False)
        yield


def find_free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


TIMEOUT_S = 60.0
"""Long beside any delay of a busy machine: only tests of the timeout wait for it."""


def until(condition, timeout_s=TIMEOUT_S):
    end_s = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < end_s, "it does not happen"
        time.sleep(0.01)


class Served:
    """An arm that is served in this process.

    Attributes:
        arm: The arm beside the server.
        server: The server.
        address: Value for ``--port``.
    """

    def __init__(self, arm, server, endpoint):
        self.arm, self.server = arm, server
        self.port = endpoint.port
        self._address = ArmAddress(server.name, endpoint)
        self.address = str(self._address)

    def open(self, **options):
        return ikservo.open_arm(self.arm.model.name, port=self.address, **options)

    def connect(self):
        return Connection(self._address, None)


@contextlib.contextmanager
def serve(port, arm="so101", name="desk", pose="home"):
    endpoint = Endpoint("tcp", "127.0.0.1", port)
    with (
        open_server(endpoint, None, None) as session,
        ikservo.open_arm(arm, port=f"sim:?pose={pose}") as machine,
        ArmServer(session, machine, name) as server,
    ):
        yield Served(machine, server, endpoint)


@pytest.fixture(scope="module")
def served_once(_own_folder):
    """A served arm after its first motion, which is always slow."""
    with serve(find_free_port()) as it:
        it.server.lease.timeout_s = TIMEOUT_S
        it.arm.pose("home")
        yield it


@pytest.fixture
def served(served_once, monkeypatch):
    """A served arm that holds, without an operator or a stop."""
    monkeypatch.setattr("ikservo.apps.remote.client_connection._MAX_ROUND_TRIP_S", TIMEOUT_S)
    served_once.arm.acknowledge()
    served_once.server.lease.timeout_s = TIMEOUT_S
    yield served_once
    until(lambda: served_once.server.lease.holder is None)  # a client waits 1 s for that


@pytest.fixture(scope="module")
def graph_once(_own_folder):
    port = find_free_port()
    from tests.apps.remote.ros_graph import bridged, router  # packages of its own

    with router(port), bridged(port) as graph:
        graph.arm.pose("home")  # the first motion is slow
        yield graph


@pytest.fixture
def graph(graph_once):
    """The graph, with the arm at rest and not stopped."""
    graph_once.warnings.clear()
    yield graph_once
    graph_once.bridge._driver.put(None)
    graph_once.wait_until_still()
    graph_once.arm.acknowledge()
