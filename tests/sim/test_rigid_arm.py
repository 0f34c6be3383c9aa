"""Arms under gravity with all joints coupled, compared with Pinocchio and energy conservation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pinocchio
import pytest
from numpy.typing import NDArray

from servosim import coupling, world
from servosim.dynamics import RigidArm
from servosim.joint import STEP_S, SimulatedJoint
from servosim.motor import Motor
from servosim.parameters import PARAMETERS
from servosim.servo import HornMounting
from servosim.servo_models import make_servo
from servosim.world import World
from tests.sim.test_pendulum import FRICTION

Array = NDArray[np.float64]

CONFIGS = Path(__file__).parents[2] / "configs"
ARMS = ("so101", "koch", "px100", "open_manipulator_x", "wx250s", "vx300s")
MODELS = {"so101": "STS3250", "koch": "XL330-M288"}
TWO_SERVOS = ("shoulder", "elbow")  # of wx250s and vx300s


@dataclass
class Oracle:
    """An arm in Pinocchio: joints without a servo are fixed, followers are separate joints."""

    names: tuple[str, ...]
    model: pinocchio.Model

    @classmethod
    def of(cls, arm: str) -> Oracle:
        # A joint may have the name of a link, by which Pinocchio cannot fix it.
        text = (CONFIGS / arm / "arm.urdf").read_text(encoding="utf-8")
        text = text.replace('joint name="', 'joint name="j:')
        text = text.replace('mimic joint="', 'mimic joint="j:')
        model = pinocchio.buildModelFromXML(text)
        every = list(model.names)[1:]
        moved = [name for name in every if "finger" not in name and "gripper" not in name]
        fixed = [model.getJointId(name) for name in every if name not in moved]
        reduced = pinocchio.buildReducedModel(model, fixed, _rest(model))
        return cls(tuple(name[2:] for name in moved), reduced)

    def accelerations(self, q: Array, v: Array, torques: Array, armature: Array) -> Array:
        self.model.armature = armature
        return pinocchio.aba(self.model, self.model.createData(), q, v, torques)

    def energy_j(self, q: Array, v: Array, armature: Array) -> float:
        data = self.model.createData()
        kinetic = pinocchio.computeKineticEnergy(self.model, data, q, v)
        potential = pinocchio.computePotentialEnergy(self.model, data, q)
        return kinetic + potential + float(armature @ (v * v)) / 2.0


def _rest(model: pinocchio.Model) -> Array:
    return np.clip(np.zeros(model.nq), model.lowerPositionLimit, model.upperPositionLimit)


class LimpArm:
    """An arm with torque off whose motors have no friction, backlash or stops."""

    def __init__(self, arm: str, start: Sequence[float]) -> None:
        self.oracle = Oracle.of(arm)
        self.oracle.model.gravity.linear = np.array((0.0, 0.0, -9.81))
        body = RigidArm(CONFIGS / arm / "arm.urdf", self.oracle.names)
        model = MODELS.get(arm, "XM430-W350")
        ideal = replace(PARAMETERS[model], **dict.fromkeys(FRICTION, 0.0))
        joints = [
            self._joint(name, model, [Motor(ideal, at) for _ in range(self._servos(arm, name))])
            for name, at in zip(self.oracle.names, start, strict=True)
        ]
        self.world = World(joints, body)
        self.armature = np.array([ideal.armature_kg_m2 * len(j.servos) for j in joints])

    def _servos(self, arm: str, name: str) -> int:
        return 2 if arm in ("wx250s", "vx300s") and name in TWO_SERVOS else 1

    def _joint(self, name: str, model: str, motors: Sequence[Motor]) -> SimulatedJoint:
        servos = [make_servo(model, m, HornMounting(1, 2048, 4096), {"id": 1}) for m in motors]
        return SimulatedJoint(name, tuple(servos))

    def state(self) -> tuple[Array, Array]:
        joints = self.world.joints
        return np.array([j.position for j in joints]), np.array([j.velocity for j in joints])

    def set_velocities(self, velocities: Array) -> None:
        for joint, velocity in zip(self.world.joints, velocities, strict=True):
            joint.set_state(joint.position, velocity)

    def energy_j(self) -> float:
        return self.oracle.energy_j(*self.state(), self.armature)


def random_states(arm: str, count: int) -> list[tuple[Array, Array, Array]]:
    rng, size = np.random.default_rng(3), len(Oracle.of(arm).names)
    return [
        (rng.uniform(-1.0, 1.0, size), rng.normal(size=size), rng.normal(size=size))
        for _ in range(count)
    ]


@pytest.mark.parametrize("arm", ARMS)
def test_accelerations_with_armature_equal_pinocchio(arm: str) -> None:
    oracle = Oracle.of(arm)
    body = RigidArm(CONFIGS / arm / "arm.urdf", oracle.names)
    for q, v, torques in random_states(arm, 20):
        armature = np.abs(torques) / 10.0
        M = np.array(body.mass_matrix(q.tolist())) + np.diag(armature)
        ours = np.linalg.solve(M, torques + body.load_nm(q.tolist(), (3.0 * v).tolist()))
        expected = oracle.accelerations(q, 3.0 * v, torques, armature)
        assert ours == pytest.approx(expected, rel=1e-6, abs=1e-6)


@pytest.mark.parametrize("arm", ARMS)
def test_accelerations_near_cached_posture_equal_pinocchio(arm: str) -> None:
    oracle = Oracle.of(arm)
    body = RigidArm(CONFIGS / arm / "arm.urdf", oracle.names)
    for q, v, moved in random_states(arm, 10):
        body.load_nm(q.tolist(), v.tolist())
        there = q + 0.01 * moved / np.abs(moved).max()
        none = np.zeros(len(q))
        M = np.array(body.mass_matrix(there.tolist())) + np.diag(none + 0.01)
        ours = np.linalg.solve(M, body.load_nm(there.tolist(), v.tolist()))
        expected = oracle.accelerations(there, v, none, none + 0.01)
        assert ours == pytest.approx(expected, abs=0.01 * np.abs(expected).max())


@pytest.mark.sample(3)
@pytest.mark.parametrize("arm", ARMS)
def test_accelerations_of_moving_limp_arm_equal_pinocchio(
    arm: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(coupling, "EXACT_RAD_S", 1e-9)
    for name in ("LOAD_STEPS", "MASS_STEPS"):
        monkeypatch.setattr(world, name, 1)
    for q, v, _ in random_states(arm, 10):
        limp = LimpArm(arm, q.tolist())
        limp.set_velocities(v)
        expected = limp.oracle.accelerations(q, v, np.zeros(len(q)), limp.armature)
        limp.world.advance_to(STEP_S)
        assert (limp.state()[1] - v) / STEP_S == pytest.approx(expected, rel=1e-5, abs=1e-5)


@pytest.mark.sample(2)
@pytest.mark.parametrize("arm", ARMS)
def test_falling_limp_arm_without_friction_conserves_energy(arm: str) -> None:
    q, v, _ = random_states(arm, 1)[0]
    limp = LimpArm(arm, q.tolist())
    limp.set_velocities(v)
    start_j, errors_j, kinetic_j = limp.energy_j(), list[float](), list[float]()
    for k in range(1, 76):
        limp.world.advance_to(0.02 * k)
        posture, velocities = limp.state()
        resting_j = limp.oracle.energy_j(posture, 0.0 * velocities, limp.armature)
        kinetic_j.append(limp.energy_j() - resting_j)
        errors_j.append(abs(limp.energy_j() - start_j))
    assert max(kinetic_j) > 0.1
    assert max(errors_j) < 0.04 * max(kinetic_j)


def test_two_simulated_servos_on_joint_share_load() -> None:
    limp = LimpArm("vx300s", [0.0, 0.5, 0.3, 0.0, 0.2, 0.0])
    limp.world.advance_to(0.05)
    shoulder = limp.world.joint("shoulder").servos
    assert len({(s.motor.position_rad, s.motor.velocity_rad_s) for s in shoulder}) == 1
    assert shoulder[0].motor.load_inertia_kg_m2 == shoulder[1].motor.load_inertia_kg_m2
