"""Self-calibration: from a named pose an arm drives every joint gently against its own stops."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from ikservo.arm.calibrating.auto_ends import (
    End,
    ends_of,
    false_stop,
    is_the_stop,
    nearly_a_turn,
    no_stop,
    per_horn,
    unreached,
)
from ikservo.arm.calibrating.auto_feeling import Felt, feel
from ikservo.arm.calibrating.auto_postures import Postures
from ikservo.arm.calibrating.auto_setup import drivable, fenced_arm, set_up_counts
from ikservo.arm.calibrating.by_hand import LooseArm
from ikservo.calibration import Limit, Limits
from ikservo.calibration.sweeping.feeler import Touch
from ikservo.calibration.sweeping.homing import Travel
from ikservo.calibration.sweeping.measured import measure
from ikservo.calibration.sweeping.subject import Subject
from ikservo.calibration.sweeping.sweep import Wizard
from ikservo.errors import CalibrationError, RefusedError
from ikservo.kinematics.se3 import Vector
from ikservo.model import Model

__all__ = ["SelfCalibration", "check_safe"]

_SHARES = (0.3, 0.45, 0.6)  # of a servo's torque, one after the other


def check_safe(model: Model) -> None:
    """Refuse arms that must not look for their stops by themselves.

    Raises:
        CalibrationError: The arm file says so, and why.
    """
    if model.auto_unsafe:
        raise CalibrationError(
            f"{model.title} cannot search its end stops by itself: {model.auto_unsafe}",
            f"Calibrate it by hand: ikservo calibrate {model.name}",
        )


class SelfCalibration:
    """An arm that has been put into a named pose, and now finds its ranges itself.

    Args:
        loose: Its servos, torque off.
        wizard: The conversation, the anchor taken.
        pose: The named pose.
        tell: Takes what happens, in words.
        keep: Takes the travel of each joint whose two stops were found, in bare ticks.

    Attributes:
        wizard: The conversation with all that was found so far.
        arm: The arm behind its narrow fence.
        felt: The limit that is known of joints of which only one end could be looked for.
    """

    def __init__(
        self,
        loose: LooseArm,
        wizard: Wizard,
        pose: str,
        tell: Callable[[str], None],
        keep: Callable[[Subject, Travel], None],
    ) -> None:
        check_safe(loose.model)
        self._loose, self._tell, self._keep = loose, tell, keep
        self._postures = Postures(loose.model)
        known = set_up_counts(loose, wizard, pose)
        self.arm = fenced_arm(loose, wizard, known, self._postures.space)
        self.arm.enable()
        tell("Torque is on. Let go of the arm and keep clear of it.")
        names = frozenset(subject.name for subject in wizard.subjects)
        self.wizard = replace(wizard, trusted=names, driven=True)
        self.felt: dict[str, Limits] = {}

    def sweep(self) -> None:
        """Look for the stops of every joint that has some and was not measured before, tip first.

        Raises:
            CalibrationError: A joint met something where its stop cannot be, or no stop at all.
            StoppedError: The person interrupted; the arm holds.
            RefusedError: The guard stopped it; the arm holds.
        """
        for subject in reversed(self.wizard.subjects):
            if drivable(subject, self.wizard):
                self._sweep_joint(subject)
            elif subject.known is not None:
                self._learn(subject)
            elif subject.name not in self.wizard.free | self.wizard.skipped:
                self.wizard = self.wizard.skip(subject.name, nearly_a_turn(subject))

    def finish(self) -> Wizard:
        """Lower the arm to its rest pose, let it go, and return the conversation at its review.

        Raises:
            CalibrationError: The servos of one joint did not go alike.
        """
        way = self._postures.way(self._in_chain(), self.arm.model.chain_pose("rest"))
        for posture in way or []:
            self._go(posture)
        self.arm.pose("rest", speed="slow")
        self._watch(self.arm.workings.servos.measure())
        self.arm.release()
        reading = self._loose.read()
        self.wizard = self.wizard.read(*reading) if reading else self.wizard
        return self.wizard.accept()

    def _sweep_joint(self, subject: Subject) -> None:
        lower, upper = (self._look_for(end, subject) for end in ends_of(subject))
        if isinstance(lower, float) and isinstance(upper, float):
            track = self.wizard.tracks[subject.servo_id]
            self._keep(subject, Travel(track.low, track.high))
            self._learn(subject)
            return
        reason = unreached(subject, lower, upper)
        self._tell(f"{subject.name}: {reason}")
        self.wizard = self.wizard.skip(subject.name, reason)
        self._note_felt(subject, lower, upper)

    def _learn(self, subject: Subject) -> None:
        """Let other joints be looked for with this one near the ends it is known to have."""
        names = self.arm.model.chain.names
        ends = measure(self.wizard, subject).ends(0.0)
        if ends is not None and subject.name in names:
            self._postures.learn(names.index(subject.name), *ends)

    def _note_felt(self, subject: Subject, lower: float | str, upper: float | str) -> None:
        expected, margin = subject.expected, self.wizard.margin_rad * per_horn(subject)
        low = expected.lower if isinstance(lower, str) else Limit(lower + margin, "felt")
        high = expected.upper if isinstance(upper, str) else Limit(upper - margin, "felt")
        self.felt[subject.name] = Limits(subject.name, low, high, expected.unit)

    def _look_for(self, end: End, subject: Subject) -> float | str:
        """Return where a joint's stop is, rad or m, or why it cannot be looked for."""
        try:
            way = self._room(end)
        except RefusedError as error:
            return error.message
        for posture in way:
            self._go(posture)
        self._tell(
            f"{end.joint}: searching its end stop near {subject.joint_map.say(end.expected)}."
        )
        felt = self._press(end, subject, _SHARES[0])
        for share in _SHARES[1:]:
            if is_the_stop(felt, end, subject):
                break
            felt = self._press(end, subject, share)
        if not is_the_stop(felt, end, subject):
            raise false_stop(felt, end, subject)
        return felt.position

    def _press(self, end: End, subject: Subject, share: float) -> Felt:
        """Drive a joint to its end with a share of its torque.

        Raises:
            CalibrationError: It got there, past where its stop is expected.
        """
        felt = feel(self.arm.workings, self._loose.bus, end.joint, end.past, share, self._watch)
        if felt.touch is Touch.MOVING:
            raise no_stop(felt, end, subject)
        return felt

    def _room(self, end: End) -> list[Vector]:
        """Return the way to a posture in which the joint can go to its end.

        Raises:
            RefusedError: There is none; nothing has moved.
        """
        if end.joint not in self.arm.model.chain.names:
            return []
        column = self.arm.model.chain.names.index(end.joint)
        reach = end.expected + 0.25 * (end.past - end.expected)
        return self._postures.towards(column, end.start, reach, self._in_chain())

    def _go(self, posture: Vector) -> None:
        positions = dict(zip(self.arm.model.chain.names, posture.tolist(), strict=True))
        self.arm.move_joints(positions, speed="slow")

    def _in_chain(self) -> Vector:
        workings = self.arm.workings
        return workings.in_chain(workings.servos.goals())

    def _watch(self, joints: Vector) -> None:
        """Let the conversation see where the servos are; shadows go with their first servo."""
        ticks: dict[int, int] = {}
        for subject in self.wizard.subjects:
            anchor = self.wizard.anchor[subject.servo_id]
            position = float(joints[self.arm.workings.planner.column(subject.name)])
            placed = subject.placed(self.wizard.sign(subject), anchor)
            tick = round(placed.exact_tick(position))
            ticks[subject.servo_id] = tick
            for shadow in subject.shadow_ids:
                ticks[shadow] = round(self.wizard.anchor[shadow] + tick - anchor)
        self.wizard = self.wizard.counted(self._loose.bus.clock.now_s(), ticks)
