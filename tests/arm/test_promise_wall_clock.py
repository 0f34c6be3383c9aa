"""M9: changes of the wall clock do not affect a motion."""

import ast
import time
from pathlib import Path

import pytest

import ikservo
from tests.arm.random_faults import seeded
from tests.arm.seeds import few_or_many, log
from tests.arm.short_motions import open_simulated, short_move
from tests.arm.simulated import line_of, run_trajectory

PRODUCT = Path(ikservo.__file__).parent
FAMILIES = ("so101", "koch")
DATED = {  # recorded packets and messages of ROS 2 bear the date
    "hardware/packet_log.py",
    "apps/teaching/mcap_recording.py",  # the first of a file; the others count from there
    "apps/remote/ros/action_server.py",
    "apps/remote/ros/bridge.py",
    "apps/remote/ros/node.py",
    "apps/remote/ros/trajectory_action.py",  # goals bear it, too: an old one is refused
}


@pytest.mark.full
def test_source_code_does_not_measure_time_by_wall_clock():
    found = {str(path.relative_to(PRODUCT)) for path in PRODUCT.rglob("*.py") if asks(path)}
    assert found == DATED


def asks(path):
    """Return whether a file reads the wall clock as a number of seconds."""
    return any(
        (isinstance(node, ast.ImportFrom) and node.module == "time" and _names_it(node.names))
        or (isinstance(node, ast.Attribute) and _is_it(node))
        for node in ast.walk(ast.parse(path.read_text()))
    )


def _names_it(names):
    return {"time", "time_ns"} & {name.name for name in names}


def _is_it(node):
    return node.attr in ("time", "time_ns") and getattr(node.value, "id", "") == "time"


@pytest.mark.full
@few_or_many(2, 10)
def test_motion_packets_do_not_depend_on_wall_clock_steps(seeds, capsys, monkeypatch):
    steps = 0
    for seed in seeds:
        name = FAMILIES[seed % 2]
        straight = packets_of(name, seed)
        with monkeypatch.context() as patch:
            clock = Stepped(seed)
            clock.put_into(patch)
            stepped = packets_of(name, seed, clock.step)
            steps += clock.steps
        assert stepped == straight, (seed, name)
    log(capsys, f"{len(seeds)} motions, {steps} steps of the wall clock: every packet the same")


class Stepped:
    """A wall clock that jumps forward and back by up to a day when a test says so."""

    def __init__(self, seed):
        self._dice, self._offset_s, self._real, self.steps = seeded(seed), 0.0, time.time, 0

    def step(self, _cycle=None):
        self._offset_s = self._dice.uniform(-86_400.0, 86_400.0)
        self.steps += 1

    def put_into(self, patch):
        patch.setattr(time, "time", lambda: self._real() + self._offset_s)
        patch.setattr(time, "time_ns", lambda: int(1e9 * (self._real() + self._offset_s)))


def packets_of(name, seed, on_cycle=None):
    """Return every packet of a motion, of host and servos, with its time."""
    packets = []
    with open_simulated(name, seed) as arm:
        arm.enable()
        line_of(arm).witnesses.append(Wiretap(packets))
        move = short_move(arm, seeded(seed), "fast")
        run_trajectory(arm, lambda _: move, on_cycle, "fast")
    return packets


class Wiretap:
    def __init__(self, packets):
        self._packets = packets

    def on_frame(self, at_s, frame, _framing):
        self._packets.append((round(at_s, 9), str(frame)))

    def on_reply(self, at_s, servo, data):
        self._packets.append((round(at_s, 9), servo and servo.id, bytes(data)))
