"""M1 and B9 over ten thousand brief motions each: with faults, and with losses."""

import pytest

from servosim.faults import Fault
from tests.arm.audit import Auditor
from tests.arm.random_faults import EXPECTED_ERRORS, random_fault, seeded, servo_ids
from tests.arm.seeds import few_or_many, log
from tests.arm.short_motions import open_simulated, run_short_move
from tests.arm.simulated import line_of, registers, servo_group

FAMILIES = ("so101", "koch")
EACH = 10  # motions of one arm


@few_or_many(6, 10_000)
def test_whatever_happens_in_a_brief_motion_its_goals_stay_sound(seeds, capsys):
    states = {}
    for seed in seeds:
        dice, name = seeded(seed), FAMILIES[seed % 2]
        fault = random_fault(dice, servo_ids(name))
        state, wrong = spoilt(name, seed, dice, dict(fault))
        assert wrong == [], (seed, name, fault)
        states[state] = states.get(state, 0) + 1
    log(capsys, f"{len(seeds)} brief motions: 0 goals outside limits; {states}")


def spoilt(name, seed, dice, fault):
    """Return how a brief motion ended to which something happened, and what was wrong with it."""
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


@few_or_many(2, 1000)
def test_brief_motions_end_at_their_goals_though_one_instruction_in_ten_is_lost(seeds, capsys):
    worst = 0
    for seed in seeds:
        dice, name = seeded(seed), FAMILIES[seed % 2]
        with open_simulated(name, seed) as arm:
            arm.enable()
            auditor = Auditor(arm)
            line_of(arm).faults.add(Fault("lost", probability=0.1))
            for _ in range(EACH):
                worst = max(worst, furthest_from(arm, run_short_move(arm, dice)))
            assert auditor.faults() == [], (seed, name)
    log(capsys, f"{EACH * len(seeds)} motions with 10 % lost: at most {worst} ticks beside a goal")
    assert worst <= 2  # the last step, where that packet is lost: a goal steps by two at most there


def furthest_from(arm, move):
    """Return how far a servo's goal register is from the last goal of a motion, ticks."""
    servos, goal_ticks = servo_group(arm), registers(arm, "goal_position")
    assert servos.reference()[:-1] == pytest.approx(move.goal[:-1], abs=1e-9)
    ends = zip(servos.fences, servos.goals(), strict=True)
    return max(abs(goal_ticks[fence.servo_id] - fence.tick(float(end))) for fence, end in ends)
