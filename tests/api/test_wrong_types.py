"""Arguments of a wrong type are refused by name before anything moves."""

import math

import numpy as np
import pytest

import ikservo
from tests.arm.simulated import registers, true_joints

NEAR = (0.23, 0.02, 0.10)


@pytest.fixture(scope="module")
def limp():
    """Return an arm that no test of this module may move or switch on."""
    with ikservo.open_arm("so101", port="sim:?pose=home") as machine:
        yield machine


@pytest.mark.parametrize(
    "call",
    [
        lambda arm: arm.move_to(NEAR, on_progress=3),
        lambda arm: arm.move_joints({"wrist_roll": 0.1}, on_progress="print"),
        lambda arm: arm.move_line(NEAR, on_progress=3),
        lambda arm: arm.move_through([NEAR], on_progress=3),
        lambda arm: arm.move_through([NEAR], tool_speed_m_s=0.05),
        lambda arm: arm.move_line(NEAR, tool_speed_m_s=0.0),
        lambda arm: arm.move_line(NEAR, tool_speed_m_s=math.nan),
        lambda arm: arm.move_line(NEAR, tool_speed_m_s="fast"),
        lambda arm: arm.draw(None),
        lambda arm: arm.draw([]),
        lambda arm: arm.draw([[]]),
        lambda arm: arm.draw([NEAR, "abc"]),
        lambda arm: arm.draw([[(0.2, 0.0, math.nan)]]),
        lambda arm: arm.draw([[(0.2, 0.0)]]),
        lambda arm: arm.draw([[NEAR]], lift_m=-0.01),
        lambda arm: arm.draw([[NEAR]], lift_m=math.inf),
        lambda arm: arm.move_arc(),
        lambda arm: arm.move_arc(NEAR),
        lambda arm: arm.move_arc(NEAR, (0.2, 0.0, math.nan)),
        lambda arm: arm.move_arc(NEAR, "abc"),
        lambda arm: arm.move_arc(NEAR, NEAR),
        lambda arm: arm.move_arc(NEAR, (0.2, 0.05, 0.1), center_m=NEAR),
        lambda arm: arm.move_arc(center_m=NEAR, full_circle=True),
        lambda arm: arm.move_arc(center_m=NEAR, normal=(0.0, 0.0, 0.0)),
        lambda arm: arm.move_arc(center_m=NEAR, angle_rad=0.0),
        lambda arm: arm.move_arc(center_m=NEAR, angle_rad=math.inf),
        lambda arm: arm.move_arc(center_m=NEAR, angle_rad="all"),
        lambda arm: arm.gripper("open", on_progress=3),
        lambda arm: arm.execute(ikservo.planning.motions.MoveGripper(np.array([1.0, 2.0]))),
        lambda arm: arm.follow([NEAR], on_progress=3),
        lambda arm: arm.execute(arm.plan_to(NEAR), on_progress=3),
        lambda arm: arm.teach("cup", until=3),
        lambda arm: arm.teach(3),
        lambda arm: arm.record(3, duration_s=0.1),
        lambda arm: arm.record("wave.jsonl", until=3),
        lambda arm: arm.replay(3),
        lambda arm: arm.replay("wave.jsonl", on_progress=3),
        lambda arm: arm.execute(None),
        lambda arm: arm.move_through(None),
        lambda arm: arm.move_through("abc"),
        lambda arm: arm.move_through(NEAR),
        lambda arm: arm.jog(["x"], wanted=lambda: True),
        lambda arm: arm.follow_arm(None),
        lambda arm: arm.follow_arm(arm),
        lambda arm: arm.move_joints([0.0, 0.0]),
        lambda arm: arm.move_joints(np.full(6, math.nan)),
        lambda arm: arm.move_joints({"wrist_roll": True}),
        lambda arm: arm.gripper(True),
        lambda arm: arm.close("drop"),
        lambda arm: arm.move_to(NEAR, speed=None),
        lambda arm: arm.move_to(ikservo.Target(NEAR)),
    ],
)
def test_invalid_argument_raises_input_error_and_moves_nothing(limp, call, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ikservo.InputError):
        call(limp)
    assert not any(registers(limp, "torque_enable").values())
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "call",
    [
        lambda chain: chain.clip("x"),
        lambda chain: chain.clip(np.zeros(3)),
        lambda chain: chain.clip(None),
        lambda chain: chain.forward([True] * chain.dof),
        lambda chain: chain.with_origins(None),
        lambda chain: chain.with_origins({"nowhere": np.eye(4)}),
        lambda chain: chain.with_origins({chain.names[0]: np.eye(3)}),
        lambda _: ikservo.read_recording(3),
    ],
)
def test_invalid_geometry_argument_raises_input_error(limp, call):
    with pytest.raises(ikservo.InputError):
        call(limp.chain)


def test_plan_through_accepts_generator_of_points(limp):
    assert limp.plan_through(point for point in (NEAR, (0.22, 0.0, 0.12))).duration_s > 0.0


def test_joint_goals_accept_numpy_numbers(limp):
    plan = limp.plan_joints({"shoulder_lift": np.float32(-1.5), "shoulder_pan": np.array(0.1)})
    assert plan.goal[0] == pytest.approx(0.1, abs=1e-3)


def test_move_joints_accepts_array_in_order_of_joint_names():
    with ikservo.open_arm("so101", port="sim:?pose=home") as arm:
        here = arm.where()
        goal = here.positions_rad + np.array([0.1, 0.0, 0.0, 0.0, -0.1, 0.0])
        assert arm.move_joints(goal).reached
        joints = true_joints(arm)
        np.testing.assert_allclose([joints[name] for name in here.names], goal, atol=0.01)


@pytest.fixture
def closed():
    machine = ikservo.open_arm("so101", port="sim")
    machine.close()
    return machine


@pytest.mark.parametrize(
    "call",
    [
        lambda arm: arm.where(),
        lambda arm: arm.move_to(NEAR),
        lambda arm: arm.move_to(NEAR, wait=False).wait(),
        lambda arm: arm.plan_to(NEAR),
        lambda arm: arm.stream(),
        lambda arm: arm.relax(),
        lambda arm: arm.reconnect(0.1),
        lambda arm: arm.__enter__(),
    ],
)
def test_closed_arm_refuses_every_call(closed, call):
    with pytest.raises(ikservo.PortError, match="was closed"):
        call(closed)


def test_closing_arm_twice_is_allowed(closed):
    closed.close()
    assert "closed" in repr(closed)


def test_close_with_invalid_argument_leaves_arm_open():
    with ikservo.open_arm("so101", port="sim") as arm:
        with pytest.raises(ikservo.UnknownNameError, match="hold, relax"):
            arm.close("drop")
        assert arm.where().names
