"""The promises about faults, in many seeded motions; the suite runs a few of each."""

import pytest

import ikservo
from ikservo.errors import RefusedError
from tests.arm.audit import Auditor
from tests.arm.random_faults import (
    move_with_fault,
    random_fault,
    seeded,
    servo_ids,
    servos_without_torque,
)
from tests.arm.seeds import few_or_many, log, spread
from tests.arm.simulated import clock_of, line_of, servo_group

FAMILIES = ("so101", "koch")
BITS = {"so101": (0, 1, 2, 3, 5), "koch": (0, 2, 3, 4, 5)}  # of the datasheets
COMPLAINTS = [
    (name, servo_id, bit)
    for place in range(5)
    for servo_id in range(1, 7)
    for name, bit in ((name, BITS[name][place]) for name in FAMILIES)
]


@pytest.mark.full
@few_or_many(2, 60)
def test_random_bus_fault_never_causes_wrong_goals(seeds, capsys):
    states = {}
    for seed in seeds:
        dice, name = seeded(seed), FAMILIES[seed % 2]
        fault = random_fault(dice, servo_ids(name))
        outcome = move_with_fault(name, dice, fault)
        assert outcome.wrong == [], (seed, name, fault)
        states[outcome.state] = states.get(outcome.state, 0) + 1
    log(capsys, f"{len(seeds)} motions: {states}")


@few_or_many(1, 50)
def test_silent_servo_stops_the_arm_within_three_cycles(seeds, capsys):
    most = 0
    for seed in seeds:
        dice, name = seeded(seed), FAMILIES[seed % 2]
        fault = {"kind": "silent", "id": dice.choice(servo_ids(name)),
                 "at_share": 0.05 + 0.9 * spread(seed)}  # fmt: skip
        outcome = move_with_fault(name, dice, fault, speed="normal", hook=servos_without_torque)
        assert (outcome.state, outcome.wrong) == ("ServoSilentError", []), (seed, name, fault)
        most = max(most, outcome.cycles_after)
    log(capsys, f"{len(seeds)} phases: at most {most} writes of goals, two that hold included")
    assert most <= 5


@pytest.mark.full
@few_or_many(1, 50)
def test_servo_reset_is_noticed_in_500_ms_and_torque_stays_off(seeds, capsys):
    worst_s = 0.0
    for seed in seeds:
        dice, name = seeded(seed), FAMILIES[seed % 2]
        fault = {"kind": "reset", "id": dice.choice(servo_ids(name)),
                 "at_share": dice.uniform(0.0, 0.6)}  # fmt: skip
        outcome = move_with_fault(name, dice, fault, speed="slow", hook=_nothing_switched_on)
        assert outcome.wrong == [], (seed, name, fault)
        assert outcome.state not in ("reached", "short"), (seed, name, fault)
        worst_s = max(worst_s, outcome.noticed_s)
    log(capsys, f"{len(seeds)} resets: noticed within {worst_s:.3f} s, 0 switched on again")
    assert worst_s <= 0.5


@pytest.mark.full
@few_or_many(1, 50)
def test_arm_does_not_move_by_itself_after_brown_out(seeds, capsys):
    for seed in seeds:
        dice, name = seeded(seed), FAMILIES[seed % 2]
        fault = {"kind": "brownout", "for_s": dice.uniform(0.01, 2.0),
                 "at_share": dice.uniform(0.0, 0.6)}  # fmt: skip
        outcome = move_with_fault(name, dice, fault, speed="slow", hook=_stays_down)
        assert outcome.wrong == [], (seed, name, fault)
    log(capsys, f"{len(seeds)} brown-outs: 0 motions after the supply came back")


@few_or_many(2, len(COMPLAINTS))
def test_servo_alarm_is_noticed_within_half_a_second(seeds, capsys):
    worst_s = 0.0
    for seed in seeds:
        name, servo_id, bit = COMPLAINTS[seed]
        fault = {"kind": "alarm", "id": servo_id, "bits": 1 << bit, "at_share": 0.6 * spread(seed)}
        outcome = move_with_fault(name, seeded(seed), fault, speed="slow")
        assert (outcome.state, outcome.wrong) == ("ServoAlarmError", []), (name, servo_id, bit)
        worst_s = max(worst_s, outcome.noticed_s)
    log(capsys, f"{len(seeds)} complaints: noticed within {worst_s:.3f} s")
    assert worst_s <= 0.5


@pytest.mark.full
@few_or_many(1, 50)
def test_pulled_cable_ends_motion_within_100_ms(seeds, capsys):
    worst_s = 0.0
    for seed in seeds:
        dice, name = seeded(seed), FAMILIES[seed % 2]
        fault = {"kind": "unplug", "at_share": dice.uniform(0.0, 0.9)}
        outcome = move_with_fault(name, dice, fault, speed="normal")
        assert (outcome.state, outcome.wrong) == ("PortLostError", []), (seed, name)
        worst_s = max(worst_s, outcome.noticed_s)
    log(capsys, f"{len(seeds)} pulled cables: said within {worst_s * 1000:.0f} ms")
    assert worst_s <= 0.1


@pytest.mark.full
@few_or_many(1, 20)
def test_motion_completes_with_10_percent_of_instructions_lost(seeds, capsys):
    states = {}
    for seed in seeds:
        dice, name = seeded(seed), FAMILIES[seed % 2]
        fault = {"kind": "lost", "probability": 0.1, "at_share": 0.0}
        outcome = move_with_fault(name, dice, fault, speed="normal")
        assert outcome.wrong == [], (seed, name)
        states[outcome.state] = states.get(outcome.state, 0) + 1
    log(capsys, f"{len(seeds)} motions with 10 % of the instructions lost: {states}")
    assert set(states) <= {"reached", "short"}


@few_or_many(4, 100)
def test_torque_on_holds_joints_where_hand_left_them(seeds, capsys):
    worst = worst_at_rest = 0
    for seed in seeds:
        dice, name = seeded(seed), FAMILIES[seed % 2]
        with ikservo.open_arm(name, port="sim", collisions=False) as arm:
            auditor, world = Auditor(arm), line_of(arm).world
            for driven in servo_group(arm).driven_joints:
                low, high = driven.position_range
                world.place(driven.joint, dice.uniform(low, high))
            arm.enable()
            assert len(auditor.switched_on) == len(servo_group(arm).driven_joints), seed
            for on in auditor.switched_on:
                away = abs(on.goal - on.present)
                # a joint let go by the hand falls on from its reading to its servo's instruction
                fallen = abs(on.ticks_s) * (on.time_s - auditor.last_read_s(on))
                assert away <= 2 + fallen, (seed, name, on)
                worst = max(worst, away)
                worst_at_rest = max(worst_at_rest, round(away - fallen))
    log(capsys, f"{len(seeds)} placements: torque comes on at most {worst} ticks away, "
        f"{worst_at_rest} but for the fall in between")  # fmt: skip


def _nothing_switched_on(_arm, auditor, at_s):
    return [f"torque on at {t}" for t in auditor.torque_on_after(at_s)]


def _stays_down(arm, auditor, at_s):
    clock = clock_of(arm)
    clock.sleep_until(clock.now_s() + 3.0)
    try:
        arm.move_joints({arm.model.joints[0].name: 0.1})
    except RefusedError as error:
        wrong = [] if "was stopped" in str(error) else [str(error)]
    else:
        wrong = ["it moved"]
    return wrong + _nothing_switched_on(arm, auditor, at_s)
