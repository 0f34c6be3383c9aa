"""A replay begins with a motion to the recorded start, around what is in the way."""

import numpy as np
import pytest

import ikservo
from ikservo.apps.teaching.recorder import recording_header
from ikservo.apps.teaching.recording import RecordingWriter
from ikservo.apps.teaching.replaying import Replay, load_replay
from ikservo.errors import CollisionError, StoppedError
from ikservo.planning.motion_plan import sample_states
from ikservo.planning.preflight_planner import PlannedStart, PreflightPlanner
from tests.arm.simulated import context_of
from tests.arm.test_ways_around import LEFT, RIGHT


def measured_joints(arm):
    return np.array(list(arm.where().positions.values()))


def test_replay_begins_with_way_around_obstacle(arm_between_posts, tmp_path):
    arm, path = arm_between_posts(tmp_path)
    assert load_replay(arm, path)[1].duration_s > 0.0
    arm.scene.add("box", "the post", centre_m=(0.22, 0.0, 0.12), size_m=[0.15, 0.04, 0.25])
    assert load_replay(arm, path)[1].duration_s > 0.0
    tips_m = []
    result = arm.replay(path, on_progress=lambda progress: tips_m.append(progress.tip_m))
    assert np.linalg.norm(tips_m[0] - LEFT) < 0.01  # reported from the first motion on
    assert result.error_rad < 0.02
    assert np.linalg.norm(result.measured_tip_m - RIGHT) < 0.003


def test_planned_replay_takes_the_way_around_that_was_planned(arm_between_posts, tmp_path):
    arm, path = arm_between_posts(tmp_path)
    arm.scene.add("box", "the post", centre_m=(0.22, 0.0, 0.12), size_m=[0.15, 0.04, 0.25])
    motion, start = Replay(path), measured_joints(arm)
    planner = PreflightPlanner(arm.context, PlannedStart(start), arm.poses)
    loaded, plan = motion.plan(arm.context, start, planner)
    assert plan.around
    shown = sample_states(plan.trajectory)[0]
    driven = []
    motion.run(arm, lambda progress: driven.append(progress.setpoints_rad.copy()), loaded)
    away = np.abs(np.array(driven)[:, None] - shown[None]).max(axis=2).min(axis=1)
    assert away.max() < 0.05
    assert np.linalg.norm(arm.where().tip_m - RIGHT) < 0.003


def test_planned_replay_is_refused_once_its_start_is_blocked(arm_between_posts, tmp_path):
    arm, path = arm_between_posts(tmp_path)
    motion, start = Replay(path), measured_joints(arm)
    planner = PreflightPlanner(arm.context, PlannedStart(start), arm.poses)
    loaded, plan = motion.plan(arm.context, start, planner)
    assert not plan.around
    arm.scene.add("box", "the post", centre_m=(0.22, 0.0, 0.12), size_m=[0.15, 0.04, 0.25])
    with pytest.raises(CollisionError, match="the post"):
        motion.run(arm, None, loaded)
    np.testing.assert_allclose(measured_joints(arm), start, atol=0.01)


def test_stop_on_way_around_ends_replay(arm_between_posts, tmp_path):
    arm, path = arm_between_posts(tmp_path)
    arm.scene.add("box", "the post", centre_m=(0.22, 0.0, 0.12), size_m=[0.15, 0.04, 0.25])
    with pytest.raises(StoppedError):
        arm.replay(path, on_progress=lambda progress: arm.stop())
    assert np.linalg.norm(arm.where().tip_m - RIGHT) > 0.05


def test_program_may_begin_replay_with_way_around_obstacle(arm_between_posts, tmp_path):
    arm, path = arm_between_posts(tmp_path)
    arm.scene.add("box", "the post", centre_m=(0.22, 0.0, 0.12), size_m=[0.15, 0.04, 0.25])
    context = context_of(arm)
    end = Replay(path).end(context, measured_joints(arm))
    assert np.linalg.norm(context.planner.tip(end) - RIGHT) < 0.003


def test_replay_of_obstructed_recording_moves_nothing(arm_between_posts, tmp_path):
    arm, path = arm_between_posts(tmp_path)
    before = measured_joints(arm)
    arm.scene.add("box", "the wall", centre_m=RIGHT, size_m=(0.03, 0.03, 0.03))
    with pytest.raises(CollisionError, match="the wall"):
        arm.replay(path)
    np.testing.assert_allclose(measured_joints(arm), before, atol=0.01)


@pytest.fixture
def arm_between_posts():
    """Return a function that records the arm at rest on the right and moves it to the left."""
    with ikservo.open_arm("so101", port="sim:?pose=home") as arm:

        def prepare(folder):
            arm.move_to(RIGHT)
            path, joints = folder / "rest.jsonl", measured_joints(arm)
            with RecordingWriter(path, recording_header(arm.model, 0.1)) as writer:
                for step in range(11):
                    writer.write(0.1 * step, joints)
            arm.move_to(LEFT)
            return arm, path

        yield prepare
