"""How well a posture can move, and the distance to the next singular one."""

import math

import numpy as np
import pytest
from scipy.linalg import null_space

from ikservo.errors import BadValueError, UnknownNameError
from ikservo.kinematics import (
    Chain,
    Joint,
    JointType,
    conditioning,
    manipulability,
    nearest_singularity,
)
from ikservo.kinematics.conditioning import ordinary_postures
from ikservo.kinematics.se3 import make_pose, rotation_rpy
from ikservo.model import load_model
from tests.kinematics.chains import Z, crane, joint, planar

Y = np.array([0.0, 1.0, 0.0])
UPPER_M, FORE_M = 0.3, 0.2


def shoulder(upper_m=UPPER_M, fore_m=FORE_M):
    """Return a turning column and two links in its vertical plane: yaw, lift, bend, then the tip.

    The tip is at ``r = upper cos(lift) + fore cos(lift + bend)`` from the column. Yaw moves it by r
    across the plane, lift and bend in the plane, so ``r`` is a singular value and
    ``r upper fore |sin(bend)|`` the product of all three.
    """
    joints = [
        joint("yaw", JointType.REVOLUTE, "base", "column", axis=Z, lower=-3.0, upper=3.0),
        joint("lift", JointType.REVOLUTE, "column", "upper", axis=-Y, lower=-3.0, upper=3.0),
        joint(
            "bend", JointType.REVOLUTE, "upper", "fore", (upper_m, 0, 0), -Y, lower=-3.0, upper=3.0
        ),
        joint("end", JointType.FIXED, "fore", "tip", (fore_m, 0, 0)),
    ]
    return Chain.from_joints(joints, "base", "tip")


def test_planar_arm_has_two_translations_and_one_rotation():
    found = conditioning(planar(0.3, 0.2, 0.1), [0.3, 0.8, -0.5])
    assert (len(found.moves_m_rad), len(found.turns_rad_rad)) == (2, 1)


def test_manipulability_uses_only_linear_jacobian_rows():
    chain = load_model("wx250s").chain
    q = load_model("wx250s").chain_pose("home") + 0.3
    J = chain.jacobian(q)
    assert conditioning(chain, q).manipulability == pytest.approx(float(manipulability(J[:3])))


def test_slowest_direction_with_right_angle_elbow_is_exact():
    # J = [[-b, -b], [a, 0]] for lengths a and b with the elbow at 90°
    a, b = 0.3, 0.2
    found = conditioning(planar(a, b), [0.0, math.pi / 2])
    trace, det = a * a + 2 * b * b, (a * b) ** 2
    slowest = math.sqrt(0.5 * (trace - math.sqrt(trace * trace - 4 * det)))
    assert found.slowest_m_rad == pytest.approx(slowest)


def test_stretched_arm_cannot_move_outwards():
    assert conditioning(planar(0.3, 0.2), [0.4, 0.0]).slowest_m_rad < 1e-12


def test_arm_without_redundancy_cannot_turn_about_its_tip():
    found = conditioning(planar(0.3, 0.2), [0.4, 0.6])
    assert not found.turns_rad_rad.size


def test_conditioning_scales_translations_but_not_rotations():
    q = [0.3, 0.8, -0.5]
    small, large = conditioning(planar(0.3, 0.2, 0.1), q), conditioning(planar(0.6, 0.4, 0.2), q)
    np.testing.assert_allclose(large.moves_m_rad, 2.0 * small.moves_m_rad)
    np.testing.assert_allclose(large.turns_rad_rad, small.turns_rad_rad)


@pytest.mark.parametrize("elbow_rad", [0.2, 0.9, -0.5])
def test_nearest_singularity_of_two_links_is_straight_elbow(elbow_rad):
    found = nearest_singularity(planar(0.3, 0.2), [0.7, elbow_rad])
    assert found is not None
    assert found.distance_rad == pytest.approx(abs(elbow_rad), abs=1e-3)
    assert found.joint == "j2"


def test_joint_limits_may_exclude_every_singularity():
    chain = planar(0.3, 0.2).with_limits([-1.0, 0.4], [1.0, 2.0])
    assert nearest_singularity(chain, [0.0, 1.0]) is None


@pytest.mark.parametrize("angle_rad", [0.35, -0.6])
def test_wrist_is_singular_where_its_outer_axes_align(angle_rad):
    model = load_model("wx250s")
    q = model.chain_pose("home").copy()
    q[1:3] = 0.3, 0.4  # far from every posture in which the point itself is held up
    q[4] = angle_rad
    found = nearest_singularity(model.chain, q, rotation=True)
    assert found is not None
    assert found.joint == model.chain.names[4]
    assert found.distance_rad == pytest.approx(abs(angle_rad), rel=0.02)


@pytest.mark.parametrize("name", ["px100", "open_manipulator_x", "vx300s"])
@pytest.mark.parametrize("turning", [False, True])
def test_nearest_singularity_is_singular_and_inside_limits(name, turning):
    chain = load_model(name).chain
    rng = np.random.default_rng(3)
    for q in rng.uniform(chain.lower_rad, chain.upper_rad, (3, chain.dof)):
        found = nearest_singularity(chain, q, rotation=turning)
        if found is not None:
            there = conditioning(chain, found.q)
            turns = there.turns_rad_rad if turning else np.array([1.0])
            assert min(there.slowest_m_rad, turns.min(initial=np.inf)) < 1e-5
            assert np.array_equal(found.q, chain.clip(found.q))


def test_fixed_frame_has_no_motion_and_no_singularity():
    chain = planar(0.3, 0.2)
    assert conditioning(chain, [0.1, 0.2], frame="l0").moves_m_rad.size == 0
    assert nearest_singularity(chain, [0.1, 0.2], frame="l0", rotation=True) is None


def test_conditioning_counts_metre_of_prismatic_joint_as_radian():
    found = conditioning(crane(), [0.0, 0.2])
    assert found.moves_m_rad[0] == pytest.approx(math.hypot(1.0, 0.5))


def test_conditioning_refuses_invalid_joints_and_frame():
    chain = planar(0.3, 0.2)
    with pytest.raises(BadValueError):
        conditioning(chain, [0.1])
    with pytest.raises(BadValueError):
        nearest_singularity(chain, [0.1, math.nan])
    with pytest.raises(UnknownNameError):
        conditioning(chain, [0.1, 0.2], frame="hand")


# --- closed forms


@pytest.mark.parametrize("q", [(0.5, 0.4, 0.9), (-2.0, 1.2, -1.7), (1.0, -0.6, 2.2)])
def test_shoulder_elbow_manipulability_equals_closed_form(q):
    _, lift, bend = q
    found = conditioning(shoulder(), q)
    r = abs(UPPER_M * math.cos(lift) + FORE_M * math.cos(lift + bend))
    in_plane = UPPER_M * FORE_M * abs(math.sin(bend))
    assert found.manipulability == pytest.approx(r * in_plane)
    assert found.moves_m_rad == pytest.approx(sorted(found.moves_m_rad, reverse=True))
    assert np.abs(found.moves_m_rad - r).min() < 1e-12


@pytest.mark.parametrize("name", ["so101", "wx250s", "px100"])
def test_conditioning_lists_rotations_with_tip_in_place(name):
    model = load_model(name)
    q = model.chain_pose("home") + 0.2
    J = model.chain.jacobian(q)
    at_rest = null_space(J[:3])
    turns = np.linalg.svd(J[3:] @ at_rest, compute_uv=False)
    found = conditioning(model.chain, q).turns_rad_rad
    assert len(found) == min(3, model.chain.dof - 3)
    np.testing.assert_allclose(found, turns[: len(found)])


def test_point_on_axis_of_only_joint_cannot_move():
    tilted = np.array([1.0, 2.0, 3.0]) / math.sqrt(14.0)
    chain = Chain.from_joints(
        [
            joint("roll", JointType.REVOLUTE, "base", "head", (0.1, 0.2, 0.3), tilted),
            joint("bend", JointType.REVOLUTE, "head", "tip", (0.1, 0.0, 0.0)),
        ],
        "base",
        "tip",
    )
    found = conditioning(chain, [0.7, 0.3], "head", 0.37 * tilted)
    assert found.moves_m_rad.size == 0
    assert found.turns_rad_rad == pytest.approx([1.0])


# --- the nearest singular posture, where it is known


@pytest.mark.parametrize("scale", [0.01, 1.0, 100.0])
@pytest.mark.parametrize("bend_rad", [0.3, -0.3])
def test_shoulder_elbow_is_singular_with_straight_elbow(scale, bend_rad):
    chain = shoulder(scale * UPPER_M, scale * FORE_M)
    found = nearest_singularity(chain, [0.5, 0.4, bend_rad])
    assert found.joint == "bend"
    assert found.distance_rad == pytest.approx(abs(bend_rad), abs=0.01)


@pytest.mark.parametrize("short_rad", [0.2, -0.2])
def test_shoulder_elbow_is_singular_with_tip_above_column(short_rad):
    # For links of one length r is 2 a cos(lift + bend / 2) cos(bend / 2): zero on a plane.
    lift = math.pi / 2 - 0.5 - short_rad
    found = nearest_singularity(shoulder(0.2, 0.2), [0.5, lift, 1.0])
    assert found.joint == "lift"
    nearest_rad = 0.2 / math.hypot(1.0, 0.5)
    assert nearest_rad - 1e-4 <= found.distance_rad <= 1.02 * nearest_rad


@pytest.mark.parametrize("q", [(0.4, 0.0), (0.4, 1e-9)])
def test_nearest_singularity_from_singular_posture_is_zero(q):
    assert nearest_singularity(planar(0.3, 0.2), q).distance_rad < 1e-8


def test_wrist_singularity_counts_only_for_orientation_targets():
    model = load_model("wx250s")
    q = model.chain_pose("home").copy()
    q[1:3], q[4] = (0.3, 0.4), 0.1
    nearest = nearest_singularity(model.chain, q)
    assert nearest is None or nearest.distance_rad > 0.5
    assert nearest_singularity(model.chain, q, rotation=True).distance_rad < 0.11


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_joint_limit_does_not_hide_singularity_on_other_side(side):
    # From here the elbow is downhill when it bends further, to a limit before the folded posture.
    chain = planar(0.3, 0.2).with_limits([-3.0, -2.8], [3.0, 2.8])
    here, further = (conditioning(chain, [0.0, side * bend]).slowest_m_rad for bend in (2.5, 2.6))
    assert further < here
    found = nearest_singularity(chain, [0.0, side * 2.5])
    assert found.joint == "j2"
    assert found.distance_rad == pytest.approx(2.5, abs=1e-3)


@pytest.mark.parametrize("mirrored", [False, True])
def test_singularity_is_found_although_joint_is_at_limit(mirrored):
    """The lift is at its limit, and would bring the tip above the column nine times as fast."""
    upper_m, fore_m, lift, bend = 0.3, 0.05, 1.437, 0.8
    straight_up = math.acos(-upper_m * math.cos(lift) / fore_m) - lift  # r = 0 at this bend
    lower, upper = np.array([-3.0, 0.9, 0.5]), np.array([3.0, lift, 1.3])
    q = np.array([0.2, lift, bend])
    if mirrored:  # to the other side of the column
        q, lower, upper = (
            np.array([0.2, math.pi, 0.0]) - each * [0, 1, 1] for each in (q, upper, lower)
        )
        lower[0], upper[0] = -3.0, 3.0
    chain = shoulder(upper_m, fore_m).with_limits(lower, upper)
    found = nearest_singularity(chain, q)
    assert found.joint == "bend"
    assert found.distance_rad == pytest.approx(straight_up - bend, abs=1e-3)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_nearest_singularity_search_does_not_overshoot(side):
    lift, bend = side * 2.0, side * 1.8
    found = nearest_singularity(shoulder(0.2, 0.2), [0.5, lift, bend])
    above_the_column_rad = (abs(lift + bend / 2) - math.pi / 2) / math.hypot(1.0, 0.5)
    assert found.distance_rad <= 1.1 * above_the_column_rad  # the straight elbow is at 1.5 of it


def test_batch_manipulability_has_one_value_per_jacobian():
    chain, postures = shoulder(), np.array([[0.5, 0.4, 0.9], [0.1, 0.2, 0.3]])
    found = manipulability(chain.jacobian(postures)[:, :3])
    assert found == pytest.approx([conditioning(chain, q).manipulability for q in postures])


@pytest.mark.parametrize("sample", range(len(ordinary_postures(2))))
def test_arm_straight_at_nonzero_angle_lists_two_directions(
    sample,
):
    bend = ordinary_postures(2)[sample, 1]
    bent_back = make_pose((0.3, 0.0, 0.0), rotation_rpy(0.0, 0.0, -bend))
    chain = Chain.from_joints(
        [
            joint("turn", JointType.REVOLUTE, "base", "upper"),
            Joint("bend", JointType.REVOLUTE, "upper", "fore", bent_back, Z),
            joint("end", JointType.FIXED, "fore", "tip", (0.2, 0, 0)),
        ],
        "base",
        "tip",
    )
    assert len(conditioning(chain, [0.3, bend]).moves_m_rad) == 2
