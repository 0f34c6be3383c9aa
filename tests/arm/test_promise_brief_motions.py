"""M1 and B9 over hundreds of brief motions, with faults and with lost packets."""

import pytest

from servosim.faults import Fault
from tests.arm.audit import Auditor
from tests.arm.random_faults import EXPECTED_ERRORS, random_fault, seeded, servo_ids
from tests.arm.seeds import few_or_many, log
from tests.arm.short_motions import open_simulated, run_short_move
from tests.arm.simulated import line_of, registers, servo_group

FAMILIES = ("so101", "koch")
EACH = 10  # motions of one arm


@pytest.mark.full
@few_or_many(6, 500)
def test_goals_stay_inside_limits_after_fault_in_brief_motion(seeds, capsys):
    states = {}
    for seed in seeds:
        dice, name = seeded(seed), FAMILIES[seed % 2]
        fault = random_fault(dice, servo_ids(name))
        state, wrong = spoilt(name, seed, dice, dict(fault))
        assert wrong == [], (seed, name, fault)
        states[state] = states.get(state, 0) + 1
    log(capsys, f"{len(seeds)} brief motions: 0 goals outside limits; {states}")


def spoilt(name, seed, dice, fault):
    """Return how a brief motion with a fault ended, and its faults."""
    with open_simulated(name, seed) as arm:
        arm.enable()
        auditor, line = Auditor(arm), line_of(arm)
        at_s = line.world.time_s + 0.25 * fault.pop("at_share")
        line.faults.add(Fault(at_s=at_s, **fault))
        try:
            run_short_move(arm, dice)
        except EXPECTED_ERRORS as error:
            return type(error).__name__, auditor.faults()
        return "went through", auditor.faults()


LOST = 0.1
ON_THE_WIRE_S = 0.01  # longer than the bytes of the last goals take
END_STEP_TICKS = 6  # between two goals: feedback moves them by at most 1 rad/s
MOST_LOST = 8  # in a row: one in ten lost makes that of one goal in a hundred million


@pytest.mark.full
@few_or_many(2, 50)
def test_brief_motions_end_with_10_percent_instructions_lost(seeds, capsys):
    missing = []
    for seed in seeds:
        dice, name = seeded(seed), FAMILIES[seed % 2]
        with open_simulated(name, seed) as arm:
            arm.enable()
            auditor = Auditor(arm)
            line_of(arm).faults.add(Fault("lost", probability=LOST))
            for _ in range(EACH):
                missing += last_goals_missing(arm, dice)
            assert auditor.faults() == [], (seed, name)
    share = 1.0 - missing.count(0) / len(missing)
    log(capsys, f"{EACH * len(seeds)} motions with 10 % lost: {share:.1%} of the servos miss the "
        f"very last goal, at most {max(missing)} in a row")  # fmt: skip
    assert max(missing) < MOST_LOST
    assert share < LOST + 4.0 * (LOST / len(missing)) ** 0.5  # no more than the line has lost


def last_goals_missing(arm, dice):
    """Make a brief motion; return how many of the last goals each servo has not received.

    Each goal replaces all that were lost before it, so that only the very last can be missing.
    """
    servos, sent = servo_group(arm), []
    move = run_short_move(arm, dice, lambda cycle: sent.append(cycle.goals))
    assert servos.reference()[:-1] == pytest.approx(move.goal[:-1], abs=1e-9)
    servos.clock.sleep_until(servos.clock.now_s() + ON_THE_WIRE_S)
    held = registers(arm, "goal_position")
    columns = zip(servos.driven_joints, zip(*reversed(sent), strict=True), strict=True)
    return [lost_at_the_end([driven.tick(float(goal)) for goal in goals], held[driven.servo_id])
            for driven, goals in columns]  # fmt: skip


def lost_at_the_end(latest_first, held):
    """Return how many of the last goals [ticks] were lost, by the goal that a servo holds."""
    missing = latest_first.index(held)
    assert abs(latest_first[0] - held) <= END_STEP_TICKS * missing
    return missing
