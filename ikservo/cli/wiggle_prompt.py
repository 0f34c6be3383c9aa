"""``ikservo calibrate --wiggle``: small motions to confirm each joint and its direction."""

from __future__ import annotations

from collections.abc import Sequence

from ikservo.arm import Arm, OpenArm
from ikservo.arm.opening import require_own_port
from ikservo.cli.open_and_confirm import open_from_options
from ikservo.cli.options import ArmConnection, MotionOptions
from ikservo.cli.terminal import print_json, print_lines, print_status
from ikservo.cli.terminal_dialogue import Operator
from ikservo.errors import InputError
from ikservo.maintenance.dialogue import Question, Unasked
from ikservo.maintenance.direction_check import (
    DirectionCheck,
    check_each_joint,
    needs_direction_check,
)
from ikservo.model import Model


def check_directions_once(machine: OpenArm, options: MotionOptions) -> bool:
    """Run the test motion of all joints if ``needs_direction_check`` is true.

    Returns whether the test ran; the arm may then be away from the start of a plan made before.

    Raises:
        CalibrationError: A joint is not the expected one.
        InputError: There is no user to watch the motions.
    """
    if options.no_wiggle or not isinstance(machine, Arm):  # done by the program with the servos
        return False
    if not needs_direction_check(machine):
        return False
    print_status(
        "The arm file or calibration has changed. First a test motion: each joint by 5° and back."
    )
    _check_each_joint(machine, [], yes=options.yes)
    return True


def check_new_signs(
    model: Model, port: str | None, names: Sequence[str], operator: Operator
) -> bool:
    """Offer a test of joints whose sign differs from the arm file; return whether it ran.

    If the user declines, the first motion of the arm starts with the test.

    Raises:
        CalibrationError: The user saw a joint move in the wrong direction.
    """
    if not names:
        return True
    print_status(
        f"Sign opposite to the arm file's: {', '.join(names)}. A small test motion checks this:"
    )
    print_status("torque is switched on, and each of these joints moves by 5° and back.")
    if not operator.agrees(Question("Run the test motion now?", Unasked.NO)):
        print_status(
            "The first motion begins with this test. To run it: "
            f"ikservo calibrate {model.name} --wiggle"
        )
        return False
    connection = ArmConnection(arm=str(model.path), port=port)
    with open_from_options(connection, MotionOptions(collision=False)) as machine:
        _check_each_joint(require_own_port(machine), names, yes=False)
    return True


def check_directions(machine: Arm, joints: Sequence[str], *, yes: bool, json: bool) -> None:
    """Run the test motion of some joints, or all if none are named; record all as confirmed."""
    motions = _check_each_joint(machine, joints, yes=yes)
    if json:
        moved = [
            {"joint": m.joint, "displacement_rad": m.travel, "description": m.direction}
            for m in motions
        ]
        print_json("wiggle", joints=moved, confirmed=not yes)
    else:
        print_lines([f"{motion.joint}: it moves {motion.direction}" for motion in motions])


def _check_each_joint(machine: Arm, joints: Sequence[str], *, yes: bool) -> list[DirectionCheck]:
    operator = Operator.of(None, yes=yes)
    if not (operator.interactive or yes):
        text = "Cannot ask whether the joints move correctly: input is not a terminal."
        raise InputError(text, "To go on without being asked, add --yes.")
    names = [machine.model.joint(name).name for name in joints]
    return operator.run(
        check_each_joint(machine, names or [each.name for each in machine.model.joints])
    )
