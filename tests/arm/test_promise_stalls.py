"""M3, M8: a stalled program continues from its last goals, without a jump."""

import pytest

from ikservo.errors import RefusedError
from tests.arm.audit import Auditor
from tests.arm.random_faults import SPEEDS, seeded
from tests.arm.seeds import few_or_many, log
from tests.arm.short_motions import open_simulated, short_move
from tests.arm.simulated import clock_of, run_trajectory, transport_of

FAMILIES = ("so101", "koch")
OFTEN = 0.01  # of what is sent
MOST_RESTARTS = 10  # of Dynamixels that stopped themselves, in one motion


@pytest.mark.full
@few_or_many(2, 40)
def test_program_stall_up_to_5_s_does_not_make_goals_jump(seeds, capsys):
    stalls = longest = 0
    for seed in seeds:
        name = FAMILIES[seed % 2]
        auditor, held_up = stalled(name, seed)
        assert auditor.faults() == [], (seed, name)
        steps = [abs(goal.tick - goal.last) for goal in auditor.goals]
        longest, stalls = max([longest, *steps]), stalls + held_up
    log(capsys, f"{stalls} stalls in {len(seeds)} motions: longest step {longest} ticks")


def stalled(name, seed):
    """Move an arm far while its program stalls before or after packets are sent."""
    dice = seeded(seed)
    with open_simulated(name, seed) as arm:
        arm.enable()
        auditor, slow = Auditor(arm, punctual=False), Slow(arm, dice)
        speed = dice.choice(SPEEDS)
        move = short_move(arm, dice, speed, max_rad=1.0)
        try:
            run_trajectory(arm, lambda _: move, None, speed)
        except RefusedError as error:
            if slow.stalls < MOST_RESTARTS or "watchdog stopped them" not in str(error):
                raise
    return auditor, slow.stalls


class Slow:
    """Stalls the program for 0.05 to 5 s at some of its packets."""

    def __init__(self, arm, dice):
        self._write, self._clock, self._dice = transport_of(arm).write, clock_of(arm), dice
        self.stalls = 0
        transport_of(arm).write = self.write

    def write(self, data):
        draw = self._dice.random() / OFTEN
        if draw < 0.5:
            self._stall()
        written = self._write(data)
        if 0.5 <= draw < 1.0:
            self._stall()
        return written

    def _stall(self):
        self.stalls += 1
        self._clock.sleep_until(self._clock.now_s() + 0.05 * 100.0 ** self._dice.random())
