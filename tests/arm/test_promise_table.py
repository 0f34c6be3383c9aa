"""The true body stays above the table on every accepted path, sag included."""

import numpy as np
import pytest

import ikservo
from ikservo.errors import IkservoError
from tests.arm.simulated import context_of, line_of, servo_group
from tests.arm.test_promise_carried import open_loaded

DEEP_M = 0.001


class Table:
    """Records the lowest height of the bodies at the goals and at the true joints."""

    def __init__(self, arm):
        space = context_of(arm).collision
        self._arm, self._gaps = arm, space.distances
        self._floor = [i for i, (link, thing) in enumerate(space.pairs)
                       if thing == "the table" and link != arm.model.chain.base]  # fmt: skip

    def above_m(self, joints):
        return float(self._gaps([self._arm.joint_index.body_joints(joints)])[0][self._floor].min())

    def true_m(self):
        world = line_of(self._arm).world
        return self.above_m(
            np.array([world.joint(n).position for n in servo_group(self._arm).names])
        )


def campaign(name, speed, count, seed, *, loaded=False):
    """Return the lowest height on each accepted path [m], and the number of refusals."""
    random, lowest_m, planned_m, refused = np.random.default_rng(seed), [], [], 0
    empty = "sim:?pose=home"
    with open_loaded(name, seed) if loaded else ikservo.open_arm(name, port=empty) as arm:
        table = Table(arm)
        home_m = arm.model.chain.forward(arm.model.chain_pose("home"))[:3, 3]
        for _ in range(count):
            turn, height_m = random.uniform(-1.0, 1.0), random.uniform(0.0, 0.05)
            ahead_m = random.uniform(0.75, 1.35) * np.hypot(*home_m[:2])
            point = (ahead_m * np.cos(turn), ahead_m * np.sin(turn), height_m + arm.model.floor_m)
            true_m, goal_m = [], []

            def watch(_, true_m=true_m, goal_m=goal_m):
                true_m.append(table.true_m())
                goal_m.append(table.above_m(servo_group(arm).goals()))

            try:
                arm.move_to(point, speed=speed, on_progress=watch)
            except IkservoError:
                refused += 1
                continue
            lowest_m.append(min(true_m))
            planned_m.append(min(goal_m))
    shown = f"{name} {speed}: {len(lowest_m)} accepted, {refused} refused"
    print(f"{shown}, lowest {min(lowest_m) * 1e3:.1f} mm of {min(planned_m) * 1e3:.1f} planned")  # noqa: T201
    return np.array(lowest_m), refused


@pytest.mark.full
def test_true_arm_stays_above_table_on_accepted_paths():
    lowest_m, _ = campaign("so101", "normal", 6, seed=5)
    assert len(lowest_m) >= 3
    assert lowest_m.min() > -DEEP_M


@pytest.mark.campaign
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("speed", ["normal", "fast"])
@pytest.mark.parametrize("name", ["so101", "so100", "koch", "omx_f", "px100", "wx250s", "vx300s"])
def test_true_arm_stays_above_table_on_many_paths(name, speed):
    lowest_m, _ = campaign(name, speed, 20, seed=7)
    assert lowest_m.min() > -DEEP_M


@pytest.mark.campaign
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("speed", ["normal", "fast"])
@pytest.mark.parametrize("name", ["so101", "koch", "open_manipulator_x", "wx250s"])
def test_loaded_arm_stays_above_table_on_many_paths(name, speed):
    lowest_m, _ = campaign(name, speed, 20, seed=7, loaded=True)
    assert lowest_m.min() > -DEEP_M
