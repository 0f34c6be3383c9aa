"""``ikservo import``: a calibration that another program made becomes this arm's."""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, datetime
from typing import Annotated

import typer

from ikservo.arm.calibrating.by_hand import LooseArm, loose_arm
from ikservo.arm.calibrating.filing import lost_by_saving
from ikservo.arm.calibrating.importing import (
    as_recorded,
    check_recorded,
    known_travels,
    unlike_servos,
)
from ikservo.calibration.filing.lerobot import LerobotJoint, read_lerobot
from ikservo.calibration.filing.lerobot_places import find_lerobot
from ikservo.calibration.sweeping.answers import read_script
from ikservo.calibration.sweeping.outcome import Outcome
from ikservo.calibration.sweeping.sweep import Wizard
from ikservo.cli.calibrating.hands import check_zeros, show
from ikservo.cli.calibrating.meeting import consent, greet, let_go, telling_what_is_left
from ikservo.cli.calibrating.options import FromScript, Margin, NoInput, Pose
from ikservo.cli.calibrating.screen import screen
from ikservo.cli.calibrating.talk import Answers, answers, converse
from ikservo.cli.choosing import chosen_model
from ikservo.cli.options import ArmOption, JsonOption, PortOption, YesOption
from ikservo.cli.output import note
from ikservo.errors import IkservoError, UnknownNameError

__all__ = ["Kind", "check_kind", "command"]

Kind = Annotated[str, typer.Argument(metavar="lerobot", help="Whose: lerobot.")]
Source = Annotated[
    str, typer.Argument(metavar="ID|FILE", help="LeRobot's id of the arm, or a file.")
]


def command(
    kind: Kind,
    source: Source,
    *,
    arm: ArmOption = None,
    port: PortOption = None,
    pose: Pose = "rest",
    margin: Margin = 2.0,
    from_script: FromScript = None,
    yes: YesOption = False,
    no_input: NoInput = False,
    json: JsonOption = False,
) -> None:
    """Import ids and ranges from LeRobot; zeros and signs are then measured in a pose.

    LeRobot's zero is the middle of what was swept, which says nothing about the geometry.

    ikservo import lerobot my_arm --arm so101
    """
    check_kind(kind)
    model, path = chosen_model(arm), find_lerobot(source)
    joints = read_lerobot(path)
    model.pose(pose)
    if from_script:
        read_script(from_script)  # before an arm goes limp for it
    asks = not (yes or no_input or from_script) and sys.stdin.isatty()
    with loose_arm(model, port) as loose:
        check_recorded(joints, model, loose)
        let_go(loose, asks=asks, yes=yes or from_script is not None)
        with telling_what_is_left():
            greet(loose, pose)
            with answers(from_script, yes=yes, ask=asks) as who:
                wizard = _converse(loose, joints, pose, margin, who)
            check_zeros(wizard, pose, model.name, asks=asks)
            outcome = _concluded(loose, joints, wizard, pose)
            for line in lost_by_saving(loose):
                note(f"  {line}")
            if not consent(f"Save to {loose.path}?", default=True, asks=asks):
                raise IkservoError("Cancelled; nothing was saved or written, torque is off.")
            saved = loose.save(outcome)
    show(outcome, wizard, saved, json=json)


def check_kind(kind: str) -> None:
    """Refuse programs that are not known.

    Raises:
        UnknownNameError: It is not LeRobot.
    """
    if kind != "lerobot":
        raise UnknownNameError("format", kind, ("lerobot",))


def _converse(
    loose: LooseArm, joints: Sequence[LerobotJoint], pose: str, margin: float, who: Answers
) -> Wizard:
    wizard = Wizard.begin(loose.subjects(pose, known_travels(joints, loose)), math.radians(margin))
    free = frozenset(joint.name for joint in joints if joint.turns_freely)
    with screen(loose.model, pose) as shown:
        return converse(loose, replace(wizard, free=free), who, shown)


def _concluded(
    loose: LooseArm, joints: Sequence[LerobotJoint], wizard: Wizard, pose: str
) -> Outcome:
    """Work the calibration out, its joints in LeRobot's order so that it can be handed back."""
    for line in unlike_servos(joints, loose.facts):
        note(line)
    facts = as_recorded(joints, loose.facts)
    outcome = loose.conclude(wizard, pose, datetime.now(UTC), facts=facts)
    found = {joint.name: joint for joint in outcome.calibration.joints}
    ordered = tuple(found[joint.name] for joint in joints)
    return replace(outcome, calibration=outcome.calibration.model_copy(update={"joints": ordered}))
