"""Recording: where the joints are, at a fixed rate, while a hand or another program moves them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from ikservo.arm.given import number
from ikservo.arm.tapes.tape import Heading, Recorder
from ikservo.clock import Clock
from ikservo.errors import BadValueError
from ikservo.kinematics.se3 import Vector
from ikservo.model import Model
from ikservo.motion import Metronome

__all__ = ["RecordReport", "heading_of", "record"]


@dataclass(frozen=True, slots=True)
class RecordReport:
    """What was recorded.

    Attributes:
        path: The file.
        samples: How many lines behind the header.
        duration_s: From the first to the last.
    """

    path: Path
    samples: int
    duration_s: float


def heading_of(model: Model, period_s: float) -> Heading:
    """Return the header of a recording of an arm.

    Raises:
        BadValueError: The period is no time between two samples.
    """
    period_s = number("The period", period_s)
    if not 0.002 <= period_s <= 10.0:
        raise BadValueError("The period", f"{period_s:g} s", "0.002 to 10 s")
    names = tuple(joint.name for joint in model.joints)
    units = tuple(joint.joint_map.unit for joint in model.joints)
    return Heading(model.name, names, units, period_s)


def record(
    measure: Callable[[], Vector],
    clock: Clock,
    path: Path | str,
    heading: Heading,
    duration_s: float | None,
    until: Callable[[], bool] | None,
    *,
    overwrite: bool = False,
) -> RecordReport:
    """Write what ``measure`` returns, joints (n,), to a file; see ``Arm.record``."""
    if duration_s is None and until is None:
        raise BadValueError("The recording", "without an end", "duration_s, or until")
    most_s = math.inf if duration_s is None else number("The duration", duration_s)
    if not most_s > 0.0:
        raise BadValueError("The duration", f"{most_s:g} s", "seconds above 0")
    last_s = 0.0
    with Recorder(path, heading, overwrite=overwrite) as recorder:
        try:
            for elapsed_s in Metronome(clock, heading.period_s):
                recorder.see(elapsed_s, measure())
                last_s = elapsed_s
                if elapsed_s + heading.period_s > most_s or (until and until()):
                    break
        except KeyboardInterrupt:  # how a person ends it; every line that is written is whole
            pass
    return RecordReport(recorder.path, recorder.samples, last_s)
