"""Gravity, inverse dynamics, inertia and regressor equal Pinocchio's, and so does its rank."""

import math
from dataclasses import replace

import numpy as np
import pinocchio
import pytest

import ikservo
from ikservo.errors import BadValueError, UnknownNameError
from ikservo.kinematics.collision_body import CollisionBody
from ikservo.kinematics.dynamics import Dynamics
from ikservo.kinematics.inertia import PARAMETERS, LinkMass
from ikservo.model.arm_model import link_masses
from ikservo.model.collision_capsules import collision_body_with_gripper
from tests.kinematics.base_parameters import base_parameters, independent_columns
from tests.kinematics.chains import crane, planar
from tests.kinematics.dynamics_oracle import NAMES, WALL_M_S2, oracle_of
from tests.kinematics.test_gravity import torques as guard_torques
from tests.oracle import ARMS

TENSOR = np.array([[3.0, 0.2, -0.4], [0.2, 4.0, 0.1], [-0.4, 0.1, 5.0]]) * 1e-3
PAYLOAD = (0.4, (0.02, -0.03, 0.05), TENSOR)
EXACT = {"atol": 1e-10, "rtol": 1e-10}


def dynamics_of(name):
    oracle = oracle_of(name)
    return Dynamics.from_masses(oracle.chain, oracle.masses)


@pytest.fixture(params=NAMES)
def name(request):
    return request.param


@pytest.fixture(params=["bare", "payload", "wall"])
def pair(request, name):
    """Return the dynamics of an arm, and Pinocchio's: bare, with a payload, and on a wall."""
    ours, oracle = dynamics_of(name), oracle_of(name)
    if request.param != "bare":
        ours, oracle = ours.with_payload(*PAYLOAD), oracle.with_payload(*PAYLOAD)
    if request.param == "wall":
        ours = replace(ours, gravity_m_s2=np.array(WALL_M_S2))
        oracle = oracle.with_gravity(WALL_M_S2)
    return ours, oracle


def samples(oracle, count=10):
    random = np.random.default_rng(5)
    return [oracle.sample(random) for _ in range(count)]


def stacked(oracle, count=40):
    """Return q, qd, qdd as (count, dof) each."""
    return (np.array(each) for each in zip(*samples(oracle, count), strict=True))


def test_inverse_dynamics_equal_pinocchio(pair):
    ours, oracle = pair
    for motion in samples(oracle):
        found = ours.inverse_dynamics(*motion)
        np.testing.assert_allclose(found, oracle.torques(*motion), **EXACT)


def test_gravity_torques_equal_pinocchio(pair):
    ours, oracle = pair
    for q, _, _ in samples(oracle):
        np.testing.assert_allclose(ours.gravity_torques(q), oracle.gravity(q), **EXACT)


def test_inertia_matrix_equals_pinocchio(pair):
    ours, oracle = pair
    for q, _, _ in samples(oracle):
        np.testing.assert_allclose(ours.inertia_matrix(q), oracle.inertia_matrix(q), **EXACT)


def test_regressor_equals_pinocchio(pair):
    ours, oracle = pair
    for motion in samples(oracle):
        expected = oracle.regressor(*motion, ours.bodies)
        np.testing.assert_allclose(ours.regressor(*motion), expected, **EXACT)


def test_regressor_times_parameters_equals_torques(pair):
    ours, oracle = pair
    for motion in samples(oracle):
        found = ours.regressor(*motion) @ ours.parameters
        np.testing.assert_allclose(found, oracle.torques(*motion), **EXACT)


def test_batch_dynamics_equal_dynamics_of_each_sample(name):
    ours, motion = dynamics_of(name), list(stacked(oracle_of(name), 7))
    for compute, given in [
        (ours.inverse_dynamics, motion),
        (ours.regressor, motion),
        (ours.gravity_torques, motion[:1]),
        (ours.inertia_matrix, motion[:1]),
    ]:
        each = [compute(*sample) for sample in zip(*given, strict=True)]
        np.testing.assert_allclose(compute(*given), each, **EXACT)


def test_dynamics_of_no_samples_are_empty():
    ours, none = dynamics_of("so101"), np.empty((0, 5))
    assert ours.inverse_dynamics(none, none, none).shape == (0, 5)
    assert ours.gravity_torques(none).shape == (0, 5)
    assert ours.inertia_matrix(none).shape == (0, 5, 5)
    assert ours.regressor(none, none, none).shape == (0, 5, 50)


def test_pendulum_torque_is_gravity_plus_inertia():
    # gravity along -y: the link stands out horizontally at q = 0, and larger q lifts it
    pendulum = Dynamics.from_masses(
        planar(0.5), [LinkMass("tip", 2.0, np.zeros(3))], (0.0, -10.0, 0.0)
    )
    np.testing.assert_allclose(pendulum.gravity_torques([0.0]), [10.0])
    np.testing.assert_allclose(pendulum.gravity_torques([math.pi / 3]), [5.0])
    np.testing.assert_allclose(pendulum.inverse_dynamics([0.0], [7.0], [3.0]), [10.0 + 1.5])
    np.testing.assert_allclose(pendulum.inertia_matrix([1.0]), [[0.5]])


def test_mimic_joint_loads_its_leader_by_its_ratio():
    # the hook sinks by half a metre for each metre of the slide: 2 kg hold back half their weight
    ours = Dynamics.from_masses(crane(), [LinkMass("hook", 2.0, np.array([0.1, 0.2, 0.3]))])
    np.testing.assert_allclose(ours.gravity_torques([0.3, 0.1]), [0.0, -9.81], atol=1e-12)


def test_jaw_mass_is_added_to_gripper_link():
    oracle = oracle_of("so101")
    ours = dynamics_of("so101")
    assert ours.bodies == ("shoulder", "upper_arm", "forearm", "wrist", "gripper")
    weights = {mass.link: mass.mass_kg for mass in oracle.masses}
    mass_kg = ours.parameters[ours.bodies.index("gripper") * len(PARAMETERS)]
    assert weights["jaw"] > 0.0
    assert mass_kg == pytest.approx(weights["gripper"] + weights["jaw"])


def test_base_mass_does_not_load_joints():
    base = LinkMass("base", 5.0, np.array([0.1, 0.2, 0.3]), TENSOR)
    assert not Dynamics.from_masses(crane(), [base]).parameters.any()


def test_second_payload_is_added_to_first():
    twice = dynamics_of("koch").with_payload(*PAYLOAD).with_payload(*PAYLOAD)
    double = dynamics_of("koch").with_payload(2 * PAYLOAD[0], PAYLOAD[1], 2 * TENSOR)
    np.testing.assert_allclose(twice.parameters, double.parameters)


def test_payload_without_tensor_is_point_mass():
    q = oracle_of("koch").chain.mid_range()
    bare, point = dynamics_of("koch"), dynamics_of("koch").with_payload(0.3)
    J = oracle_of("koch").chain.jacobian(q)[:3]
    added = point.inertia_matrix(q) - bare.inertia_matrix(q)
    np.testing.assert_allclose(added, 0.3 * J.T @ J, atol=1e-12)


def test_rotated_inertia_tensor_in_urdf_equals_pinocchio(tmp_path):
    path = tmp_path / "arm.urdf"
    path.write_text("""<robot name="one"><link name="base"/><link name="bar"><inertial>
        <origin xyz="0.1 0.2 -0.3" rpy="0.4 -0.5 0.6"/><mass value="1.5"/>
        <inertia ixx="0.02" ixy="0.001" ixz="-0.002" iyy="0.03" iyz="0.003" izz="0.04"/>
        </inertial></link><joint name="hinge" type="continuous"><parent link="base"/>
        <child link="bar"/><axis xyz="1 2 2"/></joint></robot>""")
    model, oracle = ikservo.load_model(path, tip="bar"), pinocchio.buildModelFromUrdf(str(path))
    ours = Dynamics.from_masses(model.chain, link_masses(model, model.chain))
    inertia = oracle.inertias[1].toDynamicParameters()[[0, 1, 2, 3, 4, 5, 7, 6, 8, 9]]
    np.testing.assert_allclose(ours.parameters, inertia, atol=1e-15)


@pytest.mark.parametrize("name", ARMS)
def test_guard_gravity_torques_equal_those_of_dynamics(name):
    model = ikservo.load_model(name)
    chain = collision_body_with_gripper(model).chain
    masses = link_masses(model, chain)
    q = np.random.default_rng(3).uniform(chain.lower_rad, chain.upper_rad, (20, chain.dof))
    pulled = guard_torques(CollisionBody(chain, []), masses, q)
    held = Dynamics.from_masses(chain, masses).gravity_torques(q)
    np.testing.assert_allclose(pulled, -held, **EXACT)


# Gautier and Khalil 1990: the first joint, along gravity, has one base parameter, each further
# revolute one that is no translation of it seven; a plane's joints have one and three more each.
COUNTS = {
    "koch": 29, "omx_f": 29, "omx_l": 29, "open_manipulator_x": 22, "planar2": 4, "planar3": 7,
    "px100": 22, "px150": 29, "rx150": 29, "rx200": 29, "so100": 29, "so101": 29, "vx250": 29,
    "vx300s": 36, "wx200": 29, "wx250s": 36,
}  # fmt: skip
COUNTS_AT_REST = {name: 2 * (round((count - 1) / 7)) for name, count in COUNTS.items()} | {
    "planar2": 0,
    "planar3": 0,
}


@pytest.mark.parametrize("name", ARMS)
def test_base_parameter_count_equals_theory(name):
    assert len(base_parameters(dynamics_of(name)).columns) == COUNTS[name]


@pytest.mark.parametrize("name", ARMS)
def test_base_parameter_count_at_rest_equals_theory(name):
    at_rest = base_parameters(dynamics_of(name), speed_rad_s=0.0, acceleration_rad_s2=0.0)
    assert len(at_rest.columns) == COUNTS_AT_REST[name]


def test_base_parameter_count_equals_pinocchio_rank(name):
    ours, oracle = dynamics_of(name), oracle_of(name)
    Y = np.vstack([oracle.regressor(*motion, ours.bodies) for motion in samples(oracle, 100)])
    found = base_parameters(ours, tolerance=1e-9)
    assert len(found.columns) == np.linalg.matrix_rank(Y, 1e-9 * np.linalg.norm(Y, 2))
    assert np.linalg.matrix_rank(found.reduce(Y), 1e-9 * np.linalg.norm(Y, 2)) == len(found.columns)


def test_base_parameters_do_not_depend_on_random_seed(name):
    first, second = (base_parameters(dynamics_of(name), seed=seed) for seed in (1, 2))
    np.testing.assert_array_equal(first.columns, second.columns)


def test_base_parameters_give_same_torques_as_all(pair):
    ours, oracle = pair
    q, qd, qdd = stacked(oracle)
    base, Y = base_parameters(ours, tolerance=1e-9), ours.regressor(q, qd, qdd)
    expected = [oracle.torques(*motion) for motion in zip(q, qd, qdd, strict=True)]
    values = base.combination @ ours.parameters
    np.testing.assert_allclose(base.reduce(Y) @ values, expected, atol=1e-8, rtol=1e-8)
    expanded = ours.with_parameters(base.expand(values))
    found = expanded.inverse_dynamics(q, qd, qdd)
    np.testing.assert_allclose(found, expected, atol=1e-8, rtol=1e-8)


def test_dropped_dynamic_parameters_hardly_change_torques(pair):
    ours, oracle = pair
    q, qd, qdd = stacked(oracle)
    base, expected = base_parameters(ours), ours.inverse_dynamics(q, qd, qdd)
    found = base.reduce(ours.regressor(q, qd, qdd)) @ base.combination @ ours.parameters
    np.testing.assert_allclose(found, expected, atol=3e-5 * np.abs(expected).max())


def test_least_squares_recovers_base_parameters(pair):
    ours, oracle = pair
    q, qd, qdd = stacked(oracle, 100)
    base = base_parameters(ours)
    Y = base.reduce(ours.regressor(q, qd, qdd)).reshape(-1, len(base.columns))
    measured = [oracle.torques(*motion) for motion in zip(q, qd, qdd, strict=True)]
    found = np.linalg.lstsq(Y, np.ravel(measured), rcond=None)[0]
    expected = base.combination @ ours.parameters
    np.testing.assert_allclose(found, expected, rtol=1e-3, atol=1e-4 * np.abs(expected).max())


def test_friction_columns_are_independent_of_inertia_columns():
    ours, random = dynamics_of("so101"), np.random.default_rng(2)
    q, qd, qdd = random.uniform(-1.0, 1.0, (3, 100, 5))
    friction = np.einsum("ni,ij->nij", qd, np.eye(5))
    Y = np.concatenate([ours.regressor(q, qd, qdd), friction, friction], axis=2).reshape(-1, 60)
    found = independent_columns(Y, np.where(np.arange(60) < 50, 0.05, 0.1))
    assert set(found.columns) & set(range(50, 60)) == set(range(50, 55))
    np.testing.assert_allclose(found.combination[-5:, 55:], np.eye(5), atol=1e-9)


def test_regressor_column_tolerance_is_relative_to_largest():
    # two orthogonal columns, the second a thousandth of the first, in any unit of torque
    for unit in (1.0, 1e-6):
        Y = unit * np.array([[1.0, 1e-3], [1.0, -1e-3]] * 20)
        assert list(independent_columns(Y, [1.0, 1.0], 5e-4).columns) == [0, 1]
        assert list(independent_columns(Y, [1.0, 1.0], 2e-3).columns) == [0]
        assert list(independent_columns(Y, [1.0, 10.0], 2e-3).columns) == [0, 1]
        assert list(independent_columns(Y, [1.0, 0.1], 5e-4).columns) == [0]


def test_regressor_tolerance_ignores_largest_single_sample():
    # the third column has 1.2e-3 of the largest; the first sample is longer than any column
    Y = [[1.0, 1.0, 0.0], [0.0, 0.0, 1.2e-3]]
    assert list(independent_columns(Y, np.ones(3), 1e-3).columns) == [0, 2]
    assert list(independent_columns(Y, np.ones(3), 1.3e-3).columns) == [0]


def test_independent_columns_are_found_from_few_samples():
    assert list(independent_columns([[0.0, 0.0, 2.0]], np.ones(3)).columns) == [2]


def test_zero_regressor_has_no_independent_columns():
    found = independent_columns(np.zeros((4, 3)), np.ones(3))
    assert found.columns.size == 0
    assert found.combination.shape == (0, 3)
    assert found.reduce(np.zeros((2, 4, 3))).shape == (2, 4, 0)
    np.testing.assert_array_equal(found.expand([]), np.zeros(3))


@pytest.mark.parametrize("bad", [[0.0] * 4, [0.0] * 4 + [math.nan], "pose", None, [[[0.0] * 5]]])
def test_dynamics_refuse_invalid_joint_vector(bad):
    ours, good = dynamics_of("so101"), [0.0] * 5
    for call in (
        lambda: ours.gravity_torques(bad),
        lambda: ours.inertia_matrix(bad),
        lambda: ours.inverse_dynamics(bad, good, good),
        lambda: ours.inverse_dynamics(good, bad, good),
        lambda: ours.regressor(good, good, bad),
    ):
        with pytest.raises(BadValueError):
            call()


@pytest.mark.parametrize("column", [1, 2])
def test_dynamics_refuse_velocities_of_wrong_shape(column):
    motion = [np.zeros(5)] * 3
    motion[column] = np.zeros((3, 5))
    what = ("q", "qd", "qdd")[column]
    with pytest.raises(BadValueError) as refusal:
        dynamics_of("so101").inverse_dynamics(*motion)
    assert str(refusal.value) == f"{what} is of shape (3, 5).\nExpected shape (5,), like q."


@pytest.mark.parametrize(
    ("mass", "named"),
    [
        ((-0.1, (0, 0, 0)), "mass"),
        ((math.nan, (0, 0, 0)), "mass"),
        (("heavy", (0, 0, 0)), "mass"),
        ((0.1, (0, 0)), "centre of mass"),
        ((0.1, (0, 0, math.inf)), "centre of mass"),
        ((0.1, (0, 0, 0), np.zeros(3)), "tensor"),
        ((0.1, (0, 0, 0), [[0, 1, 0], [0, 0, 0], [0, 0, 0]]), "symmetric"),
    ],
)
def test_dynamics_refuse_invalid_mass_or_centre(mass, named):
    with pytest.raises(BadValueError, match=named):
        LinkMass("hook", *mass)
    with pytest.raises(BadValueError, match=named):
        Dynamics.from_masses(crane(), []).with_payload(*mass)


def test_dynamics_refuse_mass_of_unknown_link():
    with pytest.raises(UnknownNameError, match="hok"):
        Dynamics.from_masses(crane(), [LinkMass("hok", 1.0, np.zeros(3))])


@pytest.mark.parametrize("gravity", [(0, 9.81), (0, 0, math.nan), "down"])
def test_dynamics_refuse_invalid_gravity(gravity):
    with pytest.raises(BadValueError, match="gravity"):
        Dynamics.from_masses(crane(), [], gravity)


def test_dynamics_refuse_wrong_number_of_parameters():
    ours = dynamics_of("so101")
    with pytest.raises(BadValueError, match="parameters"):
        ours.with_parameters([1.0, 2.0])
