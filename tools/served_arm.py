"""An arm served on a pseudo-terminal in real time, and separate programs that move it."""

from __future__ import annotations

import json
import os
import random
import signal
import socket
import subprocess
import sys
import traceback
from collections.abc import Callable, Generator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import ikservo
from ikservo.arm import open_arm  # loaded here, not in each forked child
from ikservo.cli.entry_point import main

SERVE = (
    "import sys; from ikservo.cli.entry_point import console; sys.argv = sys.argv[1:]; console()"
)

Ticks = Mapping[int, int]


@dataclass(frozen=True)
class Served:
    """An arm on a pseudo-terminal."""

    name: str
    port: Path
    control: Path
    audit: Path

    def state(self) -> list[dict[str, Any]]:
        """Return the simulator's state of each servo."""
        return self.ask({"do": "state"})["servos"]

    def ask(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """Send the simulator a request; return its response."""
        with socket.socket(socket.AF_UNIX) as line:
            line.connect(str(self.control))
            line.sendall(json.dumps(request).encode() + b"\n")
            with line.makefile() as answer:
                return json.loads(answer.readline())

    def audited(self) -> tuple[int, int, int]:
        """Return goals, goals outside limits, and the longest step; the server must have ended."""
        servos = json.loads(self.audit.read_text())["servos"]
        outside = sum(servo["goals_outside_limits"] for servo in servos)
        longest = max(servo["largest_goal_step"] for servo in servos)
        return sum(servo["goals"] for servo in servos), outside, longest

    def ticks(self) -> Ticks:
        """Return each servo's present position."""
        return {servo["id"]: servo["position"] for servo in self.state()}


@contextmanager
def served(name: str, folder: Path) -> Generator[Served]:
    """Serve an arm, first in its home pose with torque off, until the block ends."""
    arm = Served(name, *(folder / f"{name}.{part}" for part in ("port", "control", "audit")))
    words = ["sim", name, "--link", str(arm.port), "--control", str(arm.control), "--pose", "home",
             "--audit", str(arm.audit)]  # fmt: skip
    with subprocess.Popen(
        [sys.executable, "-c", SERVE, "ikservo", *words],
        stdout=subprocess.PIPE, text=True, start_new_session=True,
    ) as server:  # fmt: skip
        assert server.stdout is not None  # it is a pipe
        server.stdout.readline()
        try:
            yield arm
        finally:
            server.terminate()


def forked(do: Callable[[], int], *, quiet: bool = True) -> int:
    """Run a function in its own process; return its id."""
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
    except Exception:  # it would be lost, because the process ends here
        traceback.print_exc()
    finally:
        os._exit(code)


def begun(arm: Served, dice: random.Random) -> int:
    """Start a program that moves the arm somewhere; return its process."""
    speed = dice.choice(("slow", "normal", "fast"))
    where = [f"{x:.4f}" for x in somewhere(arm.name, dice)]
    words = ["move", *where, "--arm", arm.name, "--port", str(arm.port), "--speed", speed, "--yes"]
    return forked(lambda: main([*words, "--no-collision"]))


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
    """Return a point in the arm's reach, not far from its home pose."""
    model = ikservo.load_model(name)
    home = model.chain_pose("home")
    q = [x + dice.uniform(-0.8, 0.8) for x in home]
    q = [min(max(x, lo), hi) for x, lo, hi in zip(q, model.chain.lower_rad, model.chain.upper_rad,
                                                  strict=True)]  # fmt: skip
    return [float(x) for x in model.chain.forward(q)[:3, 3]]


def apart(one: Ticks, other: Ticks) -> int:
    """Return the maximum distance of any servo from its earlier position."""
    return max(abs(one[i] - other[i]) for i in one)
