"""An opened arm uses its own zeros and ranges, and refuses whatever contradicts them."""

import math
from datetime import UTC, datetime
from itertools import combinations

import pytest

import ikservo
from ikservo.apps.calibrating.calibration_result import CalibrationResult
from ikservo.apps.calibrating.calibration_session import TorqueOffArm
from ikservo.arm import ZeroSource
from ikservo.calibration import JointMap, Limits
from ikservo.calibration.joint_map import Encoder
from ikservo.errors import CalibrationError, RefusedError
from ikservo.planning.calibrated_arm import limit_to_one_turn, load_calibration_for
from tests.calibration.factories import make_calibration
from tests.calibration.mounted_arms import load_model, make_mounted_arm

WHEN = datetime(2026, 11, 2, 14, 3, 22, tzinfo=UTC)


@pytest.fixture(autouse=True)
def _home(tmp_path, monkeypatch):
    monkeypatch.setenv("IKSERVO_HOME", str(tmp_path))


@pytest.fixture
def mount_arm(monkeypatch):
    """Return a function that mounts a hidden, calibrated arm."""

    def put(name, seed=4, **how):
        arm = make_mounted_arm(name, seed, spoiled=False, **how)

        def open_transport(port, baud_rate):
            arm.port.is_open = True
            return arm.port

        monkeypatch.setattr("ikservo.hardware.port.open_transport", open_transport)
        with arm.open_limp() as limp_arm:
            calibration = make_calibration(arm, limp_arm, WHEN)
            memory = {s.id: s.holds for joint in calibration.joints for s in joint.servos}
            limp_arm.save(CalibrationResult(calibration, memory))
        return arm

    return put


def opened(arm, **how):
    return ikservo.open_arm(load_model(arm.name), f"bench:{arm.name}", collisions=False, **how)


def test_calibrated_arm_reports_true_joint_positions(mount_arm):
    arm = mount_arm("so101")
    with opened(arm) as machine:
        assert machine.zeros is ZeroSource.CALIBRATED
        for state in machine.where().joints:
            truth = arm.true_position(state.name)
            assert state.position_rad == pytest.approx(truth, abs=math.radians(0.2)), state.name


def test_joint_reaches_goal_for_any_servo_mounting(mount_arm):
    arm = mount_arm("koch", 6)
    with opened(arm) as machine:
        here = {state.name: state.position_rad for state in machine.where().joints}
        machine.move_joints({name: position + 0.1 for name, position in here.items()})
        for name, position in here.items():
            assert arm.true_position(name) == pytest.approx(position + 0.1, abs=math.radians(1.0))


@pytest.mark.parametrize("boots_at", [-0.4, 0.0, 0.4])
def test_multi_turn_servo_position_is_on_right_turn_after_boot(mount_arm, boots_at):
    arm = mount_arm(
        "planar3", zero=0.0, sign=1
    )  # the wrap-around lies in the middle of each travel
    for joint in arm.world.joints:
        arm.world.place(joint.name, arm.joint(joint.name).position + boots_at)
    arm.power_cycle()
    with arm.open_bus() as bus:
        bus.clock.sleep_until(bus.clock.now_s() + 0.5)
        own = load_calibration_for(bus, load_model("planar3"))
        for joint in load_model("planar3").joints:
            tick = arm.register(joint.servo.id, "present_position")
            found = own.joint_map(joint).position(tick)
            assert found == pytest.approx(arm.true_position(joint.name), abs=0.004)


def test_limit_source_is_sweep_or_arm_file_not_servo_register(mount_arm):
    with opened(mount_arm("so101")) as machine:
        sources = {state.limit_from for state in machine.where().joints}
    assert any("hand sweep of 2026-11-02" in source for source in sources)
    assert not any("servo register" in source for source in sources)


def swap(arm, one, other):
    """Exchange the ids of two servos, so that each turns the other's joint."""
    memories = [arm.line.servos[i].memory for i in (one, other)]
    for memory, new in zip(memories, (other, one), strict=True):
        memory.put("id", new)
        memory.persist_value("id")


@pytest.mark.parametrize("pair", [*combinations(range(1, 7), 2)], ids=str)
def test_swapped_servo_ids_are_detected(mount_arm, pair):
    arm = mount_arm("so101")
    swap(arm, *pair)
    with pytest.raises(CalibrationError, match=r"in the servo and .* in the calibration"):
        opened(arm)


@pytest.mark.parametrize(("register", "number"), [
    ("homing_offset", 900), ("min_position_limit", 5), ("max_position_limit", 4000),
    ("operating_mode", 1), ("phase", 28),
])  # fmt: skip
def test_open_refuses_register_changed_since_calibration(mount_arm, register, number):
    arm = mount_arm("so101")
    servo = arm.line.servos[3]
    servo.write("lock", 0)
    servo.write(register, number)
    with pytest.raises(CalibrationError, match=rf"{register} of elbow_flex \(id 3\) is {number} "):
        opened(arm)


def test_changed_servo_gains_do_not_invalidate_calibration(mount_arm):
    arm = mount_arm("so101")
    servo = arm.line.servos[3]
    servo.write("lock", 0)
    servo.write("p_gain", 17)
    servo.write("phase", 12 ^ 0b100)  # the unit of speeds
    with opened(arm) as machine:
        assert machine.zeros is ZeroSource.CALIBRATED


def test_using_calibrated_arm_does_not_write_its_eeprom(mount_arm):
    arm = mount_arm("so101")
    writes = arm.eeprom_writes()
    with opened(arm) as machine:
        machine.move_joints({"wrist_roll": machine.where().joints[4].position_rad + 0.1})
    assert arm.eeprom_writes() == writes


def test_arm_with_factory_zeros_does_not_need_calibration():
    arm = make_mounted_arm("px100", 4, zero=2048, sign=1)
    with arm.open_bus() as bus:
        assert load_calibration_for(bus, load_model("px100")).zeros is ZeroSource.VENDOR


def test_uncalibrated_arm_takes_limits_from_servo_registers():
    arm = make_mounted_arm("so101", 4, zero=500, spoiled=False)
    with arm.open_bus() as bus:
        own = load_calibration_for(bus, load_model("so101"))
        joint = load_model("so101").joints[2]
        limits = own.limits(joint, own.joint_map(joint))
    assert own.zeros is ZeroSource.UNKNOWN
    assert limits.source == "servo register"


def test_torque_on_is_refused_if_joint_is_on_another_turn(mount_arm):
    arm = mount_arm("planar3", zero=2048.0, sign=1)
    # Turned right round by hand while limp: the servo counts on until torque comes.
    arm.joint("joint1").servos[0].motor.upper_stop_rad = math.inf
    arm.world.place("joint1", math.radians(200))
    with opened(arm) as machine, pytest.raises(RefusedError, match="joint1 is at tick"):
        machine.enable()
    assert not any(servo.read("torque_enable") for servo in arm.line.servos.values())


def test_joint_slightly_outside_limit_is_moved_back(mount_arm):
    arm = mount_arm("planar3", zero=2048.0, sign=1)
    with opened(arm) as machine:
        upper = machine.where().joints[0].upper_rad
    arm.world.place("joint1", upper + math.radians(3))
    with opened(arm) as machine:
        machine.enable()
        machine.move_joints({"joint1": upper - 0.05})
    assert arm.true_position("joint1") == pytest.approx(upper - 0.05, abs=math.radians(1))


def test_raw_ticks_of_limp_arm_exclude_homing_offset():
    arm = make_mounted_arm("so101", 9)
    with arm.open_limp() as limp_arm:
        _, ticks = limp_arm.read_ticks()
        assert isinstance(limp_arm, TorqueOffArm)
    for servo_id, tick in ticks.items():
        shaft = arm.line.servos[servo_id].shaft
        motor = arm.line.servos[servo_id].motor
        assert tick == shaft.tick_at(motor.encoder_rad) % 4096


def test_continuous_joint_is_limited_to_one_turn_of_its_servo():
    joint_map = JointMap.revolute("waist", 1, 1, 2048, 4096)
    endless = Limits.of("waist", -math.inf, math.inf, "arm file")
    limits = limit_to_one_turn(endless, joint_map, Encoder(4096, 4096.0))
    assert limits.source == "one turn of its servo"
    assert limits.upper.value == pytest.approx(math.pi, abs=0.01)


def test_servo_eeproms_are_backed_up_once_at_first_opening(mount_arm, tmp_path):
    arm = mount_arm("so101")
    with opened(arm):
        copies = sorted(path.name for path in (tmp_path / "backups").rglob("*.toml"))
    assert copies == [f"id_00{i}_STS3215.toml" for i in range(1, 7)]
    before = {path: path.stat().st_mtime_ns for path in (tmp_path / "backups").rglob("*.toml")}
    with opened(arm):
        pass
    after = {path: path.stat().st_mtime_ns for path in (tmp_path / "backups").rglob("*.toml")}
    assert after == before


def test_simulated_arm_does_not_make_eeprom_backup(tmp_path):
    with ikservo.open_arm("so101", port="sim"):
        pass
    assert not (tmp_path / "backups").exists()
