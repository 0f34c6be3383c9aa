"""After a fault in mid-motion the arm stops, names the joint, and stays stopped."""

import pytest

import ikservo
from ikservo.errors import (
    BadValueError,
    PortError,
    PortLostError,
    RefusedError,
    ServoAlarmError,
    ServoSilentError,
)
from servosim.faults import Fault
from tests.arm.audit import Auditor
from tests.arm.simulated import clock_of, line_of, registers, servo_group, servo_id, transport_of

pytestmark = pytest.mark.smoke


@pytest.fixture
def arm():
    with ikservo.open_arm("so101", port="sim", collisions=False) as machine:
        machine.enable()
        yield machine


@pytest.fixture(params=["so101", "koch"])
def either(request):
    """Return an arm of each family."""
    with ikservo.open_arm(request.param, port="sim", collisions=False) as machine:
        machine.enable()
        yield machine


def inject(arm, kind, after_s=0.4, **details):
    """Start a fault at a time of the motion; return that time."""
    line = line_of(arm)
    at_s = line.world.time_s + after_s
    line.faults.add(Fault(kind, at_s=at_s, **details))
    return at_s


def swing(arm, way_rad=0.4):
    """Move every joint of the arm far."""
    here = zip(
        servo_group(arm).driven_joints, servo_group(arm).measured_hold_positions(), strict=True
    )
    goals = {
        driven.joint: at + (way_rad if at < sum(driven.position_range) / 2 else -way_rad)
        for driven, at in here
    }
    return arm.move_joints(goals)


def wait(arm, seconds):
    clock = clock_of(arm)
    clock.sleep_until(clock.now_s() + seconds)


def joint_of(arm, servo):
    return next(j.name for j in arm.model.joints if j.servo.id == servo)


@pytest.mark.sample(1)
def test_error_names_silent_servo_and_others_stop_in_3_cycles(either):
    auditor = Auditor(either)
    lost_s = inject(either, "silent", id=3)
    with pytest.raises(ServoSilentError, match=rf"{joint_of(either, 3)} \(id 3\)"):
        swing(either)
    cycle_times_s = {goal.time_s for goal in auditor.goals_after(lost_s)}
    assert len(cycle_times_s) <= 4  # three, and the one that holds
    assert all(registers(either, "torque_enable").values())


@pytest.mark.full
def test_motion_continues_with_10_percent_of_replies_lost(arm):
    inject(arm, "silent", after_s=0.0, probability=0.1)
    swing(arm)


@pytest.mark.full
def test_motion_reaches_goal_with_10_percent_instructions_lost():
    with ikservo.open_arm("so101", port="sim") as arm:
        arm.enable()
        inject(arm, "lost", after_s=0.0, probability=0.1)
        assert arm.move_joints({"shoulder_pan": 0.4}).reached


@pytest.mark.sample(1)
def test_servo_reset_is_noticed_and_torque_stays_off(either):
    auditor = Auditor(either)
    reset_s = inject(either, "reset", id=2)
    with pytest.raises(
        (ServoAlarmError, ServoSilentError, RefusedError), match=joint_of(either, 2)
    ):
        swing(either)
    assert line_of(either).world.time_s - reset_s < 0.5
    wait(either, 2.0)
    with pytest.raises(RefusedError, match="arm was stopped"):
        swing(either)
    assert not auditor.torque_on_after(reset_s)


@pytest.mark.full
@pytest.mark.sample(1)
def test_arm_moves_after_brown_out_only_if_acknowledged(either):
    auditor = Auditor(either)
    gone_s = inject(either, "brownout", for_s=0.3)
    with pytest.raises((ServoAlarmError, ServoSilentError)):
        swing(either)
    wait(either, 2.0)
    with pytest.raises(RefusedError, match="arm was stopped"):
        swing(either)
    assert not auditor.torque_on_after(gone_s)
    either.acknowledge()
    swing(either)
    assert auditor.faults() == []


def test_pulled_cable_is_reported_within_100_ms(arm):
    pulled_s = inject(arm, "unplug")
    with pytest.raises(PortLostError):
        swing(arm)
    assert line_of(arm).world.time_s - pulled_s < 0.1


@pytest.mark.full
@pytest.mark.sample(1)
def test_reconnected_arm_moves_only_if_acknowledged(either, monkeypatch):
    transport = transport_of(either)
    again = "ikservo.hardware.port_names.open_transport"
    monkeypatch.setattr(again, lambda *_: setattr(transport, "is_open", True) or transport)
    inject(either, "unplug", for_s=0.5)
    with pytest.raises(PortLostError):
        swing(either)
    wait(either, 1.0)
    either.reconnect(within_s=1.0)
    with pytest.raises(RefusedError, match="arm was stopped"):
        swing(either)
    either.acknowledge()
    assert either.plan_joints({either.model.joints[0].name: 0.3}, speed="fast").speed == "slow"
    swing(either)


@pytest.mark.parametrize("within_s", [float("nan"), -1.0, float("inf"), "soon"])
def test_reconnect_refuses_invalid_time_out(arm, within_s):
    with pytest.raises(BadValueError):
        arm.reconnect(within_s)


def test_dynamixel_watchdog_stops_servos_without_packets():
    with ikservo.open_arm("koch", port="sim") as arm:
        arm.enable()
        inject(arm, "unplug")
        with pytest.raises(PortLostError):
            arm.move_joints({"shoulder_pan": 1.0}, speed="fast")
        clock_of(arm).sleep_until(clock_of(arm).now_s() + 0.5)
        assert set(registers(arm, "bus_watchdog").values()) == {-1}
        goals, present = registers(arm, "goal_position"), registers(arm, "present_position")
        assert abs(goals[1] - present[1]) <= 12


@pytest.mark.full
def test_dynamixel_stopped_by_watchdog_moves_after_enable():
    with ikservo.open_arm("koch", port="sim:?pose=home") as arm:
        arm.enable()
        for servo in line_of(arm).servos.values():
            servo.memory.put("bus_watchdog", -1)
        arm.enable()
        assert set(registers(arm, "bus_watchdog").values()) == {0}
        swing(arm)


@pytest.mark.sample(1)
def test_overload_alarm_makes_joint_hold_its_position(either):
    inject(either, "alarm", id=2, bits=0x20)
    with pytest.raises(ServoAlarmError, match=rf"{joint_of(either, 2)} .*overload") as caught:
        swing(either)
    assert caught.value.exit_code == 5
    servo = line_of(either).servos[2]
    assert abs(servo.read("goal_position") - servo.read("present_position")) < 40


@pytest.mark.sample(1)
@pytest.mark.parametrize(
    ("kind", "details", "words"),
    [("hot", {"celsius": 66.0}, "6[56] °C"), ("voltage", {"volts": 3.9}, "supply|alarm|voltage")],
)
def test_servo_alarm_error_names_temperature_or_voltage(kind, details, words):
    with ikservo.open_arm("so101", port="sim") as arm:
        arm.enable()
        inject(arm, kind, **details)
        with pytest.raises(ServoAlarmError, match=words):
            swing(arm)


@pytest.mark.full
def test_arm_stops_if_a_joint_loses_torque_without_alarm():
    with ikservo.open_arm("so101", port="sim") as arm:
        swing(arm)
        # the forearm weighs 0.43 N m, twice what friction holds; on the shoulder it is 0.07
        inject(arm, "torque_lost", id=3)
        with pytest.raises(RefusedError, match="elbow_flex does not follow"):
            arm.move_joints({"shoulder_pan": 1.2})


def test_jammed_joint_stops_motion_and_goal_is_set_to_position(arm):
    name = joint_of(arm, 1)
    auditor = Auditor(arm)
    inject(arm, "stuck", id=1)
    with pytest.raises(RefusedError, match=f"{name} does not follow"):
        arm.move_joints({name: 1.2}, speed="fast")
    wait(arm, 0.01)
    assert auditor.faults() == []
    pan = line_of(arm).servos[1]
    assert pan.read("goal_position") == pan.read("present_position")


@pytest.mark.full
def test_jammed_arm_moves_again_once_acknowledged(arm):
    inject(arm, "stuck", id=1, for_s=2.0)
    with pytest.raises(RefusedError, match="does not follow"):
        arm.move_joints({joint_of(arm, 1): 1.0})
    wait(arm, 3.0)
    assert "does not follow" in arm.stopped_for
    arm.acknowledge()
    swing(arm)


def test_ordinary_motions_do_not_write_eeprom(arm):
    auditor = Auditor(arm)
    swing(arm, 0.1)
    arm.disable_torque()
    assert auditor.faults() == []


def test_closed_arm_raises_port_error(arm):
    arm.close()
    with pytest.raises(PortError, match="was closed"):
        arm.where()


def test_joints_turned_by_hand_do_not_jump_back_at_torque_on():
    with ikservo.open_arm("so101", port="sim") as arm:
        world = line_of(arm).world
        arm.enable()
        arm.disable_torque()
        world.place("shoulder_pan", 0.7)
        world.place("wrist_roll", -0.9)
        before = registers(arm, "present_position")
        arm.enable()
        wait(arm, 0.2)
        after = registers(arm, "present_position")
    pan, roll = servo_id("so101", "shoulder_pan"), servo_id("so101", "wrist_roll")
    assert abs(after[pan] - before[pan]) <= 2
    assert abs(after[roll] - before[roll]) <= 2


def test_arm_stops_if_a_servo_reports_no_status(arm, monkeypatch):
    arm.enable()
    monkeypatch.setattr(servo_group(arm)._health_poller, "_read_registers", lambda *_: None)
    with pytest.raises(RefusedError, match=r"No status \(temperature, voltage, load\) from"):
        arm.move_joints({"shoulder_pan": 0.8})


@pytest.mark.sample(1)
@pytest.mark.parametrize(("for_s", "silent"), [(1e3, ""), (0.02, ""), (0.02, "4")])
def test_error_reports_power_cut_during_motion(either, for_s, silent):
    world = line_of(either).world
    servos = {servo.id: servo for servo in world.servos}

    def restore():
        for number, servo in servos.items():
            if str(number) != silent:
                servo.power_up()

    def cut():
        for servo in servos.values():
            servo.power_down()
        world.schedule(world.time_s + for_s, restore)

    world.schedule(world.time_s + 0.5, cut)
    expected = (ServoSilentError, ServoAlarmError)
    with pytest.raises(expected, match="lost its power, has fallen and") as caught:
        swing(either)
    assert isinstance(caught.value, ServoSilentError) == bool(silent or for_s > 1.0)
    if silent:
        assert joint_of(either, 4) in caught.value.message
    assert "lost its power" in either.stopped_for


def cut_power_of_one(arm, servo_id, after_s, for_s):
    """Let one servo lose its power so long after now, for a time."""
    world, servo = line_of(arm).world, line_of(arm).servos[servo_id]
    world.schedule(world.time_s + after_s, servo.power_down)
    world.schedule(world.time_s + after_s + for_s, servo.power_up)


@pytest.mark.sample(1)
@pytest.mark.parametrize(("for_s", "fallen"), [(1e3, "if it has no power"), (0.0, "")])
def test_power_loss_error_names_fallen_joint_and_arm_holds(either, for_s, fallen):
    cut_power_of_one(either, 3, 0.5, for_s)
    with pytest.raises((ServoSilentError, ServoAlarmError)) as caught:
        swing(either)
    joint, message = joint_of(either, 3), caught.value.message
    assert f"{joint} has fallen and " in message
    assert message.endswith(f"{fallen}; the other joints hold.")
    if not for_s:
        limp = not registers(either, "torque_enable")[3]
        assert ("is limp" if limp else "holds where it is now") in message
    assert "the other joints hold" in either.stopped_for


def test_power_loss_error_names_both_fallen_joints(either):
    for number in (1, 3):
        cut_power_of_one(either, number, 0.5, 1e3)
    both = f"{joint_of(either, 1)}, {joint_of(either, 3)} have fallen and are limp if they have no"
    with pytest.raises(ServoSilentError, match=both):
        swing(either)


def test_error_names_joint_that_fell_at_rest_and_arm_recovers(either):
    either.pose("home")
    cut_power_of_one(either, 3, 0.0, 0.05)
    wait(either, 1.0)
    fallen = line_of(either).world.joint(joint_of(either, 3)).position
    with pytest.raises(ServoAlarmError, match=r"is limp and has fallen.*other joints hold"):
        either.move_joints({"shoulder_pan": 0.3})
    assert line_of(either).world.joint(joint_of(either, 3)).position == pytest.approx(
        fallen, abs=0.05
    )
    assert either.move_joints({"shoulder_pan": 0.3}).reached
