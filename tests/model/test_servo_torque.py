"""Motor parameters used for plans equal those of the simulated motors."""

from __future__ import annotations

import pytest

from ikservo.control.servo_gains import raise_gains
from ikservo.model.servo_torque import SERVO_TORQUES, nominal_supply_v
from servosim.parameters import PARAMETERS
from tests.hardware.factories import make_bus, simulated_servos


def simulated_motor(model, supply_v):
    """Return the parameters of the simulated motor for a supply voltage."""
    wanted_v = nominal_supply_v(model, supply_v)
    names = [name for name in PARAMETERS if name == model or name.startswith(f"{model}-C")]
    return next(PARAMETERS[name] for name in names if PARAMETERS[name].nominal_v == wanted_v)


@pytest.mark.parametrize(("model", "supply_v"), SERVO_TORQUES)
def test_servo_torque_constants_equal_simulator(model, supply_v):
    ours, theirs = SERVO_TORQUES[model, supply_v], simulated_motor(model, supply_v)
    kt, ohm = theirs.torque_constant_nm_a, theirs.resistance_ohm
    assert (
        ours.full_duty_nm,
        ours.damping_nm_s,
        ours.armature_kg_m2,
        ours.static_friction_nm,
        ours.friction.load,
        ours.friction.slow_rad_s,
    ) == pytest.approx(
        (
            theirs.duty_torque_nm,
            kt * kt / ohm + theirs.viscous_nm_s,
            theirs.armature_kg_m2,
            theirs.static_friction_nm,
            theirs.load_friction,
            theirs.stribeck_rad_s,
        ),
        rel=0.01,
    )


@pytest.mark.parametrize("model", sorted({model for model, _ in SERVO_TORQUES}))
def test_servo_stiffness_equals_gain_of_simulated_servo(model):
    bus = make_bus({1: model})
    raise_gains(bus, 1, gripper=False)
    ours, servo = SERVO_TORQUES[model, None], simulated_servos(bus)[1]
    held = [
        servo.read(name) for name in ("position_p_gain", "p_gain") if name in servo.table.by_name
    ]
    share = ours.p_gain / held[0] if held else 1.0
    full_nm = servo.motor.parameters.duty_torque_nm
    assert ours.stiffness_nm_rad == pytest.approx(share * servo.drive.kp * full_nm, rel=0.01)
