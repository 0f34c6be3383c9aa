"""The arms of ``examples/arms`` have plausible bodies and reach their targets."""

from __future__ import annotations

import math
from pathlib import Path

import mujoco
import numpy as np
import pinocchio
import pytest

import ikservo
from ikservo.errors import AimError
from ikservo.model.tool import tool_frame
from ikservo.planning.motions import LookAt
from tests.arm.simulated import clock_of

FOLDER = Path(__file__).parents[2] / "examples" / "arms"
POINTS_M = {
    "gantry": [(0.05, 0.1, 0.12), (-0.1, -0.03, 0.08)],
    "scara": [(0.15, 0.1, 0.1), (0.2, -0.1, 0.07)],
    "seven_joints": [(0.25, 0.1, 0.1), (0.2, -0.15, 0.2)],
}
ARMS = [*POINTS_M, "pan_tilt"]


def file_of(name):
    return FOLDER / name / "arm.toml"


@pytest.fixture
def opened(request):
    """Open an example arm in the simulator."""
    with ikservo.open_arm(file_of(request.param), "sim") as arm:
        yield arm


def test_every_example_arm_folder_is_tested():
    assert sorted(ARMS) == sorted(path.name for path in FOLDER.iterdir())


@pytest.mark.parametrize("name", ARMS)
def test_example_arm_forward_kinematics_matches_pinocchio(name):
    chain = ikservo.load_model(file_of(name)).chain
    theirs = pinocchio.buildModelFromUrdf(str(FOLDER / name / "arm.urdf"))
    data = theirs.createData()
    for q in np.random.default_rng(5).uniform(chain.lower_rad, chain.upper_rad, (20, chain.dof)):
        pinocchio.framesForwardKinematics(theirs, data, q)
        frame = data.oMf[theirs.getFrameId(chain.tip)].homogeneous
        assert chain.forward(q) == pytest.approx(frame, abs=1e-12)


@pytest.mark.parametrize("name", ARMS)
def test_example_arm_loads_in_mujoco_with_positive_masses(name, capfd):
    model = mujoco.MjModel.from_xml_path(str(FOLDER / name / "arm.urdf"))
    assert capfd.readouterr() == ("", "")
    assert (model.body_mass[1:] > 0.0).all()


@pytest.mark.parametrize("opened", ARMS, indirect=True, ids=str)
def test_example_arm_stays_in_its_rest_pose_when_limp(opened):
    clock = clock_of(opened)
    clock.sleep_until(clock.now_s() + 3.0)
    rest = opened.model.pose("rest")
    for name, position in opened.where().positions.items():
        assert position == pytest.approx(rest[name], abs=math.radians(5.0)), name


@pytest.mark.sample(2)
@pytest.mark.parametrize(
    ("opened", "point_m"),
    [(name, point_m) for name, points in POINTS_M.items() for point_m in points],
    indirect=["opened"],
    ids=str,
)
def test_example_arm_reaches_several_points(opened, point_m):
    report = opened.move_to(point_m)
    assert report.reached
    assert opened.where().tip_m == pytest.approx(point_m, abs=1e-3)


@pytest.mark.parametrize("opened", ["pan_tilt"], indirect=True)
def test_pan_tilt_arm_looks_at_several_points_in_turn(opened):
    axis = tool_frame(opened.model).approach_axis
    for point_m in [(1.0, 0.5, -0.2), (0.5, -1.0, 0.4), (0.3, 0.0, 0.0)]:
        assert opened.look_at(point_m).reached
        q = [opened.where().positions[name] for name in opened.chain.names]
        T = opened.chain.forward(q)
        towards = np.array(point_m) - T[:3, 3]
        cosine = float(T[:3, :3] @ axis @ towards) / float(np.linalg.norm(towards))
        assert math.acos(min(1.0, cosine)) < math.radians(0.5)


@pytest.mark.parametrize("opened", ["pan_tilt"], indirect=True)
def test_look_at_point_beyond_limits_moves_nothing(opened):
    before = opened.where().positions
    with pytest.raises(AimError, match="cannot point at"):
        opened.execute(LookAt((-1.0, 0.0, 0.0)))
    assert opened.where().positions == before


@pytest.mark.parametrize("opened", ["seven_joints"], indirect=True)
def test_look_at_plan_contains_goal_of_every_joint(opened):
    plan = opened.plan_look((0.4, 0.1, 0.0))
    assert list(plan.requested) == list(opened.chain.names)
    assert plan.requested == pytest.approx(opened.joint_index.by_name(plan.goal))
