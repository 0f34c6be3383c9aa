"""Gravity torques agree with Pinocchio's, and sag with the simulated servos' stiffness."""

from dataclasses import replace

import numpy as np
import pinocchio
import pytest

import ikservo
from ikservo.guard.sag import GravitySag, Weight
from ikservo.kinematics.collision_body import CollisionBody
from ikservo.kinematics.inertia import LinkMass
from ikservo.model.arm_model import link_masses
from ikservo.model.joint_drive import joint_compliances
from ikservo.model.servo_torque import SERVO_TORQUES, find_servo_torque
from servosim.parameters import PARAMETERS
from tests.arm.simulated import line_of
from tests.guard.arms import body
from tests.kinematics.chains import crane
from tests.oracle import ARMS, CONFIGS


def torques(shape, masses, q):
    """Return the torques of gravity (n, dof), as the sag of joints that yield 1 rad per N m."""
    free = np.full(shape.chain.dof, np.inf)
    return GravitySag(shape, Weight(masses, np.ones(shape.chain.dof), -free, free))(np.array(q))


def sagging(model):
    shape = body(model.name)
    chain = shape.chain
    weight = Weight(
        link_masses(model, chain), joint_compliances(model, chain), chain.lower_rad, chain.upper_rad
    )
    return GravitySag(shape, weight)


@pytest.mark.parametrize("name", ARMS)
def test_gravity_torques_equal_pinocchio(name):
    model = ikservo.load_model(name)
    oracle = pinocchio.buildModelFromUrdf(str(CONFIGS / name / "arm.urdf"))
    beside = [joint for joint in list(oracle.names)[1:] if joint not in model.chain.names]
    resting = pinocchio.neutral(oracle)
    for joint in beside:
        column = oracle.joints[oracle.getJointId(joint)].idx_q
        low, high = oracle.lowerPositionLimit[column], oracle.upperPositionLimit[column]
        resting[column] = min(max(0.0, low), high)
    random = np.random.default_rng(3)
    for q in random.uniform(-1.0, 1.0, (5, model.chain.dof)):
        posture, columns = resting.copy(), []
        for joint, value in zip(model.chain.names, q, strict=True):
            columns.append(oracle.joints[oracle.getJointId(joint)].idx_q)
            posture[columns[-1]] = value
        held = pinocchio.computeGeneralizedGravity(oracle, oracle.createData(), posture)
        found = torques(body(name), link_masses(model, model.chain), [q])[0]
        np.testing.assert_allclose(found, -held[columns], atol=1e-9)


def test_gravity_of_mimic_joint_loads_leader_by_ratio():
    # the hook sinks by half a metre for each metre of the slide, the cart stays as high
    masses = [LinkMass("hook", 2.0, np.array([0.1, 0.2, 0.3])), LinkMass("cart", 5.0, np.zeros(3))]
    found = torques(CollisionBody(crane(), []), masses, [[0.3, 0.1], [1.0, 0.3]])
    np.testing.assert_allclose(found, [[0.0, 0.5 * 2.0 * 9.81]] * 2, atol=1e-12)


@pytest.mark.parametrize("name", ["so101", "koch", "px100", "vx300s"])
def test_servo_stiffness_equals_that_of_simulator(name):
    with ikservo.open_arm(name, port="sim:?pose=home") as arm:
        arm.enable()
        for joint in arm.model.joints:
            if joint.role == "gripper":
                continue
            servo = line_of(arm).servos[joint.servo.id]
            duty_nm = PARAMETERS[joint.servo.model].duty_torque_nm
            stiffness = SERVO_TORQUES[joint.servo.model, None].stiffness_nm_rad
            assert stiffness == pytest.approx(servo.drive.kp * duty_nm, rel=0.02), joint.name


VARIANTS = [
    (model, supply_v, "STS3215-C018" if supply_v else model) for model, supply_v in SERVO_TORQUES
]


@pytest.mark.parametrize(("model", "supply_v", "simulated"), VARIANTS)
def test_servo_torque_and_friction_equal_simulator(model, supply_v, simulated):
    known, motor = find_servo_torque(model, supply_v), PARAMETERS[simulated]
    assert known.full_duty_nm == pytest.approx(motor.duty_torque_nm, rel=0.02)
    assert known.static_friction_nm == pytest.approx(motor.static_friction_nm, rel=0.03)


@pytest.mark.parametrize(("model", "supply_v", "simulated"), VARIANTS)
def test_servo_damping_and_gear_friction_equal_simulator(model, supply_v, simulated):
    known, motor = find_servo_torque(model, supply_v), PARAMETERS[simulated]
    back_emf_nm_s = motor.torque_constant_nm_a**2 / motor.resistance_ohm
    assert known.damping_nm_s == pytest.approx(back_emf_nm_s + motor.viscous_nm_s, rel=0.02)
    assert known.armature_kg_m2 == pytest.approx(motor.armature_kg_m2, rel=0.02)
    gears = known.friction
    assert (gears.load, gears.slow_load) == (motor.load_friction, motor.load_stribeck)
    assert gears.coulomb_nm == pytest.approx(motor.friction_nm, rel=0.02)
    assert gears.slow_nm == pytest.approx(motor.stribeck_nm, rel=0.02)
    assert gears.slow_rad_s == pytest.approx(motor.stribeck_rad_s, rel=0.02)
    assert gears.square_per_nm == pytest.approx(motor.load_square_per_nm, rel=0.02)


def test_higher_supply_voltage_reduces_sag():
    model = ikservo.load_model("so101")
    at_12_v = replace(model, supply_v=12.0)
    usual, strong = (joint_compliances(m, m.chain) for m in (model, at_12_v))
    duty_nm = [PARAMETERS[name].duty_torque_nm for name in ("STS3215", "STS3215-C018")]
    np.testing.assert_allclose(usual / strong, duty_nm[1] / duty_nm[0], rtol=0.01)


def test_sag_of_joint_near_its_limit_ends_at_limit():
    model = ikservo.load_model("so101")
    sag = sagging(model)
    lift = model.chain.names.index("shoulder_lift")
    q = model.chain_pose("zero")
    q[lift] = model.chain.upper_rad[lift] - 1e-4
    assert 0.0 < sag(q[None])[0, lift] <= 1e-4 + 1e-12


def test_sag_of_stretched_arm_is_1_to_3_degrees():
    model = ikservo.load_model("so101")
    sag = np.rad2deg(sagging(model)(model.chain_pose("zero")[None])[0])
    assert 1.0 < sag[model.chain.names.index("shoulder_lift")] < 3.0


@pytest.mark.parametrize("name", ARMS)
def test_compiled_sag_is_torque_times_compliance(name):
    model = ikservo.load_model(name)
    middle = model.chain.mid_range()[None]
    masses, yields = link_masses(model, model.chain), joint_compliances(model, model.chain)
    assert (yields > 0).all()
    expected = torques(body(name), masses, middle) * yields
    np.testing.assert_allclose(sagging(model)(middle), expected, atol=1e-12)
