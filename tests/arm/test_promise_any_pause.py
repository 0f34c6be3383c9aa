"""M3, M8: a motion that is paused before any line of a control cycle continues correctly."""

import numpy as np
import pytest

from tests.arm.audit import Auditor
from tests.arm.line_tracing import PausedLines
from tests.arm.random_faults import seeded
from tests.arm.seeds import few_or_many, log, part_of
from tests.arm.short_motions import open_simulated, short_move
from tests.arm.simulated import clock_of, run_trajectory, servo_group

PAUSED = 1e-5  # s for each line that is run: each cycle takes two or three times as long
PAUSES_S = (0.002, 0.012, 0.06, 0.15, 0.4, 3.0)


@pytest.mark.full
@pytest.mark.sample(1)
@pytest.mark.parametrize("name", ["so101", "koch"])
@pytest.mark.parametrize("most", [6, pytest.param(None, marks=pytest.mark.campaign)])
@pytest.mark.timeout(0)
def test_motion_survives_pause_at_any_line_of_control_cycle(name, most, capsys):
    places = cycle_of(name)
    tried = [places[i] for i in part_of(len(places))]
    if most:
        tried = tried[:: len(tried) // most + 1]
    pauses_s = PAUSES_S if most is None else [PAUSES_S[i % 6] for i in range(len(tried))]
    for i, (place, hits) in enumerate(tried):
        for pause_s in pauses_s if most is None else [pauses_s[i]]:
            at = {place: hits // 2}
            pause = lambda p, n, at=at, s=pause_s: s if at.get(p) == n else 0.0  # noqa: E731
            check(name, pause, (place, pause_s), {place[0]})
    log(
        capsys,
        f"{name}: held up before {len(tried)} of {len(places)} lines, each motion ended well",
    )


@pytest.mark.sample(1)
@pytest.mark.parametrize("name", ["so101", "koch"])
@few_or_many(2, 20)
@pytest.mark.timeout(0)
def test_motion_survives_random_pauses_of_busy_machine(name, seeds, capsys):
    pauses = 0
    for seed in seeds:
        dice = seeded(seed)
        mean_s = dice.choice((0.002, 0.008, 0.02))
        often = PAUSED / mean_s

        def busy(_place, _count, dice=dice, often=often, mean_s=mean_s):
            return dice.expovariate(1.0 / mean_s) if dice.random() < often else 0.0

        pauses += check(name, busy, seed)
    log(capsys, f"{name}: {pauses} pauses in {len(seeds)} motions, each ended well")


def cycle_of(name):
    """Return each line that a motion executes repeatedly, and its count."""
    with open_simulated(name, 0) as arm:
        arm.enable()
        with PausedLines(clock_of(arm), lambda *_: 0.0) as traced:
            move(arm, traced)
    return traced.lines_of_a_cycle()


def move(arm, traced):
    """Move every joint a little at the arm's fastest speed; return the trajectory."""
    trajectories = []

    def begin(_here):
        trajectories.append(short_move(arm, seeded(1), "fast", max_rad=0.2))
        return trajectories[0]

    run_trajectory(arm, begin, traced.begin, "fast")
    return trajectories[0]


def check(name, pause_s, where, files=None):
    """Check that the motion ends at its goal and that no goal on the way was wrong."""
    with open_simulated(name, 0) as arm:
        arm.enable()
        auditor = Auditor(arm, punctual=False)
        with PausedLines(clock_of(arm), pause_s, files=files) as traced:
            course = move(arm, traced)
        driven_joints = servo_group(arm).driven_joints
        units = np.array([driven.joint_map.unit_per_tick for driven in driven_joints])
        left = np.abs(servo_group(arm).reference() - course.goal) / units
        assert (left <= 1.0).all(), (where, left)
        assert auditor.faults() == [], where
        return traced.pauses
