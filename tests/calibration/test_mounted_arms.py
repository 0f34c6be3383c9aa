"""A scripted operator calibrates arms with unknown mounting; the simulated truth judges."""

import math
from datetime import UTC, datetime

import pytest

from ikservo.planning.calibrated_arm import load_calibration_for
from tests.calibration.mounted_arms import load_model, make_mounted_arm, run_to_review
from tests.oracle import ARMS

MARGIN_RAD = math.radians(0.3)
HALF_A_DEGREE = math.radians(0.5)
WHEN = datetime(2026, 11, 2, 14, 3, 22, tzinfo=UTC)


@pytest.fixture(autouse=True)
def _home(tmp_path, monkeypatch):
    monkeypatch.setenv("IKSERVO_HOME", str(tmp_path))


def calibrated(arm):
    """Calibrate an arm and return what was saved, by joint."""
    with arm.open_limp() as limp_arm:
        state = run_to_review(limp_arm, arm, MARGIN_RAD)
        outcome = limp_arm.build_calibration(state, arm.pose, WHEN, write_limits=True)
        limp_arm.save(outcome)
    return {joint.name: joint for joint in outcome.calibration.joints}


def judge(arm):
    """Compare a calibration with the arm's truth; the first wrong joint fails the test."""
    joints = calibrated(arm)
    model = load_model(arm.name)
    for joint in model.joints:
        check_limits(arm, joint, joints[joint.name])
        check_registers(arm, joint, joints[joint.name])
    check_zeros_and_signs(arm, model)


def check_limits(arm, joint, found):
    """Check that each swept limit is inside its true stop, and within half a degree of it."""
    low, high = arm.stops[joint.name]
    scale = joint.travel_per_turn / math.tau
    if found.swept == "not swept":
        assert math.isinf(low), joint.name
        return
    swept = [end + arm.held[joint.name] for end in found.recorded_range()]
    assert 0.0 <= swept[0] - low <= HALF_A_DEGREE * scale, joint.name
    assert 0.0 <= high - swept[1] <= HALF_A_DEGREE * scale, joint.name


def check_registers(arm, joint, found):
    """Check that offsets are in range, and that the servos' limits are those of the file."""
    for servo in found.servos:
        for name, number in servo.holds.items():
            assert arm.register(servo.id, name) == number, f"{joint.name} {name}"
        offset = servo.holds["homing_offset"]
        assert abs(offset) <= (2047 if servo.model.startswith("STS") else 1024)
        if servo.model.startswith("STS"):
            assert servo.holds["phase"] & 0b10000 == 0
    if found.extended:
        return
    assert 0 <= found.travel_ticks[0] < found.travel_ticks[1] <= 4095
    placed = found.joint_map(joint.joint_map)
    ends = (found.servo.holds["min_position_limit"], found.servo.holds["max_position_limit"])
    lower, upper = sorted(placed.position(tick) for tick in ends)
    assert lower + arm.held[joint.name] >= arm.stops[joint.name][0]
    assert upper + arm.held[joint.name] <= arm.stops[joint.name][1]
    assert lower >= joint.limits.lower.value - 1e-9
    assert upper <= joint.limits.upper.value + 1e-9


def place_all(arm, model, share):
    """Place each joint at a fraction of the range inside both its stops and its limits."""
    for joint in model.joints:
        low = max(arm.stops[joint.name][0], joint.limits.lower.value)
        high = min(arm.stops[joint.name][1], joint.limits.upper.value)
        arm.world.place(joint.name, low + share * (high - low))


def check_zeros_and_signs(arm, model):
    """After a power cycle, check at three places that each reading is the joint's true position."""
    arm.world.hands.clear()
    for share in (0.1, 0.5, 0.9):
        place_all(arm, model, share)
        arm.power_cycle()
        with arm.open_bus() as bus:
            bus.clock.sleep_until(bus.clock.now_s() + 0.5)  # servos boot
            own = load_calibration_for(bus, model)
            for joint in model.joints:
                joint_map = own.joint_map(joint)
                tick = arm.register(joint.servo.id, "present_position")
                truth = arm.true_position(joint.name) - arm.held[joint.name]
                error = joint_map.position(tick) - truth
                if math.isinf(arm.stops[joint.name][0]):  # limp, it may have turned round
                    error = math.remainder(error, 2 * math.pi)
                assert abs(error) <= 2 * joint_map.unit_per_tick, joint.name
                for shadow in joint.shadows:  # both obey one goal, so they must count alike
                    other = arm.register(shadow.id, "present_position")
                    assert abs(other - tick) <= 4, joint.name


@pytest.mark.full
@pytest.mark.sample(3)
@pytest.mark.parametrize("name", ARMS)
def test_simulated_calibration_finds_hidden_zeros_and_signs(name):
    judge(make_mounted_arm(name, 1))


@pytest.mark.campaign
@pytest.mark.parametrize("seed", range(100, 120))
@pytest.mark.parametrize("name", ARMS)
def test_calibration_finds_zeros_and_signs_of_200_arms(name, seed):
    judge(make_mounted_arm(name, seed, gravity=seed % 5 == 0))


def test_simulated_overlapping_links_separate_slowly():
    arm = make_mounted_arm("rx200", 110, gravity=True)
    arm.world.hands.clear()
    fastest, model = 0.0, load_model("rx200")
    for share in (0.1, 0.5, 0.9):
        place_all(arm, model, share)
        arm.power_cycle()
        for _ in range(50):
            arm.world.advance_to(arm.world.time_s + 0.01)
            fastest = max(fastest, *(abs(joint.velocity) for joint in arm.world.joints))
    assert 0.5 < fastest < 30.0  # rad/s; a limp arm falls, and nothing throws it
