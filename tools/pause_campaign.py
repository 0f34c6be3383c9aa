"""Programs suspended in the middle of a motion and resumed: SIGSTOP, then SIGCONT.

Run ``python tools/pause_campaign.py --pauses 100``; see ``served_arm.py`` for how an arm is
served and observed. An error in resuming a motion is visible as a long step between two goals in
the simulator's own audit.
"""

from __future__ import annotations

import argparse
import math
import os
import random
import signal
import sys
import tempfile
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

from kill_campaign import MOST_TRAVEL
from served_arm import Served, apart, begun, forked, served, somewhere, start_anew

import ikservo

ENDED_WELL, HELD_UP = 0, 8  # exit codes; 8: Dynamixels have stopped, so the motion is refused
LONGEST_S, SLACK = 0.05, 1.2  # longest time of a step, and a tolerance; see docs/faults.md


@dataclass
class Pauses:
    """The results of the pauses of one arm.

    Attributes:
        travels: The largest travel of a joint while its program was suspended, in each pause,
            ticks.
        codes: Exit codes of the programs.
        failed: Number of times that the next program could not start.
    """

    travels: list[int] = field(default_factory=list[int])
    codes: list[int] = field(default_factory=list[int])
    failed: int = 0


def pause(arm: Served, dice: random.Random, pauses: Pauses) -> None:
    """Suspend a program at a random instant for a random time, let it end, and start the next."""
    child = begun(arm, dice)
    time.sleep(dice.uniform(0.15, 2.0))
    before = arm.ticks()
    os.kill(child, signal.SIGSTOP)
    time.sleep(0.1 * 50.0 ** dice.random())
    pauses.travels.append(apart(before, arm.ticks()))
    os.kill(child, signal.SIGCONT)
    _, status = os.waitpid(child, 0)
    pauses.codes.append(os.waitstatus_to_exitcode(status))
    _, status = os.waitpid(forked(lambda: start_anew(arm), quiet=False), 0)
    pauses.failed += bool(status)


def longest_ticks(name: str) -> float:
    """Return the longest step of a goal that the arm's fastest speed allows after a pause."""
    fastest_rad_s = max(speed.rad_s for speed in ikservo.load_model(name).speeds.values())
    return SLACK * fastest_rad_s * LONGEST_S * 4096 / math.tau + 1


def campaign(name: str, count: int, seed: int) -> bool:
    """Suspend programs that move one arm, print the results, and return whether all is well."""
    dice, pauses = random.Random(seed), Pauses()
    model = ikservo.load_model(name)  # the solver is compiled once, before anything is timed
    ikservo.solve(model.chain, ikservo.Target(somewhere(name, dice)))
    with tempfile.TemporaryDirectory() as folder:
        with served(name, Path(folder)) as arm:
            os.waitpid(forked(lambda: start_anew(arm)), 0)
            for _ in range(count):
                pause(arm, dice, pauses)
        goals, outside, step = arm.audited()
    most = longest_ticks(name)
    print(
        f"{name}: {count} pauses of 0.1 to 5 s; travel meanwhile at most {max(pauses.travels)} "
        f"ticks; longest step of {goals} goals {step} ticks, {most:.0f} allowed; {outside} outside "
        f"limits; {pauses.failed} starts failed; exit codes {dict(Counter(pauses.codes))}",
        flush=True,
    )
    well = set(pauses.codes) <= {ENDED_WELL, HELD_UP} and not (outside or pauses.failed)
    return well and step <= most and max(pauses.travels) <= MOST_TRAVEL


def run() -> int:
    """Suspend programs of both families."""
    parser = argparse.ArgumentParser(description="Suspend programs while an arm moves")
    parser.add_argument("--pauses", type=int, default=100)
    parser.add_argument("--arm", action="append", help="default: so101 and koch")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    names = options.arm or ["so101", "koch"]
    well = [campaign(name, options.pauses, options.seed) for name in names]
    return 0 if all(well) else 1


if __name__ == "__main__":
    sys.exit(run())
