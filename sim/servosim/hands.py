"""Scripted hands on joints without torque.

Sweeping hands take each joint without torque through its travel, all at once. Hands that follow a
calibration move the arm into its start pose and hold it there, move each joint in turn slightly in
the direction with the larger range, twice, and then sweep all joints. They start over when the
torque of a joint is switched off, and when a host transmits after a silence: a calibrating program
then finds the arm at rest in its pose.

The hand of a set-up plugs in new servos, one after another, and at last all together; then it
follows a calibration. A box has new servos and no hand: a client of the remote control plugs the
servos in and moves the joints.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from servosim.errors import SimulatorError
from servosim.frames import Frame, FrameReader
from servosim.joint import Hand, Path, glide, hold, sweep
from servosim.line import Line
from servosim.servo import Servo
from servosim.world import World

HANDS = ("sweep", "calibrate", "setup", "box")
"""Names of the scripted hands."""

_HAND_LIMIT = 10.0  # largest force: N m, or N on a prismatic joint
POLL_PERIOD_S = 0.05  # time between two polls for joints without torque
SILENCE_S = 2.0  # silence of the host after which its next packet restarts the script
RETURN_S = 2.0  # time to move into the pose
HOLD_S = 6.0  # time to hold the pose
SHOW_S = 0.5  # time of a joint's motion in its direction, and of the motion back
SHOWN_S = 4 * SHOW_S  # twice, because an opposite sign must be confirmed
SWEEP_S = 24.0
ONE_WAY_S = 4.0  # time from one end of the travel to the other
SHOWN_RAD = math.radians(25.0)
SHOWN_FRACTION = 0.45  # largest fraction of the travel by which to show a direction
OPEN_TRAVEL_RAD = math.radians(300.0)  # travel of a joint without limits
PLUG_S = 1.5  # time to unplug one servo and plug in the next
SETTLED_S = 2.0  # time without a written value after which a servo is set up
USED_ID = 9  # id of a servo that was used before
MAX_OVERSHOOT = 0.02  # fraction of the travel that the hand pushes beyond the stops


class RangeSweep:
    """Sweeps joints whose torque is switched off and releases those whose torque is on.

    Args:
        world: The world.
    """

    def __init__(self, world: World) -> None:
        self._world = world
        self._poll_host()

    def _poll_host(self) -> None:
        world = self._world
        for joint in world.joints:
            if not joint.is_free and joint.name in world.hands:
                world.release(joint.name)
            elif joint.is_free and joint.name not in world.hands:
                path = _sweep_path(joint.position, *_joint_travel(world, joint.name))
                world.grasp(joint.name, Hand(path, limit=_HAND_LIMIT))
        world.schedule(world.time_s + POLL_PERIOD_S, self._poll_host)


class CalibrationHands:
    """Hands that hold the pose, show each joint's direction and sweep, on joints without torque.

    They may listen to the line, to detect when a host starts to transmit.
    """

    def __init__(self, world: World) -> None:
        self._world = world
        self._pose = {joint.name: joint.position for joint in world.joints}
        self._torque_off = {joint.name for joint in world.joints if joint.is_free}
        self._run = 0
        self._received_s = 0.0
        self._schedule_run()
        self._poll_host()

    def on_frame(self, at_s: float, frame: Frame, framing: type[FrameReader]) -> None:
        """Start over if the host has been silent for a while."""
        silence_s, self._received_s = at_s - self._received_s, at_s
        if silence_s > SILENCE_S:
            self._schedule_run()

    def on_reply(self, at_s: float, servo: Servo | None, data: bytes) -> None:
        """Ignore replies of the servos."""

    def _poll_host(self) -> None:
        world = self._world
        torque_off = {joint.name for joint in world.joints if joint.is_free}
        for name in world.hands.keys() - torque_off:
            world.release(name)
        if torque_off - self._torque_off:
            self._schedule_run()
        self._torque_off = torque_off
        world.schedule(world.time_s + POLL_PERIOD_S, self._poll_host)

    def _schedule_run(self) -> None:
        """Schedule one run of the script and, after it, the next; the present run ends."""
        self._run += 1
        names = list(self._pose)
        shown_s = RETURN_S + HOLD_S
        swept_s = shown_s + SHOWN_S * len(names)
        for name in names:
            self._grasp_joint(name, self._path_to_pose(name))
        for place, name in enumerate(names):
            self._schedule_grasp(shown_s + SHOWN_S * place, name, self._direction_path(name))
        for name in names:
            path = _sweep_path(self._pose[name], *_joint_travel(self._world, name))
            self._schedule_grasp(swept_s, name, path)
        run = self._run
        self._world.schedule(self._world.time_s + swept_s + SWEEP_S, lambda: self._restart_run(run))

    def _restart_run(self, run: int) -> None:
        if run == self._run:
            self._schedule_run()

    def _schedule_grasp(self, delay_s: float, name: str, path: Path) -> None:
        run = self._run

        def act() -> None:
            if run == self._run:
                self._grasp_joint(name, path)

        self._world.schedule(self._world.time_s + delay_s, act)

    def _grasp_joint(self, name: str, path: Path) -> None:
        if self._world.joint(name).is_free:
            self._world.grasp(name, Hand(path, limit=_HAND_LIMIT))

    def _path_to_pose(self, name: str) -> Path:
        here, pose = self._world.joint(name).position, self._pose[name]
        distance = abs(pose - here)
        return glide(here, pose, distance / RETURN_S) if distance else hold(pose)

    def _direction_path(self, name: str) -> Path:
        """Return a path in the direction with the larger range from the pose and back, twice."""
        pose, (lower, upper) = self._pose[name], _joint_travel(self._world, name)
        distance = SHOWN_FRACTION * (upper - lower)
        if not self._world.joint(name).is_prismatic:
            distance = min(distance, SHOWN_RAD)
        shown = pose + distance if upper - pose >= pose - lower else pose - distance
        speed = distance / SHOW_S
        out, back = glide(pose, shown, speed), glide(shown, pose, speed)

        def path(time_s: float) -> tuple[float, float]:
            part_s = time_s % (2 * SHOW_S) if time_s < SHOWN_S else 2 * SHOW_S
            return out(part_s) if part_s < SHOW_S else back(part_s - SHOW_S)

        return path


class NewServos:
    """Servos as they are delivered, and a hand that plugs them in, one after another.

    All have factory settings and are unplugged at first; the first one was used before and has
    another id. A servo is unplugged once it has the id and the rate that it had in the arm and no
    more values are written to it. After the last one, the hand plugs in all of them, and follows a
    calibration.

    Args:
        line: The line of the servos.
    """

    def __init__(self, line: Line) -> None:
        self._line, self._world, self._servos = line, line.world, list(line.world.servos)
        self._wanted = [(servo.id, servo.baud) for servo in self._servos]
        _deliver(self._servos)
        self._done, self._plug_s = 0, PLUG_S
        self._writes, self._changed_s = 0, math.inf
        self._poll_servo()

    def _poll_servo(self) -> None:
        now_s, servo = self._world.time_s, self._servos[self._done]
        writes = servo.memory.eeprom_writes
        if not servo.powered and now_s >= self._plug_s:
            servo.power_up()
            self._writes, self._changed_s = writes, math.inf
        elif servo.powered and writes != self._writes:
            self._writes, self._changed_s = writes, now_s
        elif (servo.id, servo.baud) == self._wanted[
            self._done
        ] and now_s - self._changed_s > SETTLED_S:
            self._done, self._plug_s = self._done + 1, now_s + PLUG_S
            if self._done < len(self._servos):
                servo.power_down()
        if self._done < len(self._servos):
            self._world.schedule(now_s + POLL_PERIOD_S, self._poll_servo)
        else:
            self._plug_in_all()

    def _plug_in_all(self) -> None:
        for servo in self._servos:
            servo.power_up()
        self._line.witnesses.append(CalibrationHands(self._world))


def fill_box(servos: Sequence[Servo]) -> None:
    """Put new servos into a box: unplugged, with factory settings except for three odd ones.

    The first servo has another id, the third one another rate, the last one an older firmware.
    """
    _deliver(servos)
    rate = servos[2 % len(servos)]
    code = rate.table.by_name["baud_rate"]
    rate.memory.put("baud_rate", code.default + 1)
    rate.memory.persist_value("baud_rate")
    odd = servos[-1]
    version = "firmware_minor" if "firmware_minor" in odd.table.by_name else "firmware_version"
    odd.memory.put(version, odd.table.by_name[version].default - 1)
    odd.memory.persist_value(version)


def _deliver(servos: Sequence[Servo]) -> None:
    """Unplug servos and give them factory settings; the first one was used and has another id."""
    for servo in servos:
        servo.factory_reset(())
        servo.power_down()
    servos[0].memory.put("id", USED_ID)
    servos[0].memory.persist_value("id")


def _sweep_path(position: float, lower: float, upper: float) -> Path:
    """Return a path to the nearer end first, so that 1.5 travels reach both ends."""
    more, ends = MAX_OVERSHOOT * (upper - lower), lower + upper
    start = max(lower, min(upper, position))
    speed = (upper - lower) / ONE_WAY_S
    if start - lower >= upper - start:
        return sweep(start, lower - more, upper + more, speed)
    return _reflect_path(sweep(ends - start, lower - more, upper + more, speed), ends)


def _joint_travel(world: World, name: str) -> tuple[float, float]:
    lower, upper = world.limits[name]
    if math.isfinite(upper - lower):
        return lower, upper
    return -OPEN_TRAVEL_RAD / 2, OPEN_TRAVEL_RAD / 2


def _reflect_path(path: Path, ends: float) -> Path:
    """Return the mirrored path; ``ends`` is the sum of its two ends."""

    def reflected(time_s: float) -> tuple[float, float]:
        position, velocity = path(time_s)
        return ends - position, -velocity

    return reflected


def add_hands(line: Line, kind: str) -> None:
    """Let hands move the joints without torque, or plug in new servos.

    Args:
        line: The line of their servos.
        kind: ``sweep``, ``calibrate`` for hands that follow a calibration, ``setup`` or ``box``.

    Raises:
        SimulatorError: The kind is none of these.
    """
    if kind not in HANDS:
        raise SimulatorError(f"hand={kind!r} is not one of {', '.join(HANDS)}")
    if kind == "calibrate":
        line.witnesses.append(CalibrationHands(line.world))
    elif kind == "setup":
        NewServos(line)
    elif kind == "box":
        fill_box(line.world.servos)
    else:
        RangeSweep(line.world)
