"""The tip of a simulated arm: its position, and hands that lead it to a point."""

import json
from dataclasses import replace

import numpy as np
import pytest

import servosim
from servosim import read_arm_file
from servosim.assembly import BenchServo, make_arm_world, make_bench_world
from servosim.errors import ArmFileError, SimulatorError
from servosim.remote import RemoteControl
from tests.oracle import ARMS, CONFIGS, tip_from_joints

POINT_M = (0.23, 0.05, 0.04)


@pytest.fixture
def port():
    return servosim.open_port(f"sim:{CONFIGS / 'so101' / 'arm.toml'}?pose=home")


def world_of(arm, pose="home"):
    return make_arm_world(read_arm_file(CONFIGS / arm / "arm.toml"), pose)


def true_tip_m(world, arm="so101"):
    return tip_from_joints(arm, {joint.name: joint.position for joint in world.joints})


def ask(port, **request):
    return RemoteControl(None, port.line).respond(json.dumps({"do": "hand", **request}))


@pytest.mark.parametrize("arm", ARMS)
def test_simulated_tip_position_equals_pinocchio(arm):
    world, chance = world_of(arm), np.random.default_rng(3)
    for _ in range(5):
        positions = chance.uniform(-1.0, 1.0, len(world.joints))
        joints = dict(zip((joint.name for joint in world.joints), positions, strict=True))
        np.testing.assert_allclose(
            world.tip.position_m(positions), tip_from_joints(arm, joints), atol=1e-12
        )


@pytest.mark.parametrize("arm", ARMS)
def test_sim_posture_at_point_is_exact_and_inside_limits(arm):
    world = world_of(arm)
    start = [joint.position for joint in world.joints]
    limits = np.array(list(world.limits.values()))
    point_m = world.tip.position_m(np.array(start) + 0.2)
    found = world.tip.posture_at(point_m, start)
    np.testing.assert_allclose(world.tip.position_m(found), point_m, atol=2e-5)
    assert np.all((limits[:, 0] <= found) & (found <= limits[:, 1]))


def test_sim_posture_from_start_beyond_limit_is_inside_limits():
    world = world_of("so101")
    start = [joint.position for joint in world.joints]
    start[4] = world.limits["wrist_roll"][1] + 0.03
    found = world.tip.posture_at(POINT_M, start)
    assert found[4] == world.limits["wrist_roll"][1]


def test_sim_posture_is_found_from_start_at_limit():
    world = world_of("so101")
    start = [joint.position for joint in world.joints]
    start[1] = world.limits["shoulder_lift"][1]
    found = world.tip.posture_at(POINT_M, start)
    np.testing.assert_allclose(world.tip.position_m(found), POINT_M, atol=2e-5)


def test_simulated_hands_move_tip_of_limp_arm_to_point(port):
    world = port.line.world
    world.lead_tip(POINT_M)
    port.clock.sleep_until(3.0)
    np.testing.assert_allclose(true_tip_m(world), POINT_M, atol=5e-4)


def test_simulated_hands_move_all_joints_in_same_time(port):
    world = port.line.world
    start = np.array([joint.position for joint in world.joints])
    world.lead_tip(POINT_M, speed=0.5)
    goals = np.array([world.hands[j.name].path(99.0)[0] for j in world.joints[:5]])
    ways = goals - start[:5]
    halfway_s = np.abs(ways).max() / 0.5 / 2
    midway = np.array([world.hands[j.name].path(halfway_s)[0] for j in world.joints[:5]])
    np.testing.assert_allclose(midway, start[:5] + ways / 2, atol=1e-9)


def test_simulated_hands_do_not_move_gripper_with_tip(port):
    port.line.world.lead_tip(POINT_M)
    assert set(port.line.world.hands) == {
        "shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll"
    }  # fmt: skip


def test_simulated_hands_hold_tip_already_at_point(port):
    world = port.line.world
    here_m = true_tip_m(world)
    world.lead_tip(here_m)
    port.clock.sleep_until(2.0)
    np.testing.assert_allclose(true_tip_m(world), here_m, atol=5e-4)


def test_simulated_hands_refuse_tip_point_out_of_reach(port):
    with pytest.raises(SimulatorError, match=r"cannot be moved to \(0.900, 0.000, 0.000\) m; it"):
        port.line.world.lead_tip((0.9, 0.0, 0.0))
    assert port.line.world.hands == {}


def test_simulated_servos_without_arm_have_no_tip():
    with pytest.raises(SimulatorError, match="no arm with a tip"):
        make_bench_world([BenchServo(1, "STS3215")]).lead_tip(POINT_M)


def test_unknown_sim_tip_link_error_lists_known_links():
    arm = replace(read_arm_file(CONFIGS / "so101" / "arm.toml"), tip="beak")
    with pytest.raises(ArmFileError, match="no link 'beak'; has: base"):
        make_arm_world(arm)


def test_sim_control_socket_moves_tip_and_reports_position(port):
    assert ask(port, tip_m=POINT_M) == {"ok": True}
    port.clock.sleep_until(3.0)
    state = RemoteControl(None, port.line).respond('{"do": "state"}')
    np.testing.assert_allclose(state["tip_m"], true_tip_m(port.line.world), atol=1e-12)
    np.testing.assert_allclose(state["tip_m"], POINT_M, atol=5e-4)


def test_sim_control_socket_releases_one_joint_or_all(port):
    ask(port, tip_m=POINT_M)
    assert ask(port, joint="elbow_flex", release=True) == {"ok": True}
    assert "elbow_flex" not in port.line.world.hands
    assert len(port.line.world.hands) == 4
    assert ask(port, release=True) == {"ok": True}
    assert port.line.world.hands == {}


@pytest.mark.parametrize(
    ("request_", "error"),
    [
        ({"tip_m": [0.2, 0.0]}, "is not a point"),
        ({"tip_m": [0.2, 0.0, float("nan")]}, "tip_m = nan"),
        ({"tip_m": "here"}, "could not convert"),
        ({"tip_m": 3}, "not iterable"),
        ({"tip_m": POINT_M, "speed": 0}, "speed = 0"),
        ({"tip_m": POINT_M, "force": -1}, "force = -1"),
        ({"tip_m": [0.9, 0.0, 0.0]}, "mm short"),
    ],
)
def test_sim_control_socket_refuses_invalid_point(port, request_, error):
    answer = ask(port, **request_)
    assert answer["ok"] is False
    assert error in answer["error"]
    assert port.line.world.hands == {}
