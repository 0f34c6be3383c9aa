"""The lines that an arm can be on: the simulator in this process, and ports that stand for more."""

import math
import os
import random
import shutil
import tempfile
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import cache

import pytest

from ikservo.calibration.procedure import CalibrationState
from ikservo.calibration.result import CalibrationResult
from ikservo.hardware.transport import open_transport
from ikservo.model import load_model
from servosim import SimulatedPort, open_port, read_arm_file
from servosim.assembly import make_arm_world
from servosim.line import Line, LineOptions
from servosim.world import World
from tests.calibration.hidden import HiddenArm
from tests.cli.desk import Comport, plug_in
from tests.cli.real_port import PORT, SERIAL
from tests.journeys.postures import joints_in

LINES = ("sim", "pty", "real, uncalibrated", "real, calibrated")
PTY = "/dev/pts/7"
WHEN = datetime(2026, 11, 2, 14, 3, 22, tzinfo=UTC)
MARGIN_RAD = math.radians(2.0)
STEP, STOP_TICKS, MOST_TICKS = 10, 23, 1900


@dataclass
class Bench:
    """An arm on a line.

    Attributes:
        arm: Its name.
        kind: One of ``LINES``.
        port: What follows ``--port``.
        world: The simulated arm; of ``sim`` the one that was opened last, None before.
    """

    arm: str
    kind: str
    port: str
    world: object = None

    @property
    def simulated(self):
        return self.kind in ("sim", "pty")

    def joints(self):
        """Return the true position of every joint."""
        return {joint.name: joint.position for joint in self.world.joints}

    def torque(self):
        """Return which joints hold."""
        return {j.name: any(s.drive.torque_on for s in j.servos) for j in self.world.joints}


def put(monkeypatch, arm, posture, kind):
    """Put an arm in a posture on a line of that kind, limp, and return it."""
    if kind == "sim":
        return _in_process(monkeypatch, arm, posture)
    bench = Bench(arm, kind, PTY if kind == "pty" else PORT)
    hidden = _built(arm, mounted=kind.startswith("real"))
    bench.world = hidden.world
    plug_in(monkeypatch, [Comport(PORT)] if kind.startswith("real") else [])
    monkeypatch.setattr("ikservo.arm.calibrated_arm.is_pseudo_terminal", lambda name: name == PTY)
    monkeypatch.setattr("ikservo.hardware.port.open_transport", _reopened(hidden))
    monkeypatch.setattr("ikservo.maintenance.bus_benchmark.open_transport", _reopened(hidden))
    hidden.port.name = bench.port
    if kind == "real, calibrated":
        shutil.copytree(_calibrated(arm), os.environ["IKSERVO_HOME"], dirs_exist_ok=True)
    _place(hidden.world, arm, posture)
    return bench


def _in_process(monkeypatch, arm, posture):
    bench = Bench(arm, "sim", "sim")

    def opened(url):
        port = open_port(f"{url}{'&' if '?' in url else '?'}physics=1")
        bench.world = port.line.world
        _place(bench.world, arm, posture)
        return port

    monkeypatch.setattr("servosim.open_port", opened)
    return bench


def _place(world, arm, posture):
    for joint, position in joints_in(arm, posture).items():
        world.place(joint, position)


def _built(name, *, mounted, weightless=False):
    """Return an arm in its pose home; where a mounted one's zeros are is known to nobody.

    A weightless one stays in the pose, as if hands held every joint.
    """
    entries = read_arm_file(load_model(name).path)
    if mounted and any(joint.zero_from == "nominal" for joint in load_model(name).joints):
        chance = random.Random(f"mounted {name}")
        joints = tuple(_mounted(joint, chance) for joint in entries.joints)
        entries = replace(entries, joints=joints)
    world = make_arm_world(entries, "home", physics=not weightless)
    if weightless:
        world = World(world.joints)
    port = SimulatedPort(Line(world, entries.baud, LineOptions()), f"desk:{name}")
    return HiddenArm(name, 0, world, port)


def _mounted(joint, chance):
    turned = chance.uniform(-25.0, 25.0)  # ticks: horns have teeth, and people hold them badly
    servos = tuple(replace(servo, zero_tick=servo.zero_tick + turned) for servo in joint.servos)
    return replace(joint, servos=servos)


def _reopened(hidden):
    def opened(port, baud_rate):
        if port.startswith("sim:"):  # another arm, such as a leader
            return open_transport(port, baud_rate)
        hidden.port.is_open = True
        return hidden.port

    return opened


@cache
def _calibrated(arm):
    """Return the folder of a person who has calibrated an arm; each journey begins with a copy."""
    folder = tempfile.mkdtemp()
    with pytest.MonkeyPatch.context() as patched:
        patched.setenv("IKSERVO_HOME", folder)
        _calibrate(_built(arm, mounted=True, weightless=True))
    return folder


def _calibrate(hidden):
    """Save a calibration of every joint's whole range, as if hands had been at each stop."""
    with hidden.loose() as loose:
        loose.serial_number = SERIAL
        wizard = _swept(
            hidden,
            CalibrationState.begin(loose.make_subjects("home"), MARGIN_RAD),
            loose.read_ticks()[1],
        )
        outcome = loose.build_calibration(wizard, "home", WHEN, write_limits=False)
        memory = {s.id: s.holds for joint in outcome.calibration.joints for s in joint.servos}
        loose.save(CalibrationResult(outcome.calibration, memory))


def _swept(hidden, wizard, ticks):
    """Return the conversation after each joint was moved as shown and then from stop to stop."""
    at_s = 0.0
    for _ in range(60):
        at_s += 0.02
        wizard = wizard.update(at_s, ticks)
    wizard = wizard.accept()
    for subject in wizard.subjects:
        ids = {subject.servo_id, *subject.shadow_ids}
        for way in _ways(hidden, subject):
            at_s += 0.02
            ticks = {i: (tick + way * (i in ids)) % 4096 for i, tick in ticks.items()}
            wizard = wizard.update(at_s, ticks)
    return wizard


def _ways(hidden, subject):
    """Yield steps in ticks: as shown and back, to the upper end, to the lower end, and back."""
    up = hidden.direction(subject.servo_id)
    above, below = _room(subject, subject.expected.upper), -_room(subject, subject.expected.lower)
    shown = up * subject.free_direction
    far = math.ceil(subject.min_motion_ticks / STEP) + 2
    yield from [STEP * shown] * far + [-STEP * shown] * far
    yield from [STEP * up] * above + [-STEP * up] * (above + below) + [STEP * up] * below


def _room(subject, limit):
    """Return how many steps a stop lies above the anchor pose; it is 2 degrees past the limit."""
    far = subject.joint_map.ticks_from_zero(limit.value) * subject.joint_map.sign
    here = subject.joint_map.ticks_from_zero(subject.pose) * subject.joint_map.sign
    room = math.copysign(min(abs(far - here) + STOP_TICKS, MOST_TICKS), far - here)
    return round(room / STEP)
