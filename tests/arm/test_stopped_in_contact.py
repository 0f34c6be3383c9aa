"""The contact of an arm does not get deeper over many motions."""

import contextlib

import numpy as np
import pytest

import ikservo
from ikservo.errors import IkservoError
from tests.arm.simulated import context_of, motion_runner, true_joints

MM = 0.001
NEAR = np.array([0.6, 0.25, 0.25, 0.25, 0.0])  # distance of goals from the start, rad
DEEPEST_MM = 1.0 + 0.5 + 0.1  # at first, half a millimetre, and a tick


@pytest.fixture
def arm():
    """An arm at home whose hand is a millimetre deep in a slab that its joints do not feel."""
    with ikservo.open_arm("so101", port="sim:?pose=home") as arm:
        arm.pose("home")
        joints = np.array(list(true_joints(arm).values()))
        x, y, z = arm.where().tip_m
        low_m, high_m = z - 0.2, z
        while high_m - low_m > 1e-6:
            top_m = 0.5 * (low_m + high_m)
            add_slab(arm, x + 0.15, y, top_m)
            low_m, high_m = (top_m, high_m) if depth_of(arm, joints) < MM else (low_m, top_m)
            arm.scene.remove("the slab")
        add_slab(arm, x + 0.15, y, top_m)
        yield arm


def add_slab(arm, x, y, top_m):
    center_m = (x, y, top_m - 0.025)
    arm.scene.add("box", "the slab", center_m=center_m, size_m=(0.4, 1.0, 0.05))


def depths_of(arm, postures):
    """Return the depth of the body's contacts in postures (k, n), m."""
    context = context_of(arm)
    body = np.array([context.index.body_joints(joints) for joints in postures])
    return -context.collision.distances(body).min(axis=1)


def depth_of(arm, joints):
    return float(depths_of(arm, [joints])[0])


def true_depth_mm(arm):
    return depth_of(arm, np.array(list(true_joints(arm).values()))) / MM


def goal_by_way_of_deeper(arm, start, dice):
    """Return joints near ``start`` at equal depth whose path goes deeper, or ``start``."""
    depth_m = depth_of(arm, start)
    steps = 1e-4 * np.eye(len(start))[: len(NEAR)]
    for _ in range(600):
        goal = start.copy()
        goal[: len(NEAR)] += dice.uniform(-NEAR, NEAR)
        for _ in range(4):  # Newton's method
            slope = (depths_of(arm, goal + steps) - depth_of(arm, goal)) / 1e-4
            excess_m = depth_of(arm, goal) - depth_m + 0.02 * MM
            goal[: len(NEAR)] -= slope * excess_m / max(slope @ slope, 1e-9)
        path = start + np.linspace(0.0, 1.0, 21)[:, None] * (goal - start)
        deeper_m = depths_of(arm, path) - depth_m
        if -0.3 * MM < deeper_m[-1] < 0.0 and 0.3 * MM < deeper_m.max() < 0.49 * MM:
            return goal
    return start


@pytest.mark.full
def test_contact_depth_does_not_grow_over_stopped_motions(arm):
    dice, depths_mm = np.random.default_rng(1), [true_depth_mm(arm)]
    for _ in range(20):
        start, latest_m = motion_runner(arm).start_position(), dice.uniform(0.0, 0.3) * MM
        goal, began_m = goal_by_way_of_deeper(arm, start, dice), depth_of(arm, start)

        def stop_when_deeper(progress, deepest_m=began_m + latest_m):
            if depth_of(arm, progress.setpoints_rad) > deepest_m:
                arm.stop()

        with contextlib.suppress(IkservoError):
            joints = dict(zip(arm.joint_names[: len(NEAR)], goal, strict=False))
            arm.move_joints(joints, speed="slow", on_progress=stop_when_deeper)
        arm.acknowledge()
        depths_mm.append(true_depth_mm(arm))
    assert max(depths_mm) < DEEPEST_MM
    assert max(np.abs(np.diff(depths_mm))) > 0.05  # it moved at all


@pytest.mark.campaign
def test_contact_depth_does_not_grow_over_small_motions(arm):
    dice, depths_mm, accepted = np.random.default_rng(2), [true_depth_mm(arm)], 0
    while accepted < 50:
        start = motion_runner(arm).start_position()
        goal = start[: len(NEAR)] + dice.uniform(-0.01, 0.01, len(NEAR))
        reached = np.append(goal, start[len(NEAR) :])
        if abs(depth_of(arm, reached) - depth_of(arm, start)) > 0.3 * MM:
            continue
        with contextlib.suppress(IkservoError):
            arm.move_joints(dict(zip(arm.joint_names[: len(NEAR)], goal, strict=False)))
            accepted += 1
        depths_mm.append(true_depth_mm(arm))
    assert max(depths_mm) < DEEPEST_MM
