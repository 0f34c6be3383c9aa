"""Arms on every kind of port: `sim` in this process, and patched pseudo-terminals and adapters."""

import math
import os
import random
import shutil
import tempfile
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from functools import cache

import pytest

from ikservo.apps.calibrating.by_hand_procedure import CalibrationState
from ikservo.apps.calibrating.calibration_result import CalibrationResult
from ikservo.hardware.transport import open_transport
from ikservo.model import load_model
from servosim import SimulatedPort, open_port, read_arm_file
from servosim.assembly import make_arm_world
from servosim.line import Line, LineOptions
from servosim.world import World
from tests.calibration.mounted_arms import MountedArm
from tests.cli.fixtures_mounted_arm import PORT, SERIAL
from tests.cli.fixtures_ports import PortInfo, set_ports
from tests.journeys.postures import joints_in
from tests.journeys.torque_watch import TorqueWatch

PORT_KINDS = ("sim", "pty", "real, uncalibrated", "real, calibrated")
PTY = "/dev/pts/7"
WHEN = datetime(2026, 11, 2, 14, 3, 22, tzinfo=UTC)
MARGIN_RAD = math.radians(2.0)
STEP, STOP_TICKS, MAX_TICKS = 10, 23, 1900


@dataclass
class Bench:
    """An arm on a port.

    Attributes:
        arm: The name of the arm.
        kind: One of ``LINES``.
        port: The value for ``--port``.
        world: The simulated arm; for ``sim`` the one that was opened last, None before.
        watch: Records when torque came on.
    """

    arm: str
    kind: str
    port: str
    world: object = None
    watch: TorqueWatch = field(default_factory=TorqueWatch)

    @property
    def simulated(self):
        return self.kind in ("sim", "pty")

    def joints(self):
        """Return the true position of every joint."""
        return {joint.name: joint.position for joint in self.world.joints}

    def torque(self):
        """Return the joints with torque on."""
        return {j.name: any(s.drive.torque_on for s in j.servos) for j in self.world.joints}


def place_arm(monkeypatch, arm, posture, kind):
    """Place an arm with torque off in a posture, on a port of a kind; return it."""
    if kind == "sim":
        return _in_process(monkeypatch, arm, posture)
    bench = Bench(arm, kind, PTY if kind == "pty" else PORT)
    mounted_arm = _built(arm, mounted=kind.startswith("real"))
    bench.world = mounted_arm.world
    set_ports(monkeypatch, [PortInfo(PORT)] if kind.startswith("real") else [])
    monkeypatch.setattr(
        "ikservo.planning.calibrated_arm.is_pseudo_terminal", lambda name: name == PTY
    )
    monkeypatch.setattr("ikservo.hardware.port.open_transport", _reopened(mounted_arm))
    monkeypatch.setattr(
        "ikservo.apps.workbench.bus_benchmark.open_transport", _reopened(mounted_arm)
    )
    mounted_arm.port.name = bench.port
    if kind == "real, calibrated":
        shutil.copytree(_calibrated(arm), os.environ["IKSERVO_HOME"], dirs_exist_ok=True)
    _place(mounted_arm.world, arm, posture)
    bench.watch.add_world(mounted_arm.world)
    return bench


def _in_process(monkeypatch, arm, posture):
    bench = Bench(arm, "sim", "sim")

    def opened(url):
        port = open_port(f"{url}{'&' if '?' in url else '?'}physics=1")
        bench.world = port.line.world
        _place(bench.world, arm, posture)
        bench.watch.add_world(bench.world)
        return port

    monkeypatch.setattr("servosim.open_port", opened)
    return bench


def _place(world, arm, posture):
    for joint, position in joints_in(arm, posture).items():
        world.place(joint, position)


def _built(name, *, mounted, weightless=False):
    """Return an arm in its pose home; the zeros of a mounted one are unknown.

    A weightless arm keeps the pose, as if every joint were held by hand.
    """
    entries = read_arm_file(load_model(name).path)
    if mounted and any(joint.zero_from == "nominal" for joint in load_model(name).joints):
        chance = random.Random(f"mounted {name}")
        joints = tuple(_mounted(joint, chance) for joint in entries.joints)
        entries = replace(entries, joints=joints)
    world = make_arm_world(entries, "home", physics=not weightless)
    if weightless:
        world = World(world.joints)
    port = SimulatedPort(Line(world, entries.baud, LineOptions()), f"bench:{name}")
    return MountedArm(name, 0, world, port)


def _mounted(joint, chance):
    turned = chance.uniform(-25.0, 25.0)  # ticks: the horn's teeth and a rough anchor pose
    servos = tuple(replace(servo, zero_tick=servo.zero_tick + turned) for servo in joint.servos)
    return replace(joint, servos=servos)


def _reopened(mounted_arm):
    def opened(port, baud_rate):
        if port.startswith("sim:"):  # another arm, such as a leader
            return open_transport(port, baud_rate)
        mounted_arm.port.is_open = True
        return mounted_arm.port

    return opened


@cache
def _calibrated(arm):
    """Return a user folder with a calibration of an arm; each journey starts with a copy."""
    folder = tempfile.mkdtemp()
    with pytest.MonkeyPatch.context() as patched:
        patched.setenv("IKSERVO_HOME", folder)
        _calibrate(_built(arm, mounted=True, weightless=True))
    return folder


def _calibrate(mounted_arm):
    """Save a calibration of every joint's whole range, as if swept by hand to each end stop."""
    with mounted_arm.open_limp() as limp_arm:
        limp_arm.serial_number = SERIAL
        state = _swept(
            mounted_arm,
            CalibrationState(limp_arm.make_subjects("home"), MARGIN_RAD),
            limp_arm.read_ticks()[1],
        )
        outcome = limp_arm.build_calibration(state, "home", WHEN, write_limits=False)
        memory = {s.id: s.holds for joint in outcome.calibration.joints for s in joint.servos}
        limp_arm.save(CalibrationResult(outcome.calibration, memory))


def _swept(mounted_arm, state, ticks):
    """Return the calibration after each joint was moved as shown and then from stop to stop."""
    at_s = 0.0
    for _ in range(60):
        at_s += 0.02
        state = state.update(at_s, ticks)
    state = state.accept()
    for subject in state.subjects:
        ids = {subject.servo_id, *subject.shadow_ids}
        for step in _steps(mounted_arm, subject):
            at_s += 0.02
            ticks = {i: (tick + step * (i in ids)) % 4096 for i, tick in ticks.items()}
            state = state.update(at_s, ticks)
    return state


def _steps(mounted_arm, subject):
    """Yield steps in ticks: as shown and back, to the upper end, to the lower end, and back."""
    up = mounted_arm.direction(subject.servo_id)
    above, below = (
        _steps_to_stop(subject, subject.expected.upper),
        -_steps_to_stop(subject, subject.expected.lower),
    )
    shown = up * subject.free_direction
    far = math.ceil(subject.min_motion_ticks / STEP) + 2
    yield from [STEP * shown] * far + [-STEP * shown] * far
    yield from [STEP * up] * above + [-STEP * up] * (above + below) + [STEP * up] * below


def _steps_to_stop(subject, limit):
    """Return the steps from the anchor pose up to an end stop, 2 degrees past the limit."""
    far = subject.joint_map.ticks_from_zero(limit.value) * subject.joint_map.sign
    here = subject.joint_map.ticks_from_zero(subject.pose) * subject.joint_map.sign
    ticks = math.copysign(min(abs(far - here) + STOP_TICKS, MAX_TICKS), far - here)
    return round(ticks / STEP)
