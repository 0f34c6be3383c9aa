"""Lines near a limit: the goal of a loaded joint leads it but must not pass the limit."""

import numpy as np
import pytest

import ikservo
from ikservo.arm import ToolOrientation
from ikservo.errors import CartesianPathError
from ikservo.kinematics import JointIndex
from ikservo.model.joint_drive import nominal_parameters
from ikservo.planning.loaded_limits import goal_leads, limits_under_load
from ikservo.planning.planner import Planner

WEIGHT = "a joint that holds the arm's weight cannot go right up to its limit"


@pytest.fixture(scope="module")
def wx250s():
    with ikservo.open_arm("wx250s", port="sim", collisions=False) as arm:
        yield arm


def leaning(arm, elbow_from_limit):
    """Return joints (dof,) whose elbow is held up against the arm's weight at its lower limit."""
    q = dict.fromkeys(arm.chain.names, 0.0) | {"shoulder": 1.2}
    column = arm.chain.names.index("elbow")
    q["elbow"] = arm.chain.lower_rad[column] + elbow_from_limit
    return np.array([q[name] for name in arm.chain.names])


def lead_of_elbow(arm, q):
    """Return the lead of the resting elbow's goal at joints (dof,), rad."""
    parameters = nominal_parameters(arm.model, arm.chain)
    return goal_leads(parameters, q[None], np.zeros((1, q.size)))[0, arm.chain.names.index("elbow")]


def elbow_limit(arm, *q):
    """Return the lower limit of the elbow along joints (dof,); None if it is the usual one."""
    parameters = nominal_parameters(arm.model, arm.chain)
    chain = limits_under_load(arm.chain, parameters, np.array(q))
    return None if chain is None else chain.lower_rad[arm.chain.names.index("elbow")]


@pytest.mark.full
def test_line_posture_is_chosen_so_that_goals_respect_limits(wx250s):
    start, names = leaning(wx250s, 0.4), wx250s.chain.names
    wx250s.move_joints(dict(zip(names, start, strict=True)), speed="fast")
    end_m = wx250s.chain.forward(leaning(wx250s, 0.005))[:3, 3]
    plan = wx250s.plan_line(end_m)
    q = plan.goal[[plan.names.index(name) for name in names]]
    lowest = wx250s.chain.lower_rad[names.index("elbow")]
    assert q[names.index("elbow")] + lead_of_elbow(wx250s, q) >= lowest - 0.0031
    np.testing.assert_allclose(plan.tip_m, end_m, atol=1e-4)


@pytest.fixture
def px100():
    """Return a planner, and a posture near the elbow's limit whose tool must keep its pitch."""
    model = ikservo.load_model("px100")
    names = [joint.name for joint in model.joints]
    planner = Planner(model, model.chain, JointIndex.from_names(names, model.chain.names, None))

    def plan(elbow, wrist):
        end_m = planner.tip(np.array([0.0, 1.249, elbow, wrist, 0.0]))
        start = np.array([0.0, 1.25, -2.06, 1.05, 0.0])
        return planner.plan_linear(start, [end_m], "slow", 0.01, ToolOrientation(keep=True))

    return plan


def test_line_is_refused_if_sag_needs_goals_beyond_limits(px100):
    with pytest.raises(CartesianPathError, match=WEIGHT):
        px100(-2.109, 1.101)


def test_line_is_accepted_if_only_friction_needs_more_lead(px100):
    plan, model = px100(-2.0943, 1.086), ikservo.load_model("px100")
    parameters = nominal_parameters(model, model.chain)
    joints = np.linspace(plan.start, plan.goal, 20)[:, :4]
    assert limits_under_load(model.chain, parameters, joints, friction=False) is None
    assert limits_under_load(model.chain, parameters, joints) is not None


def test_limit_under_load_is_unchanged_if_goals_stay_inside(wx250s):
    assert elbow_limit(wx250s, leaning(wx250s, 0.1)) is None


def test_limit_under_load_moves_inwards_by_needed_lead(wx250s):
    at_limit = leaning(wx250s, 0.0)
    moved = elbow_limit(wx250s, at_limit) - at_limit[wx250s.chain.names.index("elbow")]
    assert moved == pytest.approx(-lead_of_elbow(wx250s, at_limit))
    assert moved > 0.01


def test_limit_under_load_leaves_room_for_friction_in_motion(wx250s):
    drive = nominal_parameters(wx250s.model, wx250s.chain).drives[2]
    least_rad = drive.friction_torque(0.0, 0.0) / drive.stiffness_nm_rad
    near, at_limit = leaning(wx250s, 0.02), leaning(wx250s, 0.0)
    resting = elbow_limit(wx250s, at_limit)
    assert elbow_limit(wx250s, near, at_limit) > resting + least_rad
    assert elbow_limit(wx250s, at_limit, near) < resting - least_rad


def test_limit_under_load_ignores_solver_rounding(wx250s):
    beside, at_limit = leaning(wx250s, 1e-9), leaning(wx250s, 0.0)
    resting = elbow_limit(wx250s, at_limit)
    assert elbow_limit(wx250s, beside, at_limit) == pytest.approx(resting, abs=1e-6)
    assert elbow_limit(wx250s, at_limit, beside) == pytest.approx(resting, abs=1e-6)
