"""Certificates decide who may do what; refused clients send nothing to the servos."""

import datetime
import socket

import pytest

import ikservo
from ikservo.apps.remote import certificates as making
from ikservo.apps.remote import key_expressions as keys
from ikservo.apps.remote.address import ArmAddress, Endpoint, parse_host
from ikservo.apps.remote.arm_server import ArmServer
from ikservo.apps.remote.client_connection import Connection
from ikservo.apps.remote.services import MOTIONS, STREAMED, WATCH
from ikservo.apps.remote.wire_messages import ServiceRequest, Setpoint, encode, result_of
from ikservo.apps.remote.zenoh_session import Certificate, ask, open_client, open_server
from ikservo.errors import InputError, PortError, RefusedError
from ikservo.files.writing import write_all_atomic
from tests.apps.remote.conftest import find_free_port
from tests.arm.simulated import transport_of

DRIVE = ["lease", "release", "acknowledge", "disable_torque", "execute", "sample_plan", "*", "**",
         "plan", "move", *MOTIONS, *STREAMED]  # fmt: skip
REFUSED = ["foreign", "expired", "self-signed", "server", "none"]
REQUEST = encode(ServiceRequest(schema="ikservo/net/1"))
SETPOINT = encode(Setpoint(schema="ikservo/net/1", lease="ab", number=1, sent_s=0.0,
                           positions={"wrist_roll": 1.0}))  # fmt: skip
PUBLISHED = [keys.setpoint("desk"), keys.setpoint("*"), keys.news("desk", "state"),
             keys.news("desk", "progress"), keys.server("desk"), keys.stop("desk"),
             keys.drive("desk", "move"), "ikservo/desk/**", "**"]  # fmt: skip
DAY = datetime.timedelta(days=1)


def certificate(folder, role, authority=None):
    return Certificate((authority or folder) / "authority.pem", folder / f"{role}.pem",
                       folder / f"{role}.key")  # fmt: skip


@pytest.fixture(scope="module")
def certificates(tmp_path_factory):
    """Certificates by what is valid or wrong about them."""
    folder = tmp_path_factory.mktemp("keys")
    own, foreign = (making._sign(None, "ikservo authority", (), 10 * DAY) for _ in range(2))
    for name, authority, role, lifetime in (
        ("server", own, "server", DAY), ("operator", own, "operator", DAY),
        ("watcher", own, "watcher", DAY), ("guest", own, "guest", DAY),
        ("expired", own, "operator", -DAY / 2), ("foreign", foreign, "operator", DAY),
    ):  # fmt: skip
        names = ("127.0.0.1",) if role == "server" else ()
        signed = making._sign(authority, role, names, lifetime)
        write_all_atomic(making._files_of(folder / name, role, signed, own), private=True)
    write_all_atomic(making._files_of(folder / "self-signed", "operator", foreign, own))
    roles = {"server": "server", "watcher": "watcher", "guest": "guest"}
    names = ("server", "operator", "watcher", "guest", "expired", "foreign", "self-signed")
    return {name: certificate(folder / name, roles.get(name, "operator")) for name in names}


@pytest.fixture
def impatient(monkeypatch):
    """A client with a short time-out, for connections that are refused."""
    monkeypatch.setattr("ikservo.apps.remote.zenoh_session._CONNECT_TIMEOUT_S", 0.7)


class Counted:
    """An arm served with TLS, and the number of packets that its servos received.

    Attributes:
        packets: Number of packets since it was opened.
    """

    def __init__(self, arm, endpoint):
        self.arm, self.endpoint, self.packets = arm, endpoint, 0
        transport = transport_of(arm)
        write = transport.write

        def count(data):
            self.packets += 1
            return write(data)

        transport.write = count

    def connect(self, certificate):
        return Connection(ArmAddress("desk", self.endpoint), certificate)


@pytest.fixture(scope="module")
def served(certificates, _own_folder):
    endpoint = Endpoint("tls", "127.0.0.1", find_free_port())
    with (
        open_server(endpoint, certificates["server"], making.access_control("desk")) as session,
        ikservo.open_arm("so101", port="sim:?pose=home") as arm,
        ArmServer(session, arm, "desk"),
    ):
        arm.enable()
        yield Counted(arm, endpoint)


def test_operator_certificate_permits_motion(served, certificates):
    before = served.packets
    connection = served.connect(certificates["operator"])
    connection.drive("enable")
    assert connection.watch("where").names == served.arm.joint_names
    assert served.packets > before
    connection.close()


def test_watcher_certificate_permits_reading_and_stop(served, certificates):
    connection = served.connect(certificates["watcher"])
    assert connection.watch("where").names == served.arm.joint_names
    assert connection.stop("", "CLIENT").arm == "so101"
    assert served.arm.stop_reason is not None
    served.arm.acknowledge()
    connection.close()


def test_watcher_certificate_does_not_permit_motion(served, certificates):
    connection = served.connect(certificates["watcher"])
    for ask_to_drive in (connection.drive, connection.plan):
        with pytest.raises(RefusedError, match="does not let this machine drive it"):
            ask_to_drive("plan")
    connection.close()


@pytest.mark.parametrize("who", ["watcher", "guest"])
def test_client_without_operator_certificate_cannot_drive_arm(served, certificates, who):
    before = served.packets
    with open_client([served.endpoint], certificates[who]) as session:
        for service in DRIVE:
            assert ask(session, keys.drive("desk", service), REQUEST, 0.2) == []
            assert ask(session, keys.drive("*", service), REQUEST, 0.2) == []
        for key in PUBLISHED:
            session.put(key, SETPOINT)
            session.delete(key)
        with session.liveliness().declare_token(keys.operator("desk", "x")):
            assert ask(session, "**", REQUEST, 0.2) == []
    assert served.packets == before


def test_guest_certificate_can_neither_read_nor_stop_arms(served, certificates):
    before = served.packets
    with open_client([served.endpoint], certificates["guest"]) as session:
        for name in ("desk", "*"):
            for service in (*WATCH, "describe", "health", "clock", "*"):
                assert ask(session, keys.watch(name, service), REQUEST, 0.2) == []
            assert ask(session, keys.stop(name), REQUEST, 0.2) == []
        assert list(session.liveliness().get("**", timeout=0.2)) == []
    assert served.packets == before
    assert served.arm.stop_reason is None


def test_watcher_cannot_take_lease_from_operator(served, certificates):
    operator = served.connect(certificates["operator"])
    operator.drive("enable")
    token = keys.operator("desk", keys.operator_token(operator._lease))
    with open_client([served.endpoint], certificates["watcher"]) as session:
        session.liveliness().declare_token(token).undeclare()
        for key in (keys.setpoint("desk"), keys.drive("desk", "release")):
            session.put(key, SETPOINT)
    operator.drive("acknowledge")  # under the same lease
    operator.close()


@pytest.mark.parametrize("role", ["watcher", "operator"])
def test_client_cannot_impersonate_arm(served, certificates, role):
    asked = []
    with (
        open_client([served.endpoint], certificates[role]) as one,
        open_client([served.endpoint], certificates["operator"]) as other,
        one.declare_queryable(keys.watch("desk", "clock"), asked.append),
    ):
        answers = ask(other, keys.watch("desk", "clock"), REQUEST, 2.0)
        assert len(answers) == 1
        assert result_of(answers[0][1]) > 0
    assert asked == []


@pytest.mark.parametrize("wrong", REFUSED)
@pytest.mark.usefixtures("impatient")
def test_client_with_wrong_certificate_is_refused(served, certificates, wrong):
    before, own = served.packets, certificates["operator"]
    given = certificates.get(wrong)
    if wrong == "none":
        given = Certificate(own.authority, own.authority, own.key)
    with pytest.raises(PortError, match="No arm can be reached"), \
            open_client([served.endpoint], given) as session:  # fmt: skip
        ask(session, keys.drive("desk", "enable"), REQUEST, 0.2)
    assert served.packets == before


@pytest.mark.usefixtures("impatient")
def test_error_of_client_without_tls_says_that_arm_uses_tls(served):
    plain = Endpoint("tcp", "127.0.0.1", served.endpoint.port)
    with (
        pytest.raises(PortError, match="arms are served there with TLS"),
        open_client([plain], None),
    ):
        pass


@pytest.mark.usefixtures("impatient")
def test_client_reports_server_without_tls(certificates):
    with socket.create_server(("127.0.0.1", 0)) as server:
        secured = Endpoint("tls", "127.0.0.1", server.getsockname()[1])
        with pytest.raises(PortError, match="without TLS"), \
                open_client([secured], certificates["operator"]):  # fmt: skip
            pass


@pytest.mark.usefixtures("impatient")
@pytest.mark.parametrize(
    ("host", "why"),
    [("no-such-host.invalid", "no machine named"), ("127.0.0.1", "nothing listens there")],
)
def test_error_tells_unknown_host_from_host_without_server(host, why):
    with socket.create_server(("127.0.0.1", 0)) as server:
        free_port = server.getsockname()[1]
    with pytest.raises(PortError, match=why), open_client([Endpoint("tcp", host, free_port)], None):
        pass


def test_certificates_are_made_once_with_private_keys(tmp_path):
    folders = making.make_keys(tmp_path / "keys", ["lab-pi", "192.168.1.7"])
    assert [folder.name for folder in folders] == ["authority", "server", "operator", "watcher"]
    for folder in folders:
        assert all(file.stat().st_mode & 0o077 == 0 for file in folder.glob("*.key"))
        assert not (folder / "authority.key").exists() or folder.name == "authority"
    with pytest.raises(InputError, match="already has certificates"):
        making.make_keys(tmp_path / "keys", [])


def test_client_uses_certificates_of_keys_folder(tmp_path, monkeypatch):
    monkeypatch.setenv("IKSERVO_KEYS", str(tmp_path))
    assert making.client_certificate(parse_host("127.0.0.1")) is None
    with pytest.raises(InputError, match="ikservo net keys"):
        making.client_certificate(parse_host("lab-pi"))
    making.make_keys(tmp_path / "made", [])
    monkeypatch.setenv("IKSERVO_KEYS", str(tmp_path / "made" / "watcher"))
    assert making.client_certificate(parse_host("lab-pi")).certificate.name == "watcher.pem"
    with pytest.raises(InputError, match="a server"):
        making.server_certificate(parse_host("lab-pi"))
