"""P7: whichever line of the loop fails in mid-motion, the arm is told to hold in a few packets."""

from pathlib import Path

import pytest

import ikservo
from tests.arm.auditing import Auditor
from tests.arm.brief import brief_move, opened
from tests.arm.line_faults import Traced
from tests.arm.misfortune import chance
from tests.arm.seeds import part_of, tell
from tests.arm.simulated import line_of, registers

PRODUCT = Path(ikservo.__file__).parent
ROOMS = ("arm/streaming", "guard", "motion")
FILES = {str(path) for room in ROOMS for path in (PRODUCT / room).rglob("*.py")}
PACKETS = 3  # to a joint
TRAVEL_TICKS = 60  # what a dead program leaves, too
LOOPS = 20  # what runs more often than this in a motion belongs to its loop


class Watched(Traced):
    """Lines of whatever the loop goes through from its second beat on, not of a list."""

    def __init__(self, fails=None, at=1):
        super().__init__(at=at)
        self._files, self._wanted, self._began = FILES, fails, False

    def begin(self, _beat):
        if not self._began:
            self._began, self._fails = True, self._wanted
            self.hits.clear()


@pytest.mark.parametrize("name", ["so101", "koch"])
@pytest.mark.parametrize("most", [4, pytest.param(None, marks=pytest.mark.campaign)])
@pytest.mark.timeout(1800)
def test_whichever_line_fails_the_arm_is_told_to_hold(name, most, capsys):
    places = loop_of(name)
    every = len(places) // most if most else 1
    tried = [places[i] for i in part_of(len(places))][::every]
    for place, hits in tried:
        check_held(name, place, hits)
    tell(capsys, f"{name}: {len(tried)} of {len(places)} lines failed, the arm held each time")
    assert len(tried) >= (most or 1)


def loop_of(name):
    """Return each line that a motion comes by again and again, and how often."""
    with opened(name, 0) as arm:
        arm.enable()
        with Watched() as counted:
            move(arm, counted)
    return sorted((place, hits) for place, hits in counted.hits.items() if hits > LOOPS)


def move(arm, watched):
    arm._run_trajectory(lambda _: brief_move(arm, chance(1), "normal"), watched.begin, "normal")


def check_held(name, place, hits):
    with opened(name, 0) as arm:
        arm.enable()
        auditor, clock = Auditor(arm), arm._servos.clock
        with (
            Watched(place, hits // 2) as watched,
            pytest.raises(ZeroDivisionError, match=str(place[1])),
        ):
            move(arm, watched)
        heard, stood = len(auditor.goals), registers(arm, "present_position")
        clock.sleep_until(clock.now_s() + 1.0)
        told, servos = auditor.goals[heard:], line_of(arm).servos
        assert {goal.servo_id for goal in told} == set(servos), place
        assert len(told) <= PACKETS * len(servos), place
        stands = registers(arm, "present_position")
        assert all(abs(stands[i] - stood[i]) <= TRAVEL_TICKS for i in servos), place
        assert all(registers(arm, "torque_enable").values()), place
        assert auditor.faults() == [], place
