"""Before an arm looks for its own stops: its counts are set up, and a narrow fence around it.

The limits are not known yet; the zeros are, for the arm was held in a named pose. So the guard is
given the arm file's ranges and a little more, the arm's slowest speed, and nothing else passes.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Generator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from datetime import UTC, datetime

from ikservo.arm.arm import Arm
from ikservo.arm.calibrating.by_hand import LooseArm
from ikservo.arm.own import OwnArm
from ikservo.arm.streaming.servos import Servos
from ikservo.arm.trust import Zeros
from ikservo.calibration import Limits
from ikservo.calibration.in_servos.memory import ServoFacts, facts_of
from ikservo.calibration.in_servos.transaction import changes_for, commit
from ikservo.calibration.sweeping.outcome import Memory, Outcome
from ikservo.calibration.sweeping.subject import Subject
from ikservo.calibration.sweeping.sweep import Wizard
from ikservo.errors import BusError
from ikservo.guard import Fence, Space
from ikservo.model import ModelJoint
from ikservo.registers import Role

__all__ = ["BEYOND_RAD", "counts_set_back", "drivable", "fenced_arm", "set_up_counts"]

BEYOND_RAD = math.radians(20.0)
"""How far past its expected end a joint may look for its stop, the horn's angle."""

_ROOMY = 300 / 360  # of a turn: such a joint has no stops, or none that is worth looking for
_SPEED_SLACK = 1.2


def drivable(subject: Subject, wizard: Wizard) -> bool:
    """Return whether a joint has stops to be looked for."""
    roomy = subject.turn > 0 and subject.expected_ticks >= _ROOMY * subject.turn
    left_out = subject.name in wizard.free | wizard.skipped
    return not (roomy or left_out or subject.known)


def set_up_counts(loose: LooseArm, wizard: Wizard, pose: str) -> Outcome:
    """Let every servo count so that no seam lies where its stop is looked for; torque is off.

    The calibration file is left as it is; see ``counts_set_back``.

    Returns:
        The arm as it is known from its pose alone.

    Raises:
        CalibrationError: A joint would cross a seam that cannot be moved.
        IkservoError: A servo cannot be written; nothing is changed, or it says how to go on.
    """
    subjects = tuple(_widened(subject, wizard) for subject in wizard.subjects)
    names = frozenset(subject.name for subject in subjects)
    wide = replace(wizard, subjects=subjects, skipped=names, free=frozenset())
    found = loose.conclude(wide, pose, datetime.now(UTC))
    memory = {i: _opened(loose.facts[i], dict(held)) for i, held in found.memory.items()}
    _write(loose, memory)
    return found


@contextmanager
def counts_set_back(loose: LooseArm, tell: Callable[[str], None]) -> Generator[None]:
    """Give limp servos back what they held, where the block ends without a calibration.

    An arm that holds is not dropped for that: then it is told how to get them back.

    Args:
        loose: The servos, as they were found.
        tell: Takes what was done or is to do, in words.
    """
    memory = {i: facts.held for i, facts in loose.facts.items()}
    try:
        yield
    except BaseException:
        with contextlib.suppress(BusError):  # who is silent has been named already
            _set_back(loose, memory, tell)
        raise


def _set_back(loose: LooseArm, memory: Memory, tell: Callable[[str], None]) -> None:
    if loose.journal_path.exists() or not changes_for(loose.bus, memory):
        return
    if not loose.holding():
        _write(loose, memory)
        tell("The settings of the servos were restored.")
        return
    again = f"ikservo calibrate {loose.model.name}"
    old = f"; or restore the previous calibration: ikservo calibration push {loose.model.name}"
    filed = old if loose.path.exists() else ""
    tell(f"The servos keep the settings of the search. Calibrate again: {again}{filed}.")


def _write(loose: LooseArm, memory: Memory) -> None:
    changes = changes_for(loose.bus, memory)
    if changes:
        text = loose.path.read_text("utf-8") if loose.path.exists() else ""
        commit(loose.bus, loose.journal_path, loose.path, text, changes)
        loose.facts = {servo_id: facts_of(loose.bus, servo_id) for servo_id in loose.bus.servos}


def fenced_arm(loose: LooseArm, wizard: Wizard, known: Outcome, space: Space) -> Arm:
    """Return the arm behind the narrow fence; no torque changes."""
    model, bus = loose.model, loose.bus
    own = OwnArm(bus, model, Zeros.CALIBRATED, known.calibration)
    subjects = {subject.name: subject for subject in wizard.subjects}
    fences = [_fence(own, joint, subjects[joint.name], wizard, loose) for joint in model.joints]
    shadows = {joint.name: [servo.id for servo in joint.shadows] for joint in model.joints}
    servos = Servos(bus, fences, shadows, bus.clock, model.health)
    return Arm(model, model.chain, servos, bus.port, "hold", space, Zeros.CALIBRATED)


def _fence(
    own: OwnArm, joint: ModelJoint, subject: Subject, wizard: Wizard, loose: LooseArm
) -> Fence:
    limits = _widened(subject, wizard).expected
    speed = loose.model.speed("slow").rad_s * joint.travel_per_turn / math.tau
    return Fence(own.joint_map(joint), limits, speed * _SPEED_SLACK)


def _widened(subject: Subject, wizard: Wizard) -> Subject:
    """Return a joint with the range in which its stops are looked for."""
    if not drivable(subject, wizard):
        return subject
    beyond = BEYOND_RAD / subject.joint_map.horn_rad_per_tick  # ticks
    room = (subject.turn - 64 - subject.expected_ticks) / 2 if subject.turn else beyond
    more = min(beyond, room) * subject.joint_map.unit_per_tick
    low, high = subject.expected.lower.value - more, subject.expected.upper.value + more
    unit = subject.expected.unit
    return replace(subject, expected=Limits.of(subject.name, low, high, "the search", unit))


def _opened(facts: ServoFacts, held: Mapping[str, int]) -> dict[str, int]:
    """Return what a servo shall hold, its own limits opened: they may lie inside the stops."""
    low, high = facts.table.find(Role.MIN_POSITION_LIMIT), facts.table.find(Role.MAX_POSITION_LIMIT)
    return {**held, low.name: low.range[0], high.name: high.range[1]}
