"""LeRobot's kinematics by ikservo's solver."""

import numpy as np
import pytest

import ikservo
from ikservo.kinematics.se3 import exp_so3


@pytest.fixture
def kinematics():
    from lerobot_robot_ikservo import IkservoKinematics

    return IkservoKinematics("so101")


def home(kinematics):
    return np.degrees(ikservo.load_model("so101").chain_pose("home"))


def test_lerobot_forward_kinematics_takes_degrees(kinematics):
    chain = ikservo.load_model("so101").chain
    q = home(kinematics)
    np.testing.assert_allclose(
        kinematics.forward_kinematics(q), chain.forward(np.radians(q)), atol=1e-12
    )
    assert kinematics.joint_names == list(chain.names)


def test_lerobot_inverse_kinematics_converges_in_one_call(kinematics):
    chain = ikservo.load_model("so101").chain
    rng = np.random.default_rng(3)
    for _ in range(50):
        wanted = chain.forward(rng.uniform(chain.lower_rad, chain.upper_rad))
        q = kinematics.inverse_kinematics(home(kinematics), wanted)
        assert np.linalg.norm(kinematics.forward_kinematics(q)[:3, 3] - wanted[:3, 3]) < 1e-3
        assert np.all(np.radians(q) >= chain.lower_rad - 1e-9)
        assert np.all(np.radians(q) <= chain.upper_rad + 1e-9)


def test_lerobot_inverse_kinematics_is_smooth_beyond_reach(kinematics):
    q = home(kinematics)
    T = kinematics.forward_kinematics(q)
    largest = 0.0
    for _ in range(200):
        T[0, 3] += 0.002
        following = kinematics.inverse_kinematics(q, T)
        largest, q = max(largest, np.abs(following - q).max()), following
    assert largest < 12.0  # where the arm is stretched, 2 mm turn the elbow far
    assert np.linalg.norm(T[:3, 3] - kinematics.forward_kinematics(q)[:3, 3]) > 0.05


def test_lerobot_inverse_kinematics_keeps_gripper_value():
    from lerobot_robot_ikservo import IkservoKinematics

    names = [joint.name for joint in ikservo.load_model("so101").joints]
    with_gripper = IkservoKinematics("so101", joint_names=names)
    q = np.append(home(with_gripper), 37.0)
    T = with_gripper.forward_kinematics(q)
    T[2, 3] += 0.01
    found = with_gripper.inverse_kinematics(q, T)
    assert with_gripper.joint_names[-1] == "gripper"
    assert found.shape == (6,)
    assert found[-1] == 37.0
    assert not np.allclose(found[:-1], q[:-1])


def test_zero_orientation_weight_ignores_orientation(kinematics):
    q = home(kinematics)
    T = kinematics.forward_kinematics(q)
    T[:3, :3] = T[:3, :3] @ exp_so3([0.0, 0.0, 0.8])
    kept = kinematics.inverse_kinematics(q, T, orientation_weight=0.0)
    np.testing.assert_allclose(kept, q, atol=1e-3)
    turned = kinematics.inverse_kinematics(q, T)
    assert np.abs(turned - q).max() > 5.0


def test_lerobot_kinematics_of_open_arm_uses_its_limits():
    from lerobot_robot_ikservo import IkservoKinematics

    with ikservo.open_arm("so101", port="sim") as arm:
        kinematics = IkservoKinematics(arm)
        T = kinematics.forward_kinematics(np.zeros(5))
        T[0, 3] += 1.0
        q = kinematics.inverse_kinematics(np.zeros(5), T)
        assert np.all(np.radians(q) <= arm.chain.upper_rad + 1e-9)


def test_lerobot_joint_names_must_include_every_arm_joint():
    from lerobot_robot_ikservo import IkservoKinematics

    with pytest.raises(ValueError, match="wrist_roll"):
        IkservoKinematics("so101", joint_names=["shoulder_pan", "shoulder_lift", "elbow_flex",
                                                "wrist_flex"])  # fmt: skip


@pytest.mark.sample(1)
@pytest.mark.parametrize("arm", ["so101", "koch", "px100", "wx250s"])
def test_lerobot_solver_needs_under_6000_iterations_out_of_reach(arm):
    from lerobot_robot_ikservo.kinematics import TipSolver

    chain = ikservo.load_model(arm).chain
    solver, q = TipSolver(chain), ikservo.load_model(arm).chain_pose("home")
    T = chain.forward(q).copy()
    T[:3, 3] *= 4.0
    solver.solve(T, q)
    assert solver._pose.result.iterations < 6_000  # at about 1.3 µs; a frame has 33 ms


def test_lerobot_tip_solver_reaches_target_from_any_start():
    from lerobot_robot_ikservo.kinematics import TipSolver

    chain = ikservo.load_model("so101").chain
    solver, rng = TipSolver(chain), np.random.default_rng(5)
    joints = rng.uniform(chain.lower_rad, chain.upper_rad, (200, 2, chain.dof))
    assert max(solver.solve(chain.forward(there), here)[1] for here, there in joints) < 1e-3
