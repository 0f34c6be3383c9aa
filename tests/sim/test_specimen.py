"""One specimen of an arm: other masses, a payload, other motors."""

import math
from pathlib import Path

import numpy as np
import pytest

import servosim
from servosim.arm_file import read_arm_file
from servosim.assembly import make_arm_world
from servosim.errors import ArmFileError, SimulatorError
from servosim.server import build_line, parse_options
from servosim.specimen import Specimen, read_specimen

SO101 = Path(__file__).parents[2] / "configs" / "so101" / "arm.toml"
ARM = read_arm_file(SO101)
LIFT, TIP_M = 1, 0.1


def loads(specimen, q):
    return np.array(make_arm_world(ARM, specimen=specimen).body.load_nm(q, [0.0] * len(q)))


def inertias(specimen, q):
    return np.array(make_arm_world(ARM, specimen=specimen).body.mass_matrix(q)).diagonal()


Q = [0.1, -0.6, 0.5, 0.7, 0.2, 0.3]


def test_sim_mass_scale_option_applies_to_all_masses():
    plain = loads(None, Q)
    assert np.abs(plain).max() > 0.1
    assert loads(Specimen(mass_scale=1.3), Q) == pytest.approx(1.3 * plain)
    assert inertias(Specimen(mass_scale=1.3), Q) == pytest.approx(1.3 * inertias(None, Q))


def test_sim_mass_scale_option_also_applies_to_jaws():
    scaled = loads(Specimen(mass_scales={"wrist_flex": 1.4}), Q)
    assert scaled[3] == pytest.approx(1.4 * loads(None, Q)[3])
    assert scaled[5] == pytest.approx(1.4 * loads(None, Q)[5])


def test_sim_payload_torque_equals_virtual_work_at_tip():
    """By the principle of virtual work: m g times the distance that the tip sinks."""
    world, step = make_arm_world(ARM), 1e-5
    added = loads(Specimen(payload_kg=0.2), Q) - loads(None, Q)
    for k in range(5):
        moved = list(Q)
        moved[k] += step
        sinks = (world.tip.position_m(Q) - world.tip.position_m(moved))[2] / step
        assert added[k] == pytest.approx(0.2 * 9.81 * sinks, abs=1e-4)


def test_sim_mass_scale_of_one_arm_does_not_affect_next_arm():
    plain = loads(None, Q)
    loads(Specimen(mass_scale=2.0, payload_kg=1.0), Q)
    assert loads(None, Q) == pytest.approx(plain)


@pytest.mark.parametrize(
    "bad", [{"mass_scale": 0.0}, {"mass_scale": math.nan}, {"payload_kg": -1.0}, {"mass_scale": 99}]
)
def test_invalid_sim_masses_are_refused(bad):
    with pytest.raises(SimulatorError):
        Specimen(**bad)


def test_sim_mass_scale_option_is_refused_with_mujoco():
    with pytest.raises(SimulatorError, match="URDF"):
        make_arm_world(ARM, physics=True, specimen=Specimen(mass_scale=1.1))


FILE = """
written = 2026-11-22 19:39:17+00:00
[[joints]]
name = "shoulder_lift"
mass_scale = 1.25
full_duty_nm = 3.0
back_emf_nm_s = 0.5
coulomb_nm = 0.2
viscous_nm_s = 0.03
slow_nm = 0.04
slow_rad_s = 0.3
load = 0.12
slow_load = 0.05
backlash_rad = 0.01
[[joints]]
name = "elbow_flex"
"""


def test_sim_parameter_file_sets_motors_and_masses_of_arm(tmp_path):
    path = tmp_path / "one.toml"
    path.write_text(FILE)
    world = make_arm_world(ARM, specimen=read_specimen(path))
    motor = world.joint("shoulder_lift").servos[0].motor.parameters
    assert motor.duty_torque_nm == pytest.approx(3.0)
    assert motor.torque_constant_nm_a**2 / motor.resistance_ohm == pytest.approx(0.5)
    friction = motor.friction_nm, motor.load_friction, motor.stribeck_nm, motor.load_stribeck
    assert friction == (0.2, 0.12, 0.04, 0.05)
    assert (motor.viscous_nm_s, motor.stribeck_rad_s, motor.backlash_rad) == (0.03, 0.3, 0.01)
    usual = make_arm_world(ARM).joint("shoulder_lift").servos[0].motor.parameters
    assert motor.stall_torque_nm == pytest.approx(usual.stall_torque_nm)
    assert (
        world.body.load_nm(Q, [0.0] * len(Q))[LIFT]
        != make_arm_world(ARM).body.load_nm(Q, [0.0] * len(Q))[LIFT]
    )
    elbow = world.joint("elbow_flex").servos[0].motor.parameters
    assert elbow == make_arm_world(ARM).joint("elbow_flex").servos[0].motor.parameters


@pytest.mark.parametrize(
    "text",
    [
        "", "joints = 3", "[[joints]]\nload = 0.1", "[[joints]]\nname = 'a'\nload = 0.6",
        "[[joints]]\nname = 'a'\nfull_duty_nm = 0", "[[joints]]\nname = 'a'\ncoulomb_nm = nan",
        "[[joints]]\nname = 'a'\nmass_scale = -1", "[[joints]]\nname = 'a'\nslow_rad_s = 'x'",
    ],
)  # fmt: skip
def test_invalid_sim_parameter_file_is_refused(tmp_path, text):
    path = tmp_path / "one.toml"
    path.write_text(text)
    with pytest.raises((ArmFileError, SimulatorError)):
        read_specimen(path)


def test_sim_mass_options_of_port_and_server_agree(tmp_path):
    path = tmp_path / "one.toml"
    path.write_text(FILE)
    query = f"mass_scale=1.2&payload_g=80&parameters={path}"
    port = servosim.open_port(f"sim:{SO101}?{query}")
    words = [str(SO101), "--mass-scale", "1.2", "--payload-g", "80", "--parameters", str(path)]
    line = build_line(parse_options(words))
    specimen = read_specimen(path).with_load(1.2, 80.0)
    for world in (port.line.world, line.world):
        assert world.body.load_nm(Q, [0.0] * len(Q)) == pytest.approx(loads(specimen, Q))
