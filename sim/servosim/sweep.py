"""A scripted person who has an arm calibrated by hand, again and again.

The hands bring the limp arm into the pose in which it started and hold it there, move each joint
in turn a little towards where it has more room, twice, and then sweep all joints.
They start over when a joint becomes limp, and when a host speaks after a silence: a program that
calibrates finds the arm held still in its pose.
"""

from __future__ import annotations

import math

from servosim.frames import Frame, FrameReader
from servosim.hand import Hand, Path, glide, hold, sweep
from servosim.servo import Servo
from servosim.world import World

__all__ = ["SweepingHands"]

LOOK_S = 0.05  # between two looks at which joints are limp
SILENCE_S = 2.0  # of the host, after which the script starts over with its next packet
RETURN_S = 2.0  # into the pose
HOLD_S = 6.0  # in the pose
SHOW_S = 0.5  # of a joint's motion in its shown direction, and of the one back
SHOWN_S = 4 * SHOW_S  # twice, as a sign that differs from the arm file is asked for again
SWEEP_S = 24.0
ONE_WAY_S = 4.0  # from one end of the travel to the other
SHOWN_RAD = math.radians(25.0)
SHOWN_SHARE = 0.45  # of the travel, at most
OPEN_TRAVEL_RAD = math.radians(300.0)  # of a joint without limits
OVERREACH = 0.02  # share of the travel by which the hand presses on into the stops


class SweepingHands:
    """Grasps joints whose torque goes off and lets go of those whose torque comes on.

    It may be a witness of the line, to hear when a host starts to speak.
    """

    def __init__(self, world: World) -> None:
        self._world = world
        self._pose = {joint.name: joint.position for joint in world.joints}
        self._limp = {joint.name for joint in world.joints if joint.free}
        self._run = 0
        self._heard_s = 0.0
        self._begin()
        self._look()

    def heard(self, at_s: float, frame: Frame, framing: type[FrameReader]) -> None:
        """Start over if the host has been silent for a while."""
        silence_s, self._heard_s = at_s - self._heard_s, at_s
        if silence_s > SILENCE_S:
            self._begin()

    def said(self, at_s: float, servo: Servo | None, data: bytes) -> None:
        """Pay no attention to what the servos answer."""

    def _look(self) -> None:
        world = self._world
        limp = {joint.name for joint in world.joints if joint.free}
        for name in world.hands.keys() - limp:
            world.release(name)
        if limp - self._limp:
            self._begin()
        self._limp = limp
        world.at(world.time_s + LOOK_S, self._look)

    def _begin(self) -> None:
        """Schedule one run of the script and, behind it, the next; a run under way ends."""
        self._run += 1
        names = list(self._pose)
        shown_s = RETURN_S + HOLD_S
        swept_s = shown_s + SHOWN_S * len(names)
        for name in names:
            self._grasp(name, self._to_pose(name))
        for place, name in enumerate(names):
            self._later(shown_s + SHOWN_S * place, name, self._direction_shown(name))
        for name in names:
            self._later(swept_s, name, self._swept(name))
        run = self._run
        self._world.at(self._world.time_s + swept_s + SWEEP_S, lambda: self._again(run))

    def _again(self, run: int) -> None:
        if run == self._run:
            self._begin()

    def _later(self, delay_s: float, name: str, path: Path) -> None:
        run = self._run

        def act() -> None:
            if run == self._run:
                self._grasp(name, path)

        self._world.at(self._world.time_s + delay_s, act)

    def _grasp(self, name: str, path: Path) -> None:
        if self._world.joint(name).free:
            self._world.grasp(name, Hand(path, limit=10.0))

    def _to_pose(self, name: str) -> Path:
        here, pose = self._world.joint(name).position, self._pose[name]
        way = abs(pose - here)
        return glide(here, pose, way / RETURN_S) if way else hold(pose)

    def _direction_shown(self, name: str) -> Path:
        """Move towards where there is more room from the pose and back, twice."""
        pose, (lower, upper) = self._pose[name], self._travel(name)
        way = SHOWN_SHARE * (upper - lower)
        if not self._world.joint(name).slides:
            way = min(way, SHOWN_RAD)
        shown = pose + way if upper - pose >= pose - lower else pose - way
        out, back = glide(pose, shown, way / SHOW_S), glide(shown, pose, way / SHOW_S)

        def path(time_s: float) -> tuple[float, float]:
            part_s = time_s % (2 * SHOW_S) if time_s < SHOWN_S else 2 * SHOW_S
            return out(part_s) if part_s < SHOW_S else back(part_s - SHOW_S)

        return path

    def _swept(self, name: str) -> Path:
        """Press on the nearer end first: both are reached after one and a half ways."""
        lower, upper = self._travel(name)
        more, ends = OVERREACH * (upper - lower), lower + upper
        start = max(lower, min(upper, self._pose[name]))
        speed = (upper - lower) / ONE_WAY_S
        if start - lower >= upper - start:
            return sweep(start, lower - more, upper + more, speed)
        return _reflected(sweep(ends - start, lower - more, upper + more, speed), ends)

    def _travel(self, name: str) -> tuple[float, float]:
        lower, upper = self._world.limits[name]
        if math.isfinite(upper - lower):
            return lower, upper
        return -OPEN_TRAVEL_RAD / 2, OPEN_TRAVEL_RAD / 2


def _reflected(path: Path, ends: float) -> Path:
    """Return a path with its two ends, whose sum is given, exchanged."""

    def reflected(time_s: float) -> tuple[float, float]:
        position, velocity = path(time_s)
        return ends - position, -velocity

    return reflected
