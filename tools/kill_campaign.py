"""Programs killed in the middle of a motion: remaining travel of the arm, and the next start.

Run ``python tools/kill_campaign.py --kills 200``. An arm is served by ``ikservo sim`` on a
pseudo-terminal in real time; ``ikservo move`` runs against it and is sent a signal at a random
instant. The joints' motion is read without any driver, through the simulator's control socket.
"""

from __future__ import annotations

import argparse
import os
import random
import signal
import statistics
import sys
import tempfile
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

from served_arm import Served, apart, begun, forked, served, somewhere, start_anew

import ikservo

SIGNALS = {"KILL": signal.SIGKILL, "INT": signal.SIGINT, "TERM": signal.SIGTERM,
           "HUP": signal.SIGHUP}  # fmt: skip
MOST_TRAVEL, MOST_JUMP = 60, 2  # ticks
REST_S = 0.7  # time after which every joint is at rest
STOPPED = 130


@dataclass
class Tally:
    """The results of the signals sent to one arm.

    Attributes:
        travels: The largest travel of a joint after each signal, ticks, from a sample right before
            the signal.
        later: The same from a sample right after the signal; motion in between is left out.
        jumps: The largest distance that a joint moved at the next start.
        moving: Number of signals that reached a moving arm.
        let_go: Number of times that a servo had no torque afterwards.
        failed: Number of times that the next program could not start.
        goals: Number of goals sent to the servos.
        outside: Number of goals that were outside the servos' limits.
        codes: Exit codes of programs that could catch the signal.
    """

    travels: list[int] = field(default_factory=list[int])
    later: list[int] = field(default_factory=list[int])
    jumps: list[int] = field(default_factory=list[int])
    moving: int = 0
    let_go: int = 0
    failed: int = 0
    goals: int = 0
    outside: int = 0
    codes: list[int] = field(default_factory=list[int])

    def words(self, name: str, signal_name: str) -> str:
        """Return one line of text."""
        return (
            f"{name}: {len(self.travels)} x SIG{signal_name}, {self.moving} in motion; travel "
            f"after it at most {max(self.travels)} ticks, "
            f"median {statistics.median(self.travels):.0f} "
            f"(sampled right after it {max(self.later)}, {statistics.median(self.later):.0f}); "
            f"next start moved at most {max(self.jumps)} ticks, {self.failed} failed; "
            f"torque lost {self.let_go} times; "
            f"{self.outside} of {self.goals} goals outside limits; "
            f"exit codes {dict(Counter(self.codes))}"
        )

    def good(self, signal_name: str) -> bool:
        """Check whether the limits were kept; only a killed program has a limit of travel."""
        short = signal_name != "KILL" or max(self.travels) <= MOST_TRAVEL
        return (
            short
            and max(self.jumps) <= MOST_JUMP
            and not (self.let_go or self.failed or self.outside)
        )


def strike(arm: Served, number: int, dice: random.Random, tally: Tally) -> None:
    """Start a motion, send it a signal at a random instant, observe, and start again."""
    child = begun(arm, dice)
    time.sleep(dice.uniform(0.15, 2.5))
    before_s, before = time.monotonic(), arm.ticks()
    os.kill(child, number)
    at_once = arm.ticks()
    _, status = os.waitpid(child, 0)
    code = os.waitstatus_to_exitcode(status)
    after = arm.ticks()
    took_s = time.monotonic() - before_s
    tally.moving += apart(before, after) > 3 * took_s or code == STOPPED
    time.sleep(REST_S)
    stands = arm.state()
    at_rest = {servo["id"]: servo["position"] for servo in stands}
    tally.travels.append(apart(before, at_rest))
    tally.later.append(apart(at_once, at_rest))
    tally.let_go += not all(servo["torque"] for servo in stands) and code != 0
    tally.codes.append(code)
    _, status = os.waitpid(forked(lambda: start_anew(arm), quiet=False), 0)
    tally.failed += bool(status)
    time.sleep(0.1)
    tally.jumps.append(apart(at_rest, arm.ticks()))


def run() -> int:
    """Send signals to both families and print the results."""
    parser = argparse.ArgumentParser(description="Send signals to programs that move an arm")
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--signal", choices=SIGNALS, default="KILL")
    parser.add_argument("--arm", action="append", help="default: so101 and koch")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    good = True
    for name in options.arm or ["so101", "koch"]:
        dice, tally = random.Random(options.seed), Tally()
        model = ikservo.load_model(name)  # the solver is compiled once, before anything is timed
        ikservo.solve(model.chain, ikservo.Target(somewhere(name, dice)))
        with tempfile.TemporaryDirectory() as folder:
            with served(name, Path(folder)) as arm:
                start = forked(lambda arm=arm: start_anew(arm))
                os.waitpid(start, 0)
                for _ in range(options.kills):
                    strike(arm, SIGNALS[options.signal], dice, tally)
            tally.goals, tally.outside, _ = arm.audited()
        print(tally.words(name, options.signal), flush=True)
        good = tally.good(options.signal) and good
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(run())
