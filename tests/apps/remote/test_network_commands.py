"""The commands for arms on other machines, and other commands with an address as the port."""

import json
import signal
import socket
import subprocess
import sys
import threading

import pytest

from ikservo.apps.remote.address import parse_address
from ikservo.apps.remote.client_connection import Connection
from ikservo.apps.remote.serve_command import ended_by_signal
from ikservo.apps.remote.zenoh_session import who_asks
from ikservo.cli import main
from ikservo.remedies import install_command
from tests.apps.remote.conftest import find_free_port
from tests.cli.test_quick_stop import HEAVY, run_stop

SERVE = "import sys; from ikservo.cli.entry_point import console; console()"


@pytest.fixture
def run(capsys):
    def run(*words):
        code = main([str(word) for word in words])
        captured = capsys.readouterr()
        return code, captured.out, captured.err

    return run


def test_where_command_shows_remote_arm(served, run):
    code, out, err = run("where", "--arm", "so101", "--port", served.address)
    assert code == 0, err
    assert "shoulder_pan" in out


def test_joints_command_moves_remote_arm(served, run):
    code, out, err = run("joints", "gripper=20", "--arm", "so101", "--port", served.address,
                         "--json")  # fmt: skip
    assert code == 0, err
    assert json.loads(out)["reached"]


def test_ikservo_port_variable_may_be_remote_address(served, run, monkeypatch):
    monkeypatch.setenv("IKSERVO_PORT", served.address)
    assert run("where", "--arm", "so101")[0] == 0


@pytest.mark.parametrize("action", ["show", "restore", "diff"])
def test_calibration_commands_refuse_remote_arm(served, run, action):
    code, out, err = run("calibration", action, "so101", "--port", served.address)
    assert (code, out) == (3, "")
    assert f"{served.address} is an arm on another machine" in err


def test_pose_command_lists_poses_of_remote_arm(served, run):
    served.arm.teach("there")
    code, out, _ = run("pose", "--arm", "so101", "--port", served.address)
    assert (code, out.split()) == (0, [*served.arm.poses.all_poses()])
    assert "there" in out


def test_unreachable_point_on_remote_arm_exits_with_7(served, run):
    code, _, err = run("move", "0.9", "0", "0.1", "--arm", "so101", "--port", served.address)
    assert code == 7
    assert "Try: ikservo move" in err


def test_remote_stop_is_acknowledged_on_command_line(served, run):
    there = ("--arm", "so101", "--port", served.address)
    assert run("stop", *there)[0] == 0
    code, _, err = run("joints", "gripper=10", *there)
    assert code == 8
    assert f"Stopped by {who_asks()}" in err
    assert f"ikservo net acknowledge --port {served.address}" in err
    code, out, _ = run("net", "acknowledge", "--port", served.address)
    assert code == 0
    assert "acknowledged" in out
    assert run("joints", "gripper=10", *there)[0] == 0


@pytest.mark.full
def test_stop_of_limp_remote_arm_reports_torque_off(served, run):
    served.arm.disable_torque()
    code, out, _ = run("stop", "--arm", "so101", "--port", served.address)
    reason = served.arm.stop_reason.text
    served.arm.acknowledge()
    served.arm.pose("home")
    assert code == 0
    assert "torque on" not in out
    assert "torque off" in out
    assert reason == f"Stopped by {who_asks()}."


@pytest.mark.parametrize("words", [(), ("--all",)], ids=["stop", "stop --all"])
def test_stop_command_without_arm_stops_fleet(served, run, monkeypatch, words):
    monkeypatch.setenv("IKSERVO_FLEET", f"127.0.0.1:{served.port}")
    code, out, err = run("stop", *words, "--json")
    assert code == 0, err
    assert [arm["arm"] for arm in json.loads(out)["arms"]] == ["so101"]
    assert served.arm.stop_reason is not None


@pytest.mark.parametrize("way", ["fleet", "address", "port of the environment"])
def test_network_stop_imports_no_large_package_except_zenoh(served, monkeypatch, way):
    args = ()
    if way == "fleet":
        monkeypatch.setenv("IKSERVO_FLEET", f"127.0.0.1:{served.port}")
    elif way == "address":
        args = ("--arm", "so101", "--port", served.address)
    else:
        monkeypatch.setenv("IKSERVO_PORT", served.address)
    report, modules = run_stop(*args)
    assert [arm["arm"] for arm in report["arms"]] == ["so101"]
    assert served.arm.stop_reason.text == f"Stopped by {who_asks()}."
    assert not (HEAVY - {"zenoh"}) & modules


def test_wrong_fleet_address_does_not_prevent_other_stops(served, run, monkeypatch):
    monkeypatch.setenv("IKSERVO_FLEET", f"pi_2, 127.0.0.1:{served.port}")
    code, _, err = run("stop", "--all")
    assert code == 2
    assert "pi_2" in err
    assert served.arm.stop_reason is not None


@pytest.mark.parametrize("words", [(), ("--all",)], ids=["stop", "stop --all"])
def test_stop_reaches_arm_served_on_this_machine(served, run, monkeypatch, words):
    monkeypatch.setattr("ikservo.apps.remote.address.DEFAULT_PORT", served.port)
    code, _, err = run("stop", *words)
    assert code == 0, err
    assert served.arm.stop_reason is not None


def test_stop_all_also_stops_arm_of_ikservo_port(served, run, monkeypatch):
    monkeypatch.setattr("ikservo.apps.remote.zenoh_session._CONNECT_TIMEOUT_S", 0.3)
    monkeypatch.setenv("IKSERVO_PORT", served.address)
    monkeypatch.setenv("IKSERVO_FLEET", f"127.0.0.1:{find_free_port()}")
    code, _, err = run("stop", "--all")
    assert code == 3
    assert "No arm can be reached" in err
    assert served.arm.stop_reason is not None  # whatever cannot be reached


@pytest.fixture
def silent_port():
    """A port of this machine that accepts connections and never answers."""
    with socket.create_server(("127.0.0.1", 0)) as listening:
        yield listening.getsockname()[1]


@pytest.mark.full
def test_fleet_stop_names_silent_machine_and_stops_others(served, run, monkeypatch, silent_port):
    monkeypatch.setattr("ikservo.apps.remote.zenoh_session._CONNECT_TIMEOUT_S", 0.3)
    monkeypatch.setenv("IKSERVO_FLEET", f"127.0.0.1:{silent_port},127.0.0.1:{served.port}")
    code, out, err = run("stop", "--all")
    assert (code, f"127.0.0.1:{silent_port}" in err) == (3, True), err
    assert out.startswith("so101 on")
    found = json.loads(run("stop", "--all", "--json")[1])
    assert ([arm["arm"] for arm in found["arms"]], len(found["errors"])) == (["so101"], 1)


def test_stop_of_unresponsive_server_is_tried_3_times(served, run, monkeypatch):
    asked, goes_on = [], threading.Event()
    answer = served.server.service.stop

    def hang(reason, lease):
        asked.append(reason)
        goes_on.wait(30)
        return answer(reason, lease=lease)

    monkeypatch.setattr("ikservo.apps.remote.remote_stop._ANSWER_TIMEOUT_S", 0.3)
    monkeypatch.setattr(served.server.service, "stop", hang)
    monkeypatch.setenv("IKSERVO_FLEET", f"127.0.0.1:{served.port}")
    code, out, err = run("stop", "--all")
    goes_on.set()
    assert (code, out, len(asked)) == (3, "", 3)
    assert f"desk at tcp/127.0.0.1:{served.port} was not confirmed" in err


def test_stop_is_obeyed_over_slow_network(served, run, monkeypatch):
    monkeypatch.setattr("ikservo.apps.remote.client_connection._MAX_ROUND_TRIP_S", 0.0)
    assert run("stop", "--port", served.address)[0] == 0
    assert served.arm.stop_reason is not None


def test_stop_by_address_does_not_need_arm_name(served, run):
    code, out, err = run("stop", "--port", served.address)
    assert code == 0, err
    assert out.startswith("so101")
    assert served.arm.stop_reason is not None


def test_fleet_command_lists_arms_and_unreachable_machines(served, run, monkeypatch):
    monkeypatch.setattr("ikservo.apps.remote.zenoh_session._CONNECT_TIMEOUT_S", 0.3)
    dead = find_free_port()
    code, out, _ = run("fleet", f"127.0.0.1:{served.port}", f"127.0.0.1:{dead}", "--json")
    assert code == 0
    here, there = json.loads(out)["arms"]
    assert (here["name"], here["arm"], here["state"]) == ("desk", "so101", "holds")
    assert (there["state"], there["latency_s"]) == ("unreachable", None)
    assert there["error"]


def test_fleet_command_shows_whole_stop_reason_in_80_columns(served, run, monkeypatch):
    monkeypatch.setattr("ikservo.cli.terminal.terminal_width", lambda _: 80)
    served.arm.stop("a person has come near the arm, too near for it to move")
    _, out, _ = run("fleet", f"127.0.0.1:{served.port}")
    assert "a person has come near the arm, too near for it to move" in out


def test_fleet_command_shows_operator_of_each_arm(served, run):
    with served.open() as arm:
        arm.enable()
        _, out, _ = run("fleet", f"127.0.0.1:{served.port}")
        assert served.server.lease.holder.operator in out.splitlines()[1]


@pytest.mark.parametrize(
    ("words", "code", "text"),
    [
        ("fleet 127.0.0.1:9", 3, "No arm can be reached"),
        ("fleet a/b/c", 2, "Expected"),
        ("net keys --host a/b --folder nowhere", 2, "The host"),
        ("net key", 2, "Did you mean keys"),
        ("net acknowledge", 2, "--port"),
        ("net acknowledge --port /dev/ttyACM0", 2, "zenoh:"),
        ("serve so101 --port sim --listen tcp/0.0.0.0:7448", 2, "ikservo net keys"),
        ("serve so101 --port sim --listen tls/0.0.0.0:7448", 2, "ikservo net keys"),
        ("serve so101 --port sim --name a/b", 2, "The name of the served arm"),
        ("serve so101 --port zenoh:a@127.0.0.1", 2, "served again"),
        ("where --arm so101 --port zenoh:desk", 2, "zenoh:NAME@HOST"),
        ("doctor --arm so101 --port zenoh:desk@127.0.0.1", 1, "another machine"),
        ("setup so101 --port zenoh:desk@127.0.0.1", 3, "another machine"),
        ("bench bus --arm so101 --port zenoh:desk@127.0.0.1", 3, "another machine"),
        ("view --arm so101 --no-open --port zenoh:desk@127.0.0.1", 3, "another machine"),
        ("move 0.2 0 0.1 --no-collision --arm so101 --port zenoh:d@127.0.0.1", 2, "ikservo serve"),
        ("move 0.2 0 0.1 --scene s.toml --arm so101 --port zenoh:d@127.0.0.1", 2, "A scene"),
    ],
)  # fmt: skip
def test_bad_network_command_gives_one_clear_error(run, monkeypatch, tmp_path, words, code, text):
    monkeypatch.chdir(tmp_path)
    scene = '[[sphere]]\nname = "the ball"\ncentre_m = [1.0, 0.0, 0.0]\nradius_m = 0.1\n'
    (tmp_path / "s.toml").write_text(scene)
    monkeypatch.setattr("ikservo.apps.remote.zenoh_session._CONNECT_TIMEOUT_S", 0.3)
    found, out, err = run(*words.split())
    assert (found, text in out + err) == (code, True), out + err
    assert "Traceback" not in err


def test_net_keys_makes_certificates_in_folder(run, tmp_path):
    code, out, _ = run("net", "keys", "--folder", tmp_path / "keys", "--host", "lab-pi", "--json")
    assert code == 0
    assert json.loads(out)["hosts"] == ["lab-pi"]
    assert (tmp_path / "keys" / "operator" / "operator.key").exists()
    assert run("net", "keys", "--folder", tmp_path / "keys")[0] == 2
    assert run("net", "keys", "--folder", tmp_path / "keys", "--new")[0] == 0


@pytest.mark.parametrize("host", ["münchen", "a/b", "", "x" * 300])
def test_net_keys_for_invalid_host_keeps_old_certificates(run, tmp_path, host):
    folder = tmp_path / "keys"
    assert run("net", "keys", "--folder", folder)[0] == 0
    before = {path: path.read_bytes() for path in folder.rglob("*.*")}
    code, _, err = run("net", "keys", "--folder", folder, "--new", "--host", host)
    assert (code, "The host" in err) == (2, True), err
    assert {path: path.read_bytes() for path in folder.rglob("*.*")} == before


def test_net_keys_without_library_gives_one_clear_error(run, tmp_path, monkeypatch):
    monkeypatch.setattr("ikservo.apps.remote.certificates.find_spec", lambda _: None)
    code, _, err = run("net", "keys", "--folder", tmp_path / "keys")
    assert (code, install_command("net") in err) == (1, True), err
    assert not (tmp_path / "keys").exists()


@pytest.mark.full
@pytest.mark.skipif(sys.platform == "win32", reason="signals")
def test_serve_prints_address_and_ends_by_ctrl_c():
    port = find_free_port()
    argv = [sys.executable, "-c", SERVE, "serve", "so101", "--port", "sim", "--json",
            "--listen", f"tcp/127.0.0.1:{port}"]  # fmt: skip
    with subprocess.Popen(argv, stdout=subprocess.PIPE, text=True) as process:
        said = json.loads(process.stdout.readline())
        connection = Connection(parse_address(said["address"]), None)
        assert connection.watch("describe")["arm"] == "so101"
        connection.close()
        process.send_signal(signal.SIGINT)
        assert process.wait(20) == 0


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGHUP"])
def test_signal_before_wait_ends_serving_without_error(name):
    if not hasattr(signal, name):
        pytest.skip("Windows has no SIGHUP")
    before = signal.getsignal(getattr(signal, name))
    with ended_by_signal() as wait:
        signal.raise_signal(getattr(signal, name))
        wait()
    assert signal.getsignal(getattr(signal, name)) == before


def test_signal_during_serve_announcement_exits_with_0(run, monkeypatch):
    monkeypatch.setattr(
        "ikservo.apps.remote.serve_command._announce",
        lambda *_, **__: signal.raise_signal(signal.SIGINT),
    )
    listen = f"tcp/127.0.0.1:{find_free_port()}"
    assert run("serve", "so101", "--port", "sim", "--listen", listen)[0] == 0
