"""Programs that die in the middle of a motion: how far the arm still goes, and the next start.

Run ``python tools/kill_campaign.py --kills 200``. An arm is served by ``ikservo sim`` on a
pseudo-terminal in real time; ``ikservo move`` runs against it and is sent a signal at a random
instant. What the joints did is read past every driver, through the simulator's control socket.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import signal
import socket
import statistics
import subprocess
import sys
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Callable, Generator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import ikservo
from ikservo.arm import open_arm  # loaded here, not in each forked child
from ikservo.cli.run import main

SERVE = "import sys; from ikservo.cli.run import console; sys.argv = sys.argv[1:]; console()"
SIGNALS = {"KILL": signal.SIGKILL, "INT": signal.SIGINT, "TERM": signal.SIGTERM,
           "HUP": signal.SIGHUP}  # fmt: skip
MOST_TRAVEL, MOST_JUMP = 60, 2  # ticks
REST_S = 0.7  # after which every joint stands
STOPPED = 130

Ticks = Mapping[int, int]


@dataclass(frozen=True)
class Served:
    """An arm on a pseudo-terminal."""

    name: str
    port: Path
    control: Path

    def state(self) -> list[dict[str, Any]]:
        """Return what the simulator knows about each servo."""
        with socket.socket(socket.AF_UNIX) as line:
            line.connect(str(self.control))
            line.sendall(b'{"do": "state"}\n')
            with line.makefile() as answer:
                return json.loads(answer.readline())["servos"]

    def ticks(self) -> Ticks:
        """Return each servo's present position."""
        return {servo["id"]: servo["position"] for servo in self.state()}


@dataclass
class Tally:
    """What became of the signals sent to one arm.

    Attributes:
        travels: The furthest that a joint still went, each time, ticks.
        jumps: The furthest that a joint moved at the next start.
        moving: How many signals met a moving arm.
        let_go: How often a servo had no torque afterwards.
        failed: How often the next program could not start.
        codes: Exit codes of programs that could catch the signal.
    """

    travels: list[int] = field(default_factory=list[int])
    jumps: list[int] = field(default_factory=list[int])
    moving: int = 0
    let_go: int = 0
    failed: int = 0
    codes: list[int] = field(default_factory=list[int])

    def words(self, name: str, signal_name: str) -> str:
        """Return one line for a person."""
        return (
            f"{name}: {len(self.travels)} x SIG{signal_name}, {self.moving} in motion; travel "
            f"after it at most {max(self.travels)} ticks, "
            f"median {statistics.median(self.travels):.0f}; "
            f"next start moved at most {max(self.jumps)} ticks, {self.failed} failed; "
            f"let go {self.let_go} times; "
            f"exit codes {dict(Counter(self.codes))}"
        )

    def good(self, signal_name: str) -> bool:
        """Whether the promise was kept; a program that can brake travels while it does."""
        short = signal_name != "KILL" or max(self.travels) <= MOST_TRAVEL
        return short and max(self.jumps) <= MOST_JUMP and not (self.let_go or self.failed)


@contextmanager
def served(name: str, folder: Path) -> Generator[Served]:
    """Serve an arm until the block ends."""
    arm = Served(name, folder / f"{name}.port", folder / f"{name}.control")
    words = ["sim", name, "--link", str(arm.port), "--control", str(arm.control), "--pose", "home"]
    with subprocess.Popen(
        [sys.executable, "-c", SERVE, "ikservo", *words], stdout=subprocess.PIPE, text=True
    ) as server:
        assert server.stdout is not None  # it was asked for
        server.stdout.readline()
        try:
            yield arm
        finally:
            server.terminate()


def forked(do: Callable[[], int], *, quiet: bool = True) -> int:
    """Do something in a process of its own; return its id."""
    child = os.fork()
    if child:
        return child
    code = 1
    try:
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            default = signal.default_int_handler if number is signal.SIGINT else signal.SIG_DFL
            signal.signal(number, default)
        if quiet:
            null = os.open(os.devnull, os.O_RDWR)
            for stream in (0, 1, 2):
                os.dup2(null, stream)
        code = do()
    except Exception:  # it would be lost: the process ends here
        traceback.print_exc()
    finally:
        os._exit(code)


def strike(arm: Served, number: int, dice: random.Random, tally: Tally) -> None:
    """Start a motion, send it a signal at a random instant, look, and start anew."""
    speed = dice.choice(("slow", "normal", "fast"))
    where = [f"{x:.4f}" for x in somewhere(arm.name, dice)]
    words = ["move", *where, "--arm", arm.name, "--port", str(arm.port), "--speed", speed, "--yes"]
    child = forked(lambda: main([*words, "--no-collision"]))
    time.sleep(dice.uniform(0.15, 2.5))
    before_s, before = time.monotonic(), arm.ticks()
    os.kill(child, number)
    _, status = os.waitpid(child, 0)
    code = os.waitstatus_to_exitcode(status)
    after = arm.ticks()
    took_s = time.monotonic() - before_s
    tally.moving += apart(before, after) > 3 * took_s or code == STOPPED
    time.sleep(REST_S)
    stands = arm.state()
    at_rest = {servo["id"]: servo["position"] for servo in stands}
    tally.travels.append(apart(before, at_rest))
    tally.let_go += not all(servo["torque"] for servo in stands) and code != 0
    tally.codes.append(code)
    _, status = os.waitpid(forked(lambda: start_anew(arm), quiet=False), 0)
    tally.failed += bool(status)
    time.sleep(0.1)
    tally.jumps.append(apart(at_rest, arm.ticks()))


def start_anew(arm: Served) -> int:
    """Open the arm and switch its torque on, as the next program would."""
    try:
        with open_arm(arm.name, port=str(arm.port)) as machine:
            machine.enable()
    except ikservo.IkservoError as error:
        print(f"{arm.name} could not be started again: {error}", file=sys.stderr, flush=True)
        return 1
    return 0


def somewhere(name: str, dice: random.Random) -> list[float]:
    """Return a point that the arm reaches, not far from its home pose."""
    model = ikservo.load_model(name)
    home = model.chain_pose("home")
    q = [x + dice.uniform(-0.8, 0.8) for x in home]
    q = [min(max(x, lo), hi) for x, lo, hi in zip(q, model.chain.lower_rad, model.chain.upper_rad,
                                                  strict=True)]  # fmt: skip
    return [float(x) for x in model.chain.forward(q)[:3, 3]]


def apart(one: Ticks, other: Ticks) -> int:
    """Return the furthest that any servo is from where it was."""
    return max(abs(one[i] - other[i]) for i in one)


def run() -> int:
    """Send signals to both families and print what became of them."""
    parser = argparse.ArgumentParser(description="Signals to programs that move an arm")
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--signal", choices=SIGNALS, default="KILL")
    parser.add_argument("--arm", action="append", help="so101 and koch if not given")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    good = True
    for name in options.arm or ["so101", "koch"]:
        dice, tally = random.Random(options.seed), Tally()
        model = ikservo.load_model(name)  # the solver is compiled once, before anything is timed
        ikservo.solve(model.chain, ikservo.Target(somewhere(name, dice)))
        with tempfile.TemporaryDirectory() as folder, served(name, Path(folder)) as arm:
            start = forked(lambda arm=arm: start_anew(arm))
            os.waitpid(start, 0)
            for _ in range(options.kills):
                strike(arm, SIGNALS[options.signal], dice, tally)
        print(tally.words(name, options.signal), flush=True)
        good = tally.good(options.signal) and good
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(run())
