"""P7: if any line of the loop fails in mid-motion, the arm holds within a few packets."""

import pytest

from tests.arm.audit import Auditor
from tests.arm.line_tracing import FailingLine, LineTracer
from tests.arm.random_faults import seeded
from tests.arm.seeds import log, part_of
from tests.arm.short_motions import open_simulated, short_move
from tests.arm.simulated import clock_of, line_of, registers, run_trajectory

PACKETS = 3  # to a joint
TRAVEL_TICKS = 60  # what a dead program leaves, too


@pytest.mark.sample(1)
@pytest.mark.parametrize("name", ["so101", "koch"])
@pytest.mark.parametrize("most", [4, pytest.param(33, marks=pytest.mark.campaign)])
@pytest.mark.timeout(1800)
def test_exception_in_any_control_loop_line_makes_arm_hold(name, most, capsys):
    places = loop_of(name)
    tried = [places[i] for i in part_of(len(places))][:: len(places) // most]
    for place, hits in tried:
        check_held(name, place, hits)
    log(capsys, f"{name}: {len(tried)} of {len(places)} lines failed, the arm held each time")
    assert tried


def loop_of(name):
    """Return each line that a motion executes repeatedly, and its count."""
    with open_simulated(name, 0) as arm:
        arm.enable()
        with LineTracer() as traced:
            move(arm, traced)
    return traced.lines_of_a_cycle()


def move(arm, traced):
    run_trajectory(arm, lambda _: short_move(arm, seeded(1), "normal"), traced.begin, "normal")


def check_held(name, place, hits):
    with open_simulated(name, 0) as arm:
        arm.enable()
        auditor, clock = Auditor(arm), clock_of(arm)
        with (
            FailingLine(place, hits // 2) as traced,
            pytest.raises(ZeroDivisionError, match=str(place[1])),
        ):
            move(arm, traced)
        written, before = len(auditor.goals), registers(arm, "present_position")
        clock.sleep_until(clock.now_s() + 1.0)
        goals, servos = auditor.goals[written:], line_of(arm).servos
        assert {goal.servo_id for goal in goals} == set(servos), place
        assert len(goals) <= PACKETS * len(servos), place
        after = registers(arm, "present_position")
        assert all(abs(after[i] - before[i]) <= TRAVEL_TICKS for i in servos), place
        assert all(registers(arm, "torque_enable").values()), place
        assert auditor.faults() == [], place
