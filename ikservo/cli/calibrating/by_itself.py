"""``ikservo calibrate --auto``: from a named pose the arm finds its ranges by itself."""

from __future__ import annotations

from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

from ikservo.arm import Arm
from ikservo.arm.calibrating.auto import SelfCalibration, check_safe
from ikservo.arm.calibrating.auto_kept import KeptTravels, with_known
from ikservo.arm.calibrating.auto_setup import counts_set_back
from ikservo.arm.calibrating.by_hand import LooseArm, loose_arm
from ikservo.arm.calibrating.confirmation import confirm
from ikservo.arm.calibrating.wiggling import Wiggle, expected, lift, making_room, room_m, wiggle
from ikservo.calibration.sweeping.sweep import Stage, Wizard
from ikservo.cli.calibrating.hands import Wishes, check_wishes, reviewed, show, with_wishes
from ikservo.cli.calibrating.meeting import consent, greet, let_go
from ikservo.cli.calibrating.screen import screen
from ikservo.cli.calibrating.talk import answers, converse
from ikservo.cli.output import note
from ikservo.cli.stopping import stoppable
from ikservo.errors import CalibrationError, IkservoError, InputError, RefusedError
from ikservo.model import Model

__all__ = ["by_itself"]

_WARNING = (
    "The arm will drive every joint to its stops, slowly and with little force, and end in its "
    "rest pose. Clear its whole reach. Ctrl-C stops it; it then holds."
)


def by_itself(model: Model, port: str | None, wishes: Wishes, script: Path | None) -> None:
    """Take the pose, let the arm find its ranges, and save what was found.

    Raises:
        CalibrationError: The arm file forbids it, or a joint met what cannot be its stop.
        InputError: Nobody agreed.
        StoppedError: The person interrupted; the arm holds.
    """
    check_safe(model)
    check_wishes(model, wishes, script)
    _agree(wishes)
    with loose_arm(model, port) as loose:
        let_go(loose, asks=wishes.asks, yes=wishes.yes)
        greet(loose, wishes.pose)
        kept = _offered(loose, wishes)
        wizard = with_known(_anchored(loose, wishes, script), kept.travels)
        with counts_set_back(loose, note), _keeping(kept):
            auto = SelfCalibration(loose, wizard, wishes.pose, _tell, kept.keep)
            wizard = _driven(auto, wishes)
            outcome = reviewed(loose, wizard, wishes.with_user(auto.felt))
            path = loose.save(outcome)
        kept.forget()
        if wishes.asks:
            confirm(model, loose.bus.port.name)  # each direction has just been agreed to
    show(outcome, wizard, path, json=wishes.json)


def _tell(words: str) -> None:
    note(words)


def _offered(loose: LooseArm, wishes: Wishes) -> KeptTravels:
    """Return the joints that an interrupted run has measured, if the person wants to use them."""
    kept = KeptTravels(loose)
    if not kept.travels:
        return kept
    names = ", ".join(kept.travels)
    note(f"An interrupted run of {kept.written} measured {names}.")
    if consent("Use these, and measure only the other joints?", default=True, asks=wishes.asks):
        note(f"They are not measured again; to measure all joints, remove {kept.path}.")
    else:
        kept.forget()
    return kept


@contextmanager
def _keeping(kept: KeptTravels) -> Generator[None]:
    """Say, where the run does not end well, which joints need not be measured again."""
    try:
        yield
    except BaseException:
        if kept.travels:
            note(
                f"Measured and kept for the next run: {', '.join(kept.travels)}. "
                "Put the arm into its pose and give the same command to go on with the others."
            )
        raise


def _agree(wishes: Wishes) -> None:
    note(_WARNING)
    if wishes.yes:
        return
    if not wishes.asks:
        raise InputError("Cannot ask: input is not a terminal.", "Give --yes.")
    if not consent("May it begin?", default=False, asks=True):
        raise IkservoError("Nothing moved.")


def _anchored(loose: LooseArm, wishes: Wishes, script: Path | None) -> Wizard:
    """Return the conversation once the arm has been held in its pose."""
    wizard = Wizard.begin(loose.subjects(wishes.pose), wishes.margin_rad)
    with (
        answers(script, yes=wishes.yes, ask=wishes.asks) as who,
        screen(loose.model, wishes.pose) as shown,
    ):
        begun = with_wishes(wizard, wishes.free, wishes.skip)
        return converse(loose, begun, who, shown, (Stage.ANCHOR,))


def _driven(auto: SelfCalibration, wishes: Wishes) -> Wizard:
    """Let the arm find its ranges; a second Ctrl-C lowers it and lets go."""
    with stoppable(auto.arm):
        _show_directions(auto, wishes)
        auto.sweep()
        return auto.finish()


def _show_directions(auto: SelfCalibration, wishes: Wishes) -> None:
    """Move each joint a little, so that a mirrored sign or exchanged ids show before anything."""
    for joint in auto.arm.model.joints:
        _make_room(auto.arm, joint.name, wishes)
        motion = expected(auto.arm, joint.name)
        note(f"{motion.joint} moves {motion.words}, then back.")
        wiggle(auto.arm, motion)
        _check_seen(auto.arm, motion, wishes)


def _make_room(arm: Arm, joint: str, wishes: Wishes) -> None:
    """Move other joints of a folded arm until one joint can go a little way and back.

    Raises:
        RefusedError: No motion of a single joint makes more room.
    """
    for _ in arm.model.joints:
        motion = making_room(arm, joint)
        if motion is None:
            break
        note(f"{motion.joint} moves {motion.words}, and stays there: {joint} needs room.")
        lift(arm, motion)
        _check_seen(arm, motion, wishes)
    if room_m(arm, joint) < 0.0:
        raise RefusedError(
            f"{joint} cannot move by 5° without a collision; torque stays on.",
            "Nothing was saved. Begin in a pose with more room: "
            f"ikservo calibrate {arm.model.name} --auto --pose home",
        )


def _check_seen(arm: Arm, motion: Wiggle, wishes: Wishes) -> None:
    question = f"Did {motion.joint} move {motion.words}?"
    if not consent(question, default=True, asks=wishes.asks):
        raise CalibrationError(
            f"{motion.joint} does not move as in the arm file; torque stays on.",
            f"Calibrate it by hand, which finds signs: ikservo calibrate {arm.model.name}",
        )
