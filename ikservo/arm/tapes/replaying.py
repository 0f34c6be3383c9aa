"""Playing a recording back through the guard: to its first pose, then along it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ikservo.arm.arriving.settling import settle
from ikservo.arm.reports import Progress
from ikservo.arm.skills.workings import Workings
from ikservo.arm.streaming.beat import Beat
from ikservo.arm.tapes.playback import Playback
from ikservo.arm.tapes.recording import heading_of
from ikservo.arm.tapes.tape import Heading, Recording
from ikservo.arm.tapes.tape_reading import read_recording
from ikservo.errors import FileFormatError, RefusedError
from ikservo.kinematics.se3 import Vector
from ikservo.motion import JointMove

__all__ = ["ReplayReport", "playback_of", "replay"]

# A hand presses joints a little past where their limits were set.
_BEYOND_RAD = math.radians(3.0)


@dataclass(frozen=True, slots=True, eq=False)
class ReplayReport:
    """How a recording was played back.

    Attributes:
        samples: How many it has.
        duration_s: How long playing it took.
        slower: How many times slower than recorded, because it was faster than the arm may go.
        error_rad: The furthest that a joint is from the last sample, rad or m.
        measured_rad: Where the joints are in the end, rad or m by name.
        measured_tip_m: Where that puts the tip (3,), metres.
    """

    samples: int
    duration_s: float
    slower: float
    error_rad: float
    measured_rad: dict[str, float]
    measured_tip_m: Vector


def playback_of(arm: Workings, path: Path | str, speed: str) -> tuple[Recording, Playback]:
    """Read a recording of this arm and make a motion of it; nothing moves.

    Raises:
        FileFormatError: It is spoiled, or of another arm.
        RefusedError: It leaves the joints' limits, or the body would touch something.
    """
    recording = read_recording(path)
    _check_of(arm, recording.heading, Path(path))
    _check_limits(arm, recording, Path(path))
    lower, upper = arm.limits()
    paces = arm.planner.paces(speed)
    playback = Playback(recording.times_s, recording.joints, paces, lower, upper)
    arm.check_recorded(playback.way())
    return recording, playback


def replay(
    arm: Workings,
    path: Path | str,
    speed: str,
    on_progress: Callable[[Progress], None] | None,
) -> ReplayReport:
    """Play a recording back from its first pose; see ``Arm.replay``."""
    recording, playback = playback_of(arm, path, speed)
    at_first = arm.allowed(speed)
    paces = arm.planner.paces(at_first)
    started_s = arm.now_s()

    def approach(here: Vector) -> JointMove:
        arm.check_recorded(arm.straight(here, playback.start))
        return JointMove(here, playback.start, paces)

    def on_beat(beat: Beat) -> None:
        if on_progress:
            on_progress(arm.progress(beat))

    arm.drive(approach, on_beat, at_first)
    arm.drive(lambda _: playback, on_beat, speed)
    goal = playback.state(playback.duration_s).position
    measured = settle(arm, goal, speed)
    return ReplayReport(
        samples=len(recording.times_s),
        duration_s=arm.now_s() - started_s,
        slower=playback.slower,
        error_rad=float(np.abs(measured - goal).max()),
        measured_rad=dict(zip(arm.servos.names, measured.tolist(), strict=True)),
        measured_tip_m=arm.planner.tip(measured),
    )


def _check_of(arm: Workings, heading: Heading, path: Path) -> None:
    own = heading_of(arm.model, heading.period_s)
    for what, found, wanted in (
        ("arm", heading.arm, own.arm),
        ("joints", ", ".join(heading.joints), ", ".join(own.joints)),
        ("units", ", ".join(heading.units), ", ".join(own.units)),
    ):
        if found != wanted:
            raise FileFormatError(path, "line 1", f"is of {what} {found}", f"{what} {wanted}")


def _check_limits(arm: Workings, recording: Recording, path: Path) -> None:
    """Refuse a recording that leaves the limits by more than a hand presses joints past them."""
    for column, fence in enumerate(arm.servos.fences):
        slack = _BEYOND_RAD * fence.joint_map.unit_per_tick / fence.joint_map.horn_rad_per_tick
        low, high = fence.positions
        values = recording.joints[:, column]
        beyond = np.flatnonzero((values < low - slack) | (values > high + slack))
        if len(beyond):
            first = int(beyond[0])
            words = fence.beyond(fence.joint_map.tick(float(values[first])))
            raise RefusedError(
                f"{path}, line {first + 2}: {words}",
                "Nothing moved. Remove the samples that cannot be replayed.",
            )
