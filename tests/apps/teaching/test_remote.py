"""Another terminal stops, locates and relaxes an arm, whichever program has its port."""

import math
import threading
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

import ikservo
from ikservo.apps.teaching import recorder
from ikservo.apps.teaching.recorder import RecordSettings, read_recording
from ikservo.arm import other_process as remote
from ikservo.arm.control_server import command_handler, serve
from ikservo.arm.result_json import encode_value
from ikservo.arm.service import ArmService
from ikservo.control.stop_requests import hold_servos
from ikservo.errors import IkservoError, PortBusyError, RefusedError, StoppedError
from ikservo.guard import StopKind, StopReason
from ikservo.serving import control_client
from servosim.clock import VirtualClock
from servosim.faults import Fault
from tests.arm.simulated import line_of, motion_runner, registers, servo_group, true_joints

TESTED = StopReason(StopKind.CLIENT, "test")


@pytest.fixture
def device(tmp_path, monkeypatch):
    monkeypatch.setenv("IKSERVO_HOME", str(tmp_path / "home"))
    device = tmp_path / "ttyACM0"
    device.touch()
    for module in (remote, recorder):
        monkeypatch.setattr(module, "resolve_port", lambda model, port: str(device))
    return str(device)


@pytest.fixture
def arm(device):
    """Return an arm whose own program listens: the simulated bus cannot be asked directly."""
    with ikservo.open_arm("so101", port="sim:?pose=home") as machine:
        server = serve(device, command_handler(ArmService(machine)))
        motion_runner(machine).caches_states = True
        yield machine
        server.close()


@pytest.fixture
def other_thread():
    with ThreadPoolExecutor(1) as pool:
        yield pool


def at(seconds, do):
    """Return a callback that acts once when a motion has run for the given time."""
    left = [do]

    def on_progress(progress):
        if progress.elapsed_s > seconds and left:
            left.pop()()

    return on_progress


def test_other_process_can_query_state_of_resting_arm(arm):
    here, asked = arm.where(), remote.query_state(arm.model, None)
    np.testing.assert_allclose(asked.tip_m, here.tip_m, atol=1e-3)
    assert [joint.name for joint in asked.joints] == [joint.name for joint in here.joints]
    assert asked.joints[0].limit_from == here.joints[0].limit_from


@pytest.mark.full
def test_moving_arm_reports_last_positions_to_other_process(arm, other_thread):
    seen, there, start = [], [], true_joints(arm)["gripper"]

    def ask():
        there.append(true_joints(arm)["gripper"])
        seen.append(other_thread.submit(remote.query_state, arm.model, None).result(20))

    arm.move_joints({"gripper": 0.9}, on_progress=at(0.3, ask))
    position = seen[0].joints[-1].position_rad
    assert position > start + 2 * math.tau / 4096  # it lags its goal by 0.1 s: no feed-forward
    assert position == pytest.approx(there[0], abs=0.01)  # less than a cycle at its top speed
    assert seen[0].joints[-1].torque


@pytest.mark.full
def test_moving_arm_reports_temperature_to_other_process(arm, other_thread):
    line, seen = line_of(arm), []
    servo = line.servos[3]
    arm.enable()

    def check():
        where = other_thread.submit(remote.query_state, arm.model, None).result()
        seen.append(where.joints[2].temperature_c)

    line.faults.add(Fault("hot", id=3, celsius=50.0, at_s=line.world.time_s + 0.1))
    arm.move_joints({"shoulder_pan": 0.3}, on_progress=at(0.5, check))
    assert seen == [pytest.approx(servo.read("present_temperature"), abs=2)]
    assert seen[0] > 45


def test_stop_from_other_terminal_stops_moving_arm(arm, other_thread):
    answers = []

    def stop():
        answers.append(other_thread.submit(remote.stop_arm, arm.model, None))
        while not arm.stop_requests:
            threading.Event().wait(0.001)

    with pytest.raises(StoppedError, match="from another terminal"):
        arm.move_joints({"shoulder_pan": 1.2}, on_progress=at(0.3, stop))
    stopped = answers[0].result(20)
    assert (stopped.moving, stopped.limp, stopped.silent) == (True, (), ())
    assert stopped.held == servo_group(arm).names
    assert all(registers(arm, "torque_enable").values())
    assert true_joints(arm)["shoulder_pan"] < 0.6
    with pytest.raises(RefusedError, match="from another terminal"):
        arm.move_joints({"shoulder_pan": 0.0})


def test_stop_of_holding_arm_does_not_report_motion(arm, other_thread):
    arm.enable()
    with motion_runner(arm).lock:
        stopping = other_thread.submit(remote.stop_arm, arm.model, None)
        while not arm.stop_requests:
            threading.Event().wait(0.001)
    stopped = stopping.result(20)
    assert (stopped.moving, stopped.held) == (False, servo_group(arm).names)
    assert arm.stop_reason is not None


def test_unresponsive_program_does_not_prevent_stop_of_others(arm, tmp_path, monkeypatch):
    goes_on = threading.Event()
    silent = serve(str(tmp_path / "ttyACM1"), lambda _: {"waited": goes_on.wait(60)})
    monkeypatch.setattr(control_client, "BRAKE_TIMEOUT_S", -1.0)
    try:
        found = control_client.stop_own_programs()
    finally:
        goes_on.set()
        silent.close()
    assert [each.arm for each in found.stopped] == ["so101"]
    (error,) = found.errors
    assert "does not answer" in error.message


@pytest.mark.full
def test_arm_moves_again_after_remote_stop_is_acknowledged(arm):
    remote.stop_arm(arm.model, None)
    arm.acknowledge()
    assert arm.move_joints({"gripper": 0.6}).reached


def test_stop_of_limp_arm_does_not_switch_torque_on(arm):
    stopped = remote.stop_arm(arm.model, None)
    assert (stopped.moving, stopped.held) == (False, ())
    assert stopped.limp == servo_group(arm).names
    assert not any(registers(arm, "torque_enable").values())


@pytest.mark.full
def test_relax_from_other_terminal_lowers_arm_and_latches(arm):
    arm.hold()
    report = remote.request_relax(arm.model, None)
    assert report.reached
    assert not any(registers(arm, "torque_enable").values())
    with pytest.raises(RefusedError, match="Torque switched off from another terminal"):
        arm.move_joints({"gripper": 0.6})


def test_stop_without_name_stops_every_arm(arm):
    (stopped,) = control_client.stop_own_programs().stopped
    assert stopped.arm == "so101"


def test_remote_query_returns_none_if_no_program_owns_port(device):
    model = ikservo.load_model("so101")
    assert remote.query_state(model, None) is None
    assert remote.request_relax(model, None) is None
    assert control_client.stop_own_programs() == control_client.StopAllResult()


@pytest.mark.parametrize("answer", [{}, {"tip_m": [0, 0, 0], "joints": [{"name": "a"}]},
                                    {"tip_m": "here", "joints": []}, {"held": 3}])  # fmt: skip
def test_reply_of_program_of_another_version_is_refused(device, answer):
    listener = serve(device, lambda _: answer)
    model = ikservo.load_model("so101")
    for ask in (remote.request_relax, remote.stop_arm):
        with pytest.raises(IkservoError, match="unexpected reply"):
            ask(model, None)
    with pytest.raises(IkservoError):
        remote.query_state(model, None)
    listener.close()


def test_arm_opened_by_another_program_can_be_recorded(arm, tmp_path):
    path = tmp_path / "wave.jsonl"
    report = recorder.record_other_process(arm.model, None, RecordSettings(path, 0.1))
    recording = read_recording(path)
    assert report.samples == len(recording.times_s) > 2
    assert recording.joints[0][-1] == pytest.approx(0.52, abs=0.02)


def test_goals_sent_by_another_program_are_recorded_as_mcap(arm, tmp_path):
    path = tmp_path / "wave.mcap"
    arm.hold()
    recorder.record_other_process(arm.model, None, RecordSettings(path, 0.1))
    with path.open("rb") as file:
        rows = make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages()
        goals = [message for _, channel, _, message in rows if channel.topic == "/ikservo/goal"]
    assert goals[-1].position[-1] == pytest.approx(0.52, abs=0.02)


def test_servos_left_moving_by_dead_program_are_stopped(arm):
    before = registers(arm, "present_position")[1]
    arm.hold()
    line_of(arm).servos[1].write("goal_position", 3000)
    halted = servo_group(arm).hold_measured(TESTED)
    assert halted.held == servo_group(arm).names
    goal, present = (registers(arm, name)[1] for name in ("goal_position", "present_position"))
    assert abs(goal - present) < 40
    assert before <= goal < before + 200


def test_resting_servo_keeps_its_goal_at_a_stop(arm):
    arm.move_joints({"gripper": 0.6})
    before = registers(arm, "goal_position")
    servo_group(arm).hold_measured(TESTED)
    assert registers(arm, "goal_position") == before


def test_stop_names_silent_servo_and_holds_others(arm):
    arm.hold()
    line_of(arm).servos[3].power_down()
    halted = servo_group(arm).hold_measured(TESTED)
    assert halted.silent == ("elbow_flex",)
    assert len(halted.held) == 5


@pytest.mark.full
def test_resting_arm_with_payload_keeps_its_goals_at_a_stop():
    # its goals lead it by more than 0.12 rad: without its masses known it counted as moving
    leaning = {"shoulder": 1.0, "elbow": -0.6}
    with ikservo.open_arm(
        "vx300s", port="sim:?pose=home&payload_g=750", collisions=False
    ) as loaded:
        loaded.enable()
        loaded.move_joints(leaning, speed="slow")
        servos, before = servo_group(loaded), registers(loaded, "goal_position")
        present = registers(loaded, "present_position")
        assert max(abs(before[i] - present[i]) for i in before) > 78
        hold_servos(servos._bus, remote._nominal_limits(loaded.model), servos.clock)
        assert registers(loaded, "goal_position") == before


def test_stop_waits_for_program_that_has_just_opened_port(arm, device, monkeypatch):
    stopped = control_client.StopResult("so101", device, True, ("gripper",), (), ())
    answers = iter([None, None, encode_value(stopped)])
    monkeypatch.setattr(control_client, "send_command", lambda *_: next(answers))

    def busy(*_):
        raise PortBusyError(device)

    monkeypatch.setattr(remote, "halt_line", busy)
    assert remote.stop_arm(arm.model, None).moving


def test_stop_gives_up_after_3_s_on_program_not_listening(arm, device, monkeypatch):
    monkeypatch.setattr(control_client, "send_command", lambda *_: None)

    def busy(*_):
        raise PortBusyError(device)

    monkeypatch.setattr(remote, "halt_line", busy)
    clock = VirtualClock()
    with pytest.raises(PortBusyError):
        remote.stop_arm(arm.model, None, clock)
    assert clock.now_s() == pytest.approx(3.0, abs=0.05)
