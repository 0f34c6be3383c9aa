"""Limits in the servos' RAM: written at the start, by speed class, and reported if lost."""

import pytest

import ikservo
from ikservo.errors import ServoAlarmError
from tests.arm.simulated import clock_of, line_of, registers, servo_id, true_joints


@pytest.fixture
def sts():
    with ikservo.open_arm("so101", port="sim") as machine:
        yield machine


@pytest.fixture
def x_series():
    with ikservo.open_arm("koch", port="sim") as machine:
        yield machine


def joint(arm):
    return arm.model.joints[0].name


@pytest.mark.full
@pytest.mark.sample(1)
@pytest.mark.parametrize(("speed", "deg_s"), [("slow", 25), ("normal", 60), ("fast", 120)])
def test_feetech_goal_speed_is_at_most_1_3_times_motion_speed(sts, speed, deg_s):
    sts.move_joints({joint(sts): 0.05})
    sts.move_joints({joint(sts): 0.0}, speed=speed)
    ticks_s = deg_s * 4096 / 360
    assert all(ticks_s < v <= 1.3 * ticks_s for v in registers(sts, "goal_speed").values())
    assert set(registers(sts, "acceleration").values()) == {0}  # no ramp between two goals


@pytest.mark.sample(1)
@pytest.mark.parametrize(("speed", "deg_s"), [("slow", 25), ("normal", 60), ("fast", 120)])
def test_dynamixel_profile_is_at_most_1_3_times_motion_speed(x_series, speed, deg_s):
    x_series.move_joints({joint(x_series): 0.05})
    x_series.move_joints({joint(x_series): 0.0}, speed=speed)
    counts = deg_s / 6 / 0.229
    assert all(counts < v <= 1.3 * counts for v in registers(x_series, "profile_velocity").values())
    assert set(registers(x_series, "profile_acceleration").values()) == {0}  # no ramp either


@pytest.mark.full
def test_feetech_speed_unit_of_50_steps_is_respected(sts):
    line_of(sts).servos[1].memory.put("phase", 8)
    sts.move_joints({joint(sts): 0.05})
    sts.move_joints({joint(sts): 0.0}, speed="fast")
    assert 27 <= line_of(sts).servos[1].read("goal_speed") <= 36


def test_torque_limit_left_by_another_program_is_removed(sts):
    line_of(sts).servos[3].write("torque_limit", 100)
    sts.enable()
    assert registers(sts, "torque_limit") == registers(sts, "max_torque")


@pytest.mark.full
def test_servo_watchdog_is_active_only_while_goals_are_streamed(x_series):
    seen = []

    def check(_):
        seen.append(set(registers(x_series, "bus_watchdog").values()))

    x_series.move_joints({joint(x_series): 0.2}, on_progress=check)
    clock = clock_of(x_series)
    clock.sleep_until(clock.now_s() + 1.0)
    assert seen[5] == {5}
    assert set(registers(x_series, "bus_watchdog").values()) == {0}


def test_servo_watchdog_is_not_used_on_joint_that_would_sink():
    with ikservo.open_arm("wx250s", port="sim", collisions=False) as arm:
        seen = []
        arm.move_joints(
            {"waist": 0.1}, on_progress=lambda _: seen.append(registers(arm, "bus_watchdog"))
        )
        armed = [seen[5][servo_id("wx250s", name)] for name in ("waist", "shoulder", "elbow")]
        assert armed == [5, 0, 5]


def test_lost_profile_speed_is_reported_as_servo_reset(sts):
    def lose(progress):
        if progress.elapsed_s > 0.2:
            line_of(sts).servos[4].memory.put("goal_speed", 0)

    with pytest.raises(ServoAlarmError, match="wrist_flex was reset: settings lost"):
        sts.move_joints({joint(sts): 0.8}, on_progress=lose)


def test_low_dynamixel_gains_are_raised_to_carry_the_arm(x_series):
    x_series.enable()
    gains = [registers(x_series, f"position_{part}_gain") for part in "pid"]
    assert {tuple(gain[i] for gain in gains) for i in (3, 4, 5)} == {(1500, 0, 600)}
    assert {tuple(gain[i] for gain in gains) for i in (1, 2)} == {(1000, 0, 4000)}
    assert gains[0][6] == 800


BACK = {"joint2": -1.85, "joint3": -1.48, "joint4": 0.0}
FRONT = {"shoulder": 0.87, "elbow": -0.7, "wrist_angle": 0.0}


@pytest.mark.sample(1)
@pytest.mark.parametrize(("name", "low", "up"), [
    ("omx_f", BACK, {"joint2": -0.87}), ("wx250s", FRONT, {"shoulder": 0.35}),
])  # fmt: skip
def test_far_reaching_arm_is_lifted_at_slow_speed(name, low, up):
    with ikservo.open_arm(name, port="sim") as arm:
        arm.move_joints(low)
        arm.move_joints(up, speed="slow")
        joint, goal = next(iter(up.items()))
        assert true_joints(arm)[joint] == pytest.approx(goal, abs=0.01)


def test_time_based_profile_set_with_torque_off_is_respected(x_series):
    x_series.enable()
    servo = line_of(x_series).servos[4]
    assert servo.read("profile_velocity") > 0
    x_series.disable_torque()
    servo.memory.put("drive_mode", servo.read("drive_mode") | 0b100)
    x_series.enable()
    assert servo.read("profile_velocity") == 0
