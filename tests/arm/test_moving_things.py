"""If an obstacle moves into the path, the arm stops before it or goes around it."""

import numpy as np
import pytest

import ikservo
from ikservo.errors import StoppedError
from ikservo.guard import StopKind
from tests.arm.simulated import context_of, servo_group, true_joints

LEFT, RIGHT = (0.2, 0.12, 0.1), (0.2, -0.12, 0.1)
ASIDE_M = (0.2, -0.6, 0.12)
BRAKING_M = 0.06  # the arm needs 0.05 m to stop at this speed
GOAL_M = 0.02
CASES, CAMPAIGN_CASES = 5, 100


def distances_m(arm, joints):
    """Return the distance of the arm from the box in postures (k, n), as (k,)."""
    context = context_of(arm)
    pairs = [thing == "the box" for _, thing in context.collision.pairs]
    return context.collision.distances(context.index.body_joints(joints))[:, pairs].min(axis=1)


def blocking_centre(arm, random, path):
    """Return where the box blocks a path (k, n) but neither end, and when it may appear.

    The box gets a new size each time that it does not.
    """
    while True:
        size_m = (*random.uniform(0.02, 0.05, 2), random.uniform(0.1, 0.24))
        k = random.integers(len(path))
        tip_m = context_of(arm).planner.tip(path[k])
        centre_m = (*(tip_m[:2] + random.uniform(-0.02, 0.02, 2)), 0.12)
        arm.scene.change("the box", center_m=centre_m, size_m=size_m)
        apart_m = distances_m(arm, path)
        arm.scene.change("the box", center_m=ASIDE_M)
        if apart_m.min() < 0.0 and apart_m[0] > BRAKING_M and apart_m[-1] > GOAL_M:
            near = int((apart_m < BRAKING_M).argmax())
            return centre_m, random.integers(1, near) / len(path)


def move_past_box(case, *, replan):
    """Move an arm, and move a box into its path meanwhile.

    Returns:
        The smallest distance of the true joints from the box [m], the error that ended the motion,
        and the stop of the arm.
    """
    random, near_m, error = np.random.default_rng(case), [], None
    with ikservo.open_arm("so101", port="sim:?pose=home") as arm:
        arm.move_to(LEFT)
        arm.scene.add("box", "the box", center_m=ASIDE_M, size_m=(0.03, 0.03, 0.2))
        path = arm.plan_to(RIGHT).sample(0.02).positions
        centre_m, when = blocking_centre(arm, random, path)

        def on_progress(now):
            if not near_m and now.elapsed_s >= when * now.duration_s:
                arm.scene.change("the box", center_m=centre_m)
            if near_m or now.elapsed_s >= when * now.duration_s:
                joints = np.array([list(true_joints(arm).values())])
                near_m.append(distances_m(arm, joints)[0])

        try:
            if case % 2:
                arm.execute(arm.plan_to(RIGHT, replan=replan), on_progress=on_progress)
            else:
                arm.move_to(RIGHT, replan=replan, on_progress=on_progress)
        except ikservo.IkservoError as raised:
            error = raised
        return min(near_m), error, arm.stop_reason


@pytest.mark.full
@pytest.mark.parametrize("case", range(CASES))
def test_arm_avoids_box_moved_into_its_path(case):
    near_m, error, stop = move_past_box(case, replan=True)
    assert near_m > 0.0
    assert error is None
    assert stop is None


@pytest.mark.campaign
def test_arm_never_touches_boxes_moved_into_its_path():
    ends = [move_past_box(case, replan=True) for case in range(CAMPAIGN_CASES)]
    assert min(near_m for near_m, _, _ in ends) > 0.0
    assert sum(error is None for _, error, _ in ends) >= 0.95 * CAMPAIGN_CASES


@pytest.mark.full
def test_arm_stops_before_moved_box_if_replanning_is_off():
    near_m, error, stop = move_past_box(0, replan=False)
    assert near_m > 0.0
    assert isinstance(error, StoppedError)
    assert stop.kind is StopKind.OBSTACLE
    assert "the box" in stop.text


@pytest.mark.full
def test_stop_by_user_ends_replanning_motion():
    with ikservo.open_arm("so101", port="sim:?pose=home") as arm:
        arm.scene.add("box", "the box", center_m=ASIDE_M, size_m=(0.03, 0.03, 0.2))
        seen = []

        def on_progress(now):
            seen.append(now)
            if len(seen) == 3:
                tip_m = context_of(arm).planner.tip(path[-1])
                arm.scene.change("the box", center_m=(*tip_m[:2], 0.12))
            if servo_group(arm).stop_request.times == 1:  # it brakes in front of the box
                arm.stop("enough")

        path = arm.plan_to(LEFT).sample(0.02).positions
        with pytest.raises(StoppedError):
            arm.move_to(LEFT, replan=True, on_progress=on_progress)
        assert arm.stop_reason is not None
        assert servo_group(arm).stop_request.count == 2
