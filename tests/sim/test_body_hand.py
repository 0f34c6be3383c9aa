"""Motors on joints under gravity and hands, and the supply of the motors."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from servosim.control import ControlMode, DriveCommand
from servosim.coupling import CoupledJoints
from servosim.dynamics import Dynamics, FreeBody, RigidArm
from servosim.joint import Hand, SimulatedJoint, glide, hold, push, sweep
from servosim.motor import Motor
from servosim.parameters import PARAMETERS
from servosim.servo import HornMounting
from servosim.servo_models import make_servo
from servosim.world import PowerSupply

CONFIGS = Path(__file__).parents[2] / "configs"
JOINTS = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper")
DT_S = 0.001


@dataclass
class Bench:
    """Bare motors on the joints of a body, one each."""

    body: Dynamics
    model: str = "STS3215"
    drive: DriveCommand = field(default_factory=DriveCommand)
    hands: dict[str, Hand] = field(default_factory=dict)

    def __post_init__(self) -> None:
        lower_upper = dict(zip(self.body.names, self.body.limits, strict=True))
        self.motors = {n: Motor(PARAMETERS[self.model], 0.0, *lower_upper[n]) for n in lower_upper}
        servos = {n: make_servo(self.model, m, HornMounting()) for n, m in self.motors.items()}
        self.joints = [SimulatedJoint(name, (servo,)) for name, servo in servos.items()]
        self.coupled = CoupledJoints(self.joints)

    def run(self, seconds: float) -> Bench:
        for joint in self.joints:
            joint.servos[0].drive = self.drive
        for _ in range(round(seconds / DT_S)):
            hands = dict[int, Hand]()
            for k, joint in enumerate(self.joints):
                if joint.name in self.hands:
                    hands[k] = self.hands[joint.name]
                    hands[k].aim(DT_S, joint.position, joint.armature)
            positions = [motor.position_rad for motor in self.motors.values()]
            velocities = [motor.velocity_rad_s for motor in self.motors.values()]
            self.coupled.step(self.body.load_nm(positions, velocities), hands)
        return self


def free(
    model: str = "STS3215", drive: DriveCommand | None = None, hand: Hand | None = None
) -> Bench:
    body = FreeBody(["joint"], [(-1.0, 1.0)])
    return Bench(body, model, drive or DriveCommand(), {} if hand is None else {"joint": hand})


def so101(drive: DriveCommand | None = None) -> Bench:
    return Bench(RigidArm(CONFIGS / "so101" / "arm.urdf", JOINTS), drive=drive or DriveCommand())


def test_simulated_arm_with_torque_off_falls_to_end_stop() -> None:
    arm = so101()
    arm.motors["shoulder_lift"].place(0.8)
    arm.run(3.0)
    assert arm.motors["shoulder_lift"].position_rad == arm.motors["shoulder_lift"].upper_stop_rad


def test_simulated_arm_holds_its_pose_with_torque_on() -> None:
    arm = so101(DriveCommand(torque_on=True)).run(3.0)
    assert [m.position_rad for m in arm.motors.values()] == pytest.approx([0.0] * 6, abs=0.05)
    assert [m.velocity_rad_s for m in arm.motors.values()] == [0.0] * 6


def test_shoulder_sag_is_gravity_torque_over_stiffness() -> None:
    arm = so101(DriveCommand(torque_on=True)).run(3.0)
    positions = [m.position_rad for m in arm.motors.values()]
    load_nm = arm.body.load_nm(positions, positions)[1]
    figures = PARAMETERS["STS3215"]
    held_nm = -positions[1] * 5.3 * figures.duty_torque_nm
    load = figures.load_friction + figures.load_stribeck
    friction_nm = figures.friction_nm + figures.stribeck_nm + load * abs(held_nm - load_nm)
    assert abs(held_nm + load_nm) <= friction_nm


def test_load_inertia_reduces_motor_acceleration() -> None:
    bare, laden = free(drive=DriveCommand(True, mode=ControlMode.PWM, goal_pwm=0.5)), free()
    laden.drive = bare.drive
    laden.motors["joint"].load_inertia_kg_m2 = 0.03
    bare.run(0.03)
    laden.run(0.03)
    share = laden.motors["joint"].velocity_rad_s / bare.motors["joint"].velocity_rad_s
    assert share == pytest.approx(0.0215 / 0.0515, rel=0.25)


def test_simulated_hand_moves_limp_joint_to_its_target() -> None:
    bench = free(hand=Hand(glide(0.0, 0.7, speed=0.5))).run(2.0)
    assert bench.motors["joint"].position_rad == pytest.approx(0.7, abs=0.003)


def test_simulated_hand_holds_limp_arm_against_gravity() -> None:
    arm = so101()
    arm.hands["shoulder_lift"] = Hand(hold(0.4))
    arm.run(2.0)
    assert arm.motors["shoulder_lift"].position_rad == pytest.approx(0.4, abs=0.01)


def test_simulated_hand_sweeps_joint_to_both_end_stops() -> None:
    bench = free(hand=Hand(sweep(0.0, -1.2, 1.2, speed=1.0), limit=3.0))
    seen: list[float] = []
    for _ in range(600):
        seen.append(bench.run(0.01).motors["joint"].position_rad)
    assert (min(seen), max(seen)) == (-1.0, 1.0)


def test_simulated_hand_force_is_limited() -> None:
    hand = Hand(push(-1.0), limit=0.6)
    bench = free(drive=DriveCommand(torque_on=True), hand=hand).run(2.0)
    assert hand.force == -0.6
    assert bench.motors["joint"].torque_nm == pytest.approx(0.6, abs=0.3)


def test_strong_simulated_hand_stalls_motor_at_torque_limit() -> None:
    drive = DriveCommand(torque_on=True, goal_rad=0.5, torque_limit=0.3)
    bench = free(drive=drive, hand=Hand(hold(0.0), limit=10.0)).run(1.0)
    assert abs(bench.motors["joint"].position_rad) < 0.01
    assert bench.motors["joint"].pwm == pytest.approx(0.3)


def test_joint_released_by_simulated_hand_returns_to_goal() -> None:
    bench = free(drive=DriveCommand(torque_on=True), hand=Hand(hold(0.4), limit=10.0)).run(0.5)
    bench.hands.clear()
    bench.run(2.0)
    assert bench.motors["joint"].position_rad == pytest.approx(0.0, abs=0.02)


def test_one_sided_simulated_hand_stops_joint_moving_against_it() -> None:
    drive = DriveCommand(torque_on=True, goal_rad=0.5, torque_limit=0.3)
    bench = free(drive=drive, hand=Hand(hold(0.2), limit=10.0, only=-1)).run(1.0)
    assert bench.motors["joint"].position_rad == pytest.approx(0.2, abs=0.01)


def test_one_sided_simulated_hand_ignores_joint_moving_away() -> None:
    drive = DriveCommand(torque_on=True, goal_rad=-0.5)
    hand = Hand(hold(0.2), limit=10.0, only=-1)
    bench = free(drive=drive, hand=hand).run(1.0)
    assert hand.force == 0.0
    assert bench.motors["joint"].position_rad == pytest.approx(-0.5, abs=0.02)


@pytest.mark.parametrize("model", sorted(PARAMETERS))
def test_simulated_hand_holds_every_servo_without_oscillation(model: str) -> None:
    bench = free(model, hand=Hand(hold(0.2))).run(1.0)
    held_rad = bench.motors["joint"].position_rad
    bench.run(0.01)
    assert bench.motors["joint"].position_rad == pytest.approx(held_rad, abs=1e-5)


def test_supply_voltage_drops_with_current_of_motors() -> None:
    motor = Motor(PARAMETERS["STS3215"])
    motor.stuck = True
    motor.step(DT_S, 0.0, DriveCommand(True, mode=ControlMode.PWM, goal_pwm=1.0), 7.4)
    supply = PowerSupply(open_v=7.4, resistance_ohm=0.2)
    assert supply.voltage_v([motor]) == pytest.approx(7.4 - 0.2 * motor.current_a * motor.pwm)


def test_resting_servo_draws_standby_current_only() -> None:
    supply = PowerSupply(open_v=12.0, resistance_ohm=0.5, standby_a=0.2)
    assert supply.voltage_v([Motor(PARAMETERS["XL430-W250"])]) == pytest.approx(11.9)


def test_simulated_push_has_target_at_infinity() -> None:
    assert push(2.0)(99.0) == (math.inf, 0.0)
