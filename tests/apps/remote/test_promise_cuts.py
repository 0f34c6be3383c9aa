"""Loss of operator, network or server in mid-motion, in separate processes.

Judged by the goal registers of the simulated servos. Real times are printed by the campaign and
not asserted.
"""

import json
import os
import random
import signal
import time
from bisect import bisect_left
from contextlib import ExitStack, contextmanager, suppress
from statistics import median

import pytest

from tests.apps.remote.conftest import find_free_port, until
from tests.apps.remote.cutting_proxy import CUTS, FRAME_FAULTS, CuttingProxy
from tests.apps.remote.processes import (
    JOINT,
    address_of,
    operators,
    process,
    read_goal,
    serve,
    simulated_servos,
)
from tests.arm.seeds import few_or_many, log

KINDS = ("operator killed", "old goals again", *CUTS, *FRAME_FAULTS, "server killed")
CYCLE_S, HOLD_S = 0.005, 0.3
OLD_TICKS = 60  # goals of 0.3 s ago are 98 ticks away; feedback and braking take back less
STILL_TICKS = 2
REAL_TIME = "sim:?pose=home&paced=1"  # which a busy machine may not keep up with

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="fork")


class Lab:
    """A served arm, a proxy before it, and operators.

    Attributes:
        proxy: The proxy.
        server: A pipe to the process beside the arm.
    """

    def __init__(self, server, requests, proxy, port, folder):
        self.server, self._requests, self.proxy = server, requests, proxy
        self._address, self._answer = address_of(port), folder / "answer"

    def run(self, name, *arguments):
        """Start an operator; return its process id."""
        self._requests.send((name, arguments))
        return self._requests.recv()

    def begin(self, motion):
        """Return an operator once it moves the arm through the proxy."""
        pid = self.run(motion, address_of(self.proxy.port))
        until(lambda: self.ask("state")[0])
        return pid

    def ask(self, what):
        self.server.send(what)
        return self.server.recv()

    def reported(self, name):
        """Return the answer of an operator that does not use the proxy."""
        self._answer.unlink(missing_ok=True)
        self.run(name, self._address, str(self._answer))
        until(self._answer.exists)
        until(lambda: self._answer.read_text() != "")
        return json.loads(self._answer.read_text())


@contextmanager
def laboratory(folder, arm_port):
    """Serve an arm in a separate process, and start another that creates operators."""
    port = find_free_port()
    with process(operators) as (_, requests), process(serve, arm_port, port) as (child, server):
        server.send("state")
        assert server.recv()[0] is False
        proxy = CuttingProxy(port, seed=port)
        try:
            yield Lab(server, requests, proxy, port, folder), child
        finally:
            proxy.close()


class Figures:
    """Measurements at the servos.

    Attributes:
        stops_s: Times from each cut until the control loop was told to brake.
        stands_s: Times until the goals no longer changed. A motion continues for as long as its
            operator may be silent; a stream ends sooner, at its last goal.
        cuts: Number of cuts.
        faults: Broken promises.
    """

    def __init__(self):
        self.stops_s, self.stands_s, self.faults, self.cuts = [], [], [], 0

    def text(self):
        late = sum(stop > HOLD_S + CYCLE_S for stop in self.stops_s)
        return (f"{self.cuts} cuts in motion: told to brake {figures_of(self.stops_s)} later, "
                f"{late} after more than {1000 * (HOLD_S + CYCLE_S):.0f} ms; "
                f"stands {figures_of(self.stands_s)} later; faults: {self.faults}")  # fmt: skip


def figures_of(values_s):
    ordered = sorted(values_s) or [float("nan")]
    return (f"median {1000 * median(ordered):.0f} ms, p95 "
            f"{1000 * ordered[int(0.95 * len(ordered))]:.0f} ms, at most "
            f"{1000 * ordered[-1]:.0f} ms")  # fmt: skip


def measure(lab, kind, dice, figures, *, streams):
    """Cut once in motion and judge the goals that the servos received."""
    lab.ask("log")
    streams = streams or kind == "old goals again"
    pid = lab.begin("stream_upwards" if streams else "move_upwards")
    time.sleep(dice.uniform(0.6, 1.2))
    if kind in FRAME_FAULTS:
        lab.proxy.cut(kind)
        time.sleep(0.5)
    cut_s = time.monotonic()
    if kind == "operator killed":
        os.kill(pid, signal.SIGKILL)
    elif kind == "old goals again":
        os.kill(pid, signal.SIGUSR1)
    else:
        lab.proxy.cut(kind if kind in CUTS else "fall silent")
    until(lambda: not lab.ask("state")[0])
    time.sleep(1.0)  # what was delayed, held back or sent again has come
    lab.proxy.restore()
    time.sleep(0.5)
    goals = lab.ask("log")
    judge(kind, cut_s, lab.ask("stops")[-1], goals, figures)
    check_return(lab, kind, goals[-1][1], figures)
    kill_quietly(pid)


def kill_quietly(pid):
    with suppress(ProcessLookupError):
        os.kill(pid, signal.SIGKILL)


def judge(kind, cut_s, stop_s, goals, figures):
    """Record the time of the last change of the goals, and whether old ones were obeyed."""
    times, ticks = [at_s for at_s, _ in goals], [tick for _, tick in goals]
    sign = 1 if max(ticks) - ticks[0] > ticks[0] - min(ticks) else -1
    ticks = [sign * tick for tick in ticks]
    cut = bisect_left(times, cut_s)
    speed = (ticks[cut - 1] - ticks[bisect_left(times, cut_s - 0.2)]) / 0.2
    if speed < 50.0:
        return  # a busy machine, or the fault, has ended the motion before
    figures.cuts += 1
    highest = 0
    for at_s, tick in zip(times, ticks, strict=True):
        highest = max(highest or tick, tick)
        if highest - tick > OLD_TICKS:
            figures.faults.append(f"{kind}: an old goal was obeyed {at_s - cut_s:.2f} s later")
            break
    figures.stops_s.append(stop_s - cut_s)
    moving = [at_s for at_s, tick in zip(times, ticks, strict=True)
              if abs(tick - ticks[-1]) > STILL_TICKS]  # fmt: skip
    figures.stands_s.append(moving[-1] - cut_s)


def check_return(lab, kind, held, figures):
    """Check that everything moves after an acknowledgement, and nothing before."""
    moving, stopped_for, _ = lab.ask("state")
    if moving or not stopped_for:
        figures.faults.append(f"{kind}: not latched: {stopped_for!r}")
    refused = lab.reported("try_to_move")
    moved = max((abs(tick - held) for _, tick in lab.ask("log")), default=0)
    if refused != 3 or moved > STILL_TICKS:
        figures.faults.append(f"{kind}: refused {refused} of 3, moved {moved} ticks")
    if not lab.reported("acknowledge_and_return"):
        figures.faults.append(f"{kind}: it does not move again")


def kill_server(folder, dice, figures):
    """Kill the server during a motion; its servos are in a separate process."""
    with (
        simulated_servos(folder) as (port, control),
        laboratory(folder, port) as (lab, child),
    ):
        pid = lab.begin(dice.choice(("stream_upwards", "move_upwards")))
        time.sleep(dice.uniform(0.4, 1.0))
        before = read_goal(control)
        time.sleep(0.2)
        os.kill(child.pid, signal.SIGKILL)
        child.join()
        goal = read_goal(control)
        time.sleep(1.0)  # the operator goes on to send goals, to nobody
        with process(serve_again, port, lab.proxy._target) as (_, server):
            server.send("state")
            assert server.recv()[0] is False
            time.sleep(1.0)
            goals = {goal, read_goal(control)}
        figures.cuts += abs(goal - before) > STILL_TICKS
        if max(goals) - min(goals) > STILL_TICKS:
            figures.faults.append(f"server killed: goals {goals}")
        kill_quietly(pid)


def serve_again(port, tcp_port, pipe):
    """Serve the arm again at its present position."""
    serve(port, tcp_port, pipe, start=False)


@pytest.mark.full
@few_or_many(1, 200)
def test_loss_of_operator_network_or_server_makes_arm_hold(seeds, tmp_path, capsys):
    figures, many = Figures(), len(seeds) > 1
    kinds = [KINDS[seed % len(KINDS)] for seed in seeds]
    with ExitStack() as stack:
        lab = None
        for seed, kind in zip(seeds, kinds, strict=True):
            dice = random.Random(f"{kind} {seed}")
            if kind == "server killed":
                kill_server(tmp_path, dice, figures)
                continue
            if lab is None:
                port = REAL_TIME if many else "sim:?pose=home"
                lab, _ = stack.enter_context(laboratory(tmp_path, port))
            measure(lab, kind, dice, figures, streams=not many or dice.random() < 0.5)
            log(capsys, f"{seed} {kind}: {figures.text()}")
    log(capsys, f"{JOINT}: {figures.text()}")
    assert figures.faults == []
    assert not many or figures.cuts >= len(seeds) // 2  # a busy machine ends some motions before
