"""The server: its options, its log and audit, its remote control, its pseudo-terminals."""

from __future__ import annotations

import json
import math
import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import dynamixel_sdk
import pytest
import scservo_sdk
import serial

import servosim
from servosim.assembly import make_bench_world
from servosim.frames import encode2
from servosim.pty import point_link, remove_link
from servosim.remote import RemoteControl
from servosim.server import parse_options
from servosim.traffic import Audit, TrafficLog

SERVE = "import sys, servosim; sys.exit(servosim.serve(sys.argv[1:]))"
PING = bytes.fromhex("FFFF010201FB")


class TestOptions:
    def test_sim_servo_option_accepts_ids_and_model(self):
        options = parse_options(["--servo", "1-3:xl430-w250", "--servo", "7,9:XL330-M288"])
        assert [(servo.id, servo.model) for servo in options.servos] == [
            (1, "XL430-W250"), (2, "XL430-W250"), (3, "XL430-W250"),
            (7, "XL330-M288"), (9, "XL330-M288"),
        ]  # fmt: skip

    @pytest.mark.parametrize(
        ("name", "model"),
        [("ax-12", "AX-12A"), ("xl430", "XL430-W250"), ("sts3215", "STS3215")],
    )
    def test_sim_servo_option_accepts_prefix_of_model_name(self, name, model):
        (servo,) = parse_options(["--servo", f"1:{name}"]).servos
        assert servo.model == model

    @pytest.mark.parametrize("name", ["xl330", "x", ""])
    def test_sim_servo_option_refuses_ambiguous_model_name(self, name, capsys):
        with pytest.raises(SystemExit):
            parse_options(["--servo", f"1:{name}"])
        assert f"no model {name!r}" in capsys.readouterr().err

    def test_sim_servo_option_accepts_baud_rate_per_servo(self):
        options = parse_options(["--servo", "1:sts3215@115200", "--servo", "1:sts3215"])
        world = make_bench_world(options.servos)
        assert [servo.baud for servo in world.servos] == [115_200, 1_000_000]

    @pytest.mark.parametrize(
        ("argv", "message"),
        [
            ([], "give an arm or --servo"),
            (["arm.toml", "--servo", "1:sts3215"], "not both"),
            (["--servo", "1:sts9999"], "no model 'sts9999' in '1:sts9999'; known: "),
            (["--servo", "x:sts3215"], "'x' are not ids"),
            (["--servo", "1:sts3215@fast"], "'fast' is not a rate"),
            (["--servo", "1-300:sts3215"], "ids go from 0 to 252"),
            (["arm.toml", "--protocol", "3"], "invalid choice"),
            (["--servo", "3-1:sts3215"], "no id in '3-1'"),
            (["arm.toml", "--baud", "0"], "'0' is not a rate"),
            (["arm.toml", "--protocol", "1"], "--protocol is an option of --servo"),
            (["--servo", "1:sts3215", "--physics"], "--physics is an option of an arm"),
            (["--servo", "1:sts3215", "--pose", "rest"], "--pose is an option of an arm"),
        ],
    )
    def test_invalid_sim_options_exit_2_with_message(self, argv, message, capsys):
        with pytest.raises(SystemExit) as ended:
            parse_options(argv)
        assert ended.value.code == 2
        assert message in capsys.readouterr().err


class TestJournal:
    def test_sim_traffic_log_has_time_direction_bytes_and_meaning(self, make_port, tmp_path):
        port = make_port("STS3215")
        journal = TrafficLog(tmp_path / "log", port.line.world.servos)
        port.line.witnesses.append(journal)
        port.write(bytes.fromhex("FFFF0104023802BE"))
        port.read(8)
        journal.close()
        first, second = (tmp_path / "log").read_text().splitlines()
        assert first == "    0.000080 > FF FF 01 04 02 38 02 BE  read 1 present_position (56)"
        assert second.endswith("< FF FF 01 04 00 00 08 F2  status 1")

    @pytest.mark.parametrize(
        ("instruction", "params"),
        [(0x8A, "84 00 04 00 01 02"), (0x9A, "01 84 00 04 00 02 84 00 04 00")],
    )
    def test_sim_traffic_log_has_each_part_of_fast_sync_reply(
        self, make_port, tmp_path, instruction, params
    ):
        port = make_port("XL430-W250", "XL430-W250")
        port.line.servos[2].inject_alarm(0x20)
        journal = TrafficLog(tmp_path / "log", port.line.world.servos)
        port.line.witnesses.append(journal)
        port.write(encode2(254, instruction, bytes.fromhex(params)))
        port.read(64)
        journal.close()
        _, first, second = (tmp_path / "log").read_text().splitlines()
        assert first.endswith("status 1")
        assert second.endswith("status 2 error 0x80")

    def test_sim_traffic_log_marks_bus_collisions(self, make_port, tmp_path):
        port = make_port("XL430-W250", "XL330-M288", ids=(1, 1))
        journal = TrafficLog(tmp_path / "log", port.line.world.servos)
        port.line.witnesses.append(journal)
        port.write(bytes.fromhex("FFFFFD0001030001194E"))
        port.read(64)
        journal.close()
        assert "collision" in (tmp_path / "log").read_text()


class TestAudit:
    def test_sim_audit_counts_goals_distances_and_eeprom_writes(self, make_port):
        port = make_port("STS3215")
        servo, audit = port.line.servos[1], Audit(port.line.world.servos)
        servo.write("lock", 0)
        servo.write("max_position_limit", 3000)
        for goal in (2100, 2500, 3200):
            servo.write("goal_position", goal)
        (record,) = audit.report([])["servos"]
        assert record == {
            "id": 1, "model": "STS3215", "goals": 3, "goals_outside_limits": 1,
            "largest_goal_step": 700, "largest_goal_distance": 1152, "eeprom_writes": 1,
        }  # fmt: skip

    def test_sim_audit_counts_frames_bad_checksums_and_junk(self, make_port):
        port = make_port("STS3215")
        audit = Audit(port.line.world.servos)
        port.line.witnesses.append(audit)
        for data in (PING, PING[:-1] + b"\x00", b"\x12\x34" + PING):
            port.write(data)
            port.read(6)
        report = audit.report(list(port.line.readers.values()))
        assert (report["frames"], report["replies"], report["bad_checksums"]) == (2, 2, 1)
        assert report["junk_bytes"] == 8

    def test_sim_audit_does_not_count_other_writes_as_goals(self, make_port):
        port = make_port("STS3215")
        audit = Audit(port.line.world.servos)
        port.line.servos[1].write("acceleration", 5)
        assert audit.report([])["servos"][0]["goals"] == 0


class TestRemote:
    def ask(self, port, request):
        return RemoteControl(None, port.line).respond(json.dumps(request))

    def test_sim_state_command_reports_servos_and_joints(self, make_port):
        answer = self.ask(make_port("STS3215"), {"do": "state"})
        servo = answer["servos"][0]
        assert (servo["id"], servo["model"], servo["position"]) == (1, "STS3215", 2048)
        assert answer["joints"]["servo_1"]["position_deg"] == 0.0

    def test_sim_place_command_moves_joint(self, make_port):
        port = make_port("STS3215")
        self.ask(port, {"do": "place", "joint": "servo_1", "deg": 90})
        assert port.line.servos[1].read("present_position") == 3072

    def test_sim_place_command_keeps_joint_inside_end_stops(self, make_port):
        port = make_port("SCS0009")
        self.ask(port, {"do": "place", "joint": "servo_1", "deg": 9000})
        assert port.line.world.joint("servo_1").position == pytest.approx(math.radians(150))

    def test_sim_hand_command_moves_joint_to_angle(self, make_port):
        port = make_port("STS3215")
        self.ask(port, {"do": "hand", "joint": "servo_1", "deg": 45})
        port.clock.sleep_until(2)
        assert port.line.world.joint("servo_1").position == pytest.approx(math.pi / 4, abs=0.01)

    def test_sim_release_command_removes_simulated_hand(self, make_port):
        port = make_port("STS3215")
        self.ask(port, {"do": "hand", "joint": "servo_1", "deg": 45})
        self.ask(port, {"do": "hand", "joint": "servo_1", "release": True})
        assert port.line.world.hands == {}

    def test_sim_fault_command_starts_fault_at_once(self, make_port):
        port = make_port("STS3215")
        port.clock.sleep_until(1)
        self.ask(port, {"do": "fault", "fault": {"kind": "silent", "count": 1}})
        port.write(PING)
        assert port.read(6) == b""

    def test_sim_control_socket_disconnects_and_connects_servo(self, make_port):
        port = make_port("STS3215")
        for do, answer in (("disconnect", b""), ("connect", bytes.fromhex("FFFF010200FC"))):
            assert self.ask(port, {"do": do, "servo": 1}) == {"ok": True}
            port.clock.sleep_until(port.clock.now_s() + 1.0)
            port.write(PING)
            assert port.read(6) == answer

    @pytest.mark.parametrize(
        ("request_", "register", "value"),
        [
            ({"do": "temperature", "id": 1, "celsius": 60}, "present_temperature", 60),
            ({"do": "voltage", "volts": 6.0}, "present_voltage", 60),
            ({"do": "reset", "id": 1}, "acceleration", 0),
            ({"do": "brownout", "for_s": 0.01}, "acceleration", 0),
        ],
    )
    def test_sim_control_request_changes_simulated_world(
        self, make_port, request_, register, value
    ):
        port = make_port("STS3215")
        port.line.servos[1].write("acceleration", 9)
        assert self.ask(port, request_) == {"ok": True}
        port.clock.sleep_until(0.1)
        assert port.line.servos[1].read(register) == pytest.approx(value, abs=1)

    @pytest.mark.parametrize(
        ("text", "error"),
        [
            ("nonsense", "Expecting value"),
            ("{}", "'do' is missing"),
            ('{"do": "dance"}', "unknown request 'dance'; known: state, place"),
            ('{"do": "place", "joint": "knee", "deg": 1}', "no joint is named 'knee'"),
            ('{"do": "place", "joint": "servo_1"}', "'m' is missing"),
            ('{"do": "fault", "fault": {"kind": "gremlin"}}', "no fault is named"),
            ("[1]", "list indices"),
            ("[" * 100_000, "nested too deeply"),
            ('{"do": "place", "joint": "servo_1", "deg": NaN}', "deg = nan"),
            ('{"do": "place", "joint": "servo_1", "deg": 1%s}' % ("0" * 400), "too large"),
            ('{"do": "hand", "joint": "servo_1", "deg": 9, "speed": 0}', "speed = 0"),
            ('{"do": "hand", "joint": "servo_1", "deg": 9, "force": -1}', "force = -1"),
            ('{"do": "hand", "joint": "knee", "release": true}', "no joint is named 'knee'"),
            ('{"do": "connect", "servo": 9}', "servo = 9 is not one of 1 to 1"),
            ('{"do": "temperature", "id": 9, "celsius": 60}', "no servo has id 9"),
            ('{"do": "voltage", "volts": NaN}', "volts = nan is not between 0 and 60"),
        ],
    )
    def test_sim_control_socket_explains_invalid_request(self, make_port, text, error):
        answer = RemoteControl(None, make_port("STS3215").line).respond(text)
        assert not answer["ok"]
        assert error in answer["error"]


@pytest.fixture
def server(tmp_path):
    """Start servers; each returns (process, path of its port)."""
    running = []

    def start(*argv):
        command = [sys.executable, "-c", SERVE, *map(str, argv)]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        running.append(process)
        return process, process.stdout.readline().strip()

    yield start
    for process in running:
        process.terminate()
        process.wait(10)
        process.stdout.close()


def first_reply(ask, *request):
    """Repeat a request until the answer comes: the machine may be busy."""
    answers = (ask(*request) for _ in range(5))
    return next((answer for answer in answers if answer[-2] == 0), "no answer")


def dynamixel(path, baud=1_000_000):
    port = dynamixel_sdk.PortHandler(path)
    assert port.openPort()
    assert port.setBaudRate(baud)
    return port


def test_simulated_new_servos_answer_at_factory_baud_rate(server):
    _, path = server("--servo", "1-2:xl430-w250", "--servo", "5:xl330-m288")
    port = dynamixel(path, 57_600)
    packets = dynamixel_sdk.PacketHandler(2.0)
    answers = [first_reply(packets.ping, port, id_) for id_ in (1, 2, 5)]
    port.closePort()
    assert answers == [(1060, 0, 0), (1060, 0, 0), (1200, 0, 0)]


def test_simulated_new_servos_use_protocol_1_on_request(server):
    _, path = server("--servo", "1:xl430-w250", "--baud", "1000000", "--protocol", "1")
    port = dynamixel(path)
    answer = first_reply(dynamixel_sdk.PacketHandler(1.0).ping, port, 1)
    port.closePort()
    assert answer == (1060, 0, 0)


def test_dynamixel_sdk_controls_simulated_ax_and_mx_servos(server):
    _, path = server("--servo", "1:ax-12a", "--servo", "2:mx-28", "--baud", "1000000")
    port = dynamixel(path)
    packets = dynamixel_sdk.PacketHandler(1.0)
    answers = first_reply(packets.ping, port, 1), first_reply(packets.ping, port, 2)
    position = first_reply(packets.read2ByteTxRx, port, 2, 36)
    first_reply(packets.write2ByteTxRx, port, 1, 30, 520)
    goal = first_reply(packets.read2ByteTxRx, port, 1, 30)
    port.closePort()
    assert answers == ((12, 0, 0), (29, 0, 0))
    assert (position, goal) == ((2048, 0, 0), (520, 0, 0))


def test_scservo_sdk_controls_simulated_scs_servos(server):
    _, path = server("--servo", "1:scs0009")
    port = scservo_sdk.PortHandler(path)
    port.openPort()
    port.setBaudRate(1_000_000)
    packets = scservo_sdk.PacketHandler(1)
    answers = first_reply(packets.ping, port, 1), first_reply(packets.read2ByteTxRx, port, 1, 56)
    port.closePort()
    scservo_sdk.PacketHandler(0)  # the byte order is a global of the SDK
    assert answers == ((1284, 0, 0), (512, 0, 0))


def test_simulated_arm_can_be_served_at_another_baud_rate(server, configs):
    _, path = server(configs / "koch" / "arm.toml", "--baud", "57600")
    port = dynamixel(path, 57_600)
    answer = first_reply(dynamixel_sdk.PacketHandler(2.0).ping, port, 1)
    port.closePort()
    assert answer == (1060, 0, 0)


def test_two_simulated_arms_are_served_at_once(server, configs):
    paths = [server(configs / name / "arm.toml")[1] for name in ("koch", "px100")]
    packets = dynamixel_sdk.PacketHandler(2.0)
    ports = [dynamixel(path) for path in paths]
    answers = [first_reply(packets.ping, port, 1) for port in ports]
    for port in ports:
        port.closePort()
    assert answers == [(1060, 0, 0)] * 2


def test_sim_server_writes_log_and_audit_and_quits(server, configs, tmp_path):
    log, audit, control = (tmp_path / name for name in ("log", "audit", "control"))
    process, path = server(
        configs / "koch" / "arm.toml", "--log", log, "--audit", audit, "--control", control
    )
    port = dynamixel(path)
    first_reply(dynamixel_sdk.PacketHandler(2.0).ping, port, 1)
    port.closePort()
    assert talk(control, {"do": "state"})["servos"][0]["id"] == 1
    assert talk(control, {"do": "quit"}) == {"ok": True}
    assert process.wait(10) == 0
    assert "ping 1" in log.read_text()
    assert json.loads(audit.read_text())["frames"] >= 1
    assert not control.exists()


@pytest.mark.skipif(sys.platform != "linux", reason="needs /dev/full")
def test_sim_server_with_log_on_full_disk_exits_1():
    command = [sys.executable, "-c", SERVE, "--servo", "1:sts3215", "--log", "/dev/full"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    with serial.Serial(process.stdout.readline().strip(), 1_000_000) as port:
        port.write(PING)
        errors = process.communicate(timeout=20)[1]
    assert errors.splitlines() == ["/dev/full cannot be written: No space left on device."]
    assert process.returncode == 1


def test_unwritable_sim_audit_file_is_refused_at_start(configs, tmp_path):
    (tmp_path / "old").write_text("the old one")
    command = [sys.executable, "-c", SERVE, configs / "koch" / "arm.toml", "--audit"]
    done = subprocess.run(
        [*command, tmp_path / "old" / "audit"],
        capture_output=True,
        text=True,
        timeout=20,
        check=False,
    )
    assert (done.returncode, "old/audit" in done.stderr) == (2, True)
    assert (tmp_path / "old").read_text() == "the old one"


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_signal_ends_sim_server_and_removes_port_link(server, tmp_path, number):
    link = tmp_path / "arm"
    process, _ = server("--servo", "1:sts3215", "--link", link)
    assert link.is_symlink()
    process.send_signal(number)
    assert process.wait(10) == 0
    assert not link.is_symlink()


def test_sim_unplug_and_replug_remove_and_restore_port(server, configs, tmp_path):
    link, control = tmp_path / "arm", tmp_path / "control"
    server(configs / "koch" / "arm.toml", "--link", link, "--control", control)
    port = dynamixel(str(link))
    talk(control, {"do": "unplug"})
    wait_until(lambda: not link.is_symlink())
    with pytest.raises(OSError, match=r"readiness|Input/output"):
        port.ser.read(1) or port.ser.read(1)
    port.ser.close()
    talk(control, {"do": "replug"})
    wait_until(link.is_symlink)
    port = dynamixel(str(link))
    answer = first_reply(dynamixel_sdk.PacketHandler(2.0).ping, port, 1)
    port.closePort()
    assert answer == (1060, 0, 0)


def test_missing_arm_file_of_sim_command_exits_2(tmp_path):
    command = [sys.executable, "-c", SERVE, str(tmp_path / "arm.toml")]
    result = subprocess.run(command, capture_output=True, text=True, timeout=30, check=False)
    assert (result.returncode, result.stdout) == (2, "")
    assert "arm.toml" in result.stderr


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--link", "taken"], "taken already exists and is not a link"),
        (["--control", "taken"], "taken already exists and is not a socket"),
        (["--link", "nowhere/arm"], "nowhere/arm"),
        (["--log", "nowhere/log"], "nowhere/log"),
        (["--audit", "nowhere/audit"], "nowhere/audit"),
        (["--control", "nowhere/control"], "nowhere/control"),
        (["--noise", "2"], "noise is a probability from 0 to 1"),
        (["--latency-ms", "nan"], "the delay of an adapter is 0 to 1000 ms"),
    ],
)
def test_unusable_sim_link_or_output_path_is_left_untouched(
    options, message, configs, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    Path("taken").write_text("precious")
    assert servosim.serve([str(configs / "koch" / "arm.toml"), *options]) == 2
    assert message in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["taken"]
    assert Path("taken").read_text() == "precious"


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() != 0, reason="takes permission")
def test_sim_server_has_higher_priority_if_permitted(server):
    process, _ = server("--servo", "1:sts3215")
    assert os.getpriority(os.PRIO_PROCESS, process.pid) < os.getpriority(os.PRIO_PROCESS, 0)


def test_sim_port_link_taken_over_by_another_server_stays(tmp_path):
    link, mine, other = (tmp_path / name for name in ("arm", "mine", "other"))
    point_link(link, mine)
    point_link(link, other)
    remove_link(link, mine)
    assert link.readlink() == other
    remove_link(link, other)
    assert not link.is_symlink()


def talk(path: Path, request):
    with socket.socket(socket.AF_UNIX) as client:
        client.settimeout(5)
        client.connect(str(path))
        client.sendall(json.dumps(request).encode() + b"\n")
        return json.loads(client.makefile().readline())


def wait_until(condition, timeout_s=5.0):
    end_s = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < end_s
