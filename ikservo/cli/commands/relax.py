"""``ikservo relax``: lower the arm and switch torque off."""

from __future__ import annotations

import sys
from collections.abc import Callable
from contextlib import ExitStack
from functools import partial
from typing import Annotated

from ikservo.arm.opening import disable_torque_unchecked
from ikservo.arm.other_process import request_relax
from ikservo.cli.commands.joints import print_report
from ikservo.cli.model_options import model_from_option
from ikservo.cli.open_and_confirm import announce_lowering, motion_progress_bar, open_from_options
from ikservo.cli.option_groups import Without
from ikservo.cli.options import ArmConnection, MotionOptions
from ikservo.cli.terminal import confirm, print_status
from ikservo.errors import CalibrationError, FileFormatError, IkservoError


def command(
    connection: ArmConnection,
    options: Annotated[MotionOptions, Without("dry_run", "no_wiggle", "tip")],
) -> None:
    """Lower the arm to its rest pose, slowly, then switch torque off.

    An arm without a usable calibration is not lowered: its torque goes off after a question.

    If another program of yours uses the port, that program stops its motion and relaxes the arm.
    """
    model = model_from_option(connection.arm)
    remote_result = request_relax(model, connection.port)
    if remote_result is not None:
        print_report(remote_result, model, json=options.json)
        return
    with ExitStack() as stack:
        try:
            machine = stack.enter_context(open_from_options(connection, options))
        except (CalibrationError, FileFormatError) as error:
            print_status(error.command_message)
            disable_torque = partial(disable_torque_unchecked, model, connection.port)
            _release_torque(disable_torque, yes=options.yes)
            return
        if not machine.zeros.are_known:
            print_status("The arm is not calibrated and cannot be lowered.")
            _release_torque(machine.disable_torque, yes=options.yes)
            return
        announce_lowering(machine, options)
        with motion_progress_bar() as on_progress:
            report = machine.relax(on_progress)
    print_report(report, machine.model, json=options.json)


def _release_torque(disable_torque: Callable[[], None], *, yes: bool) -> None:
    """Switch off the torque of an arm with unknown zeros, which cannot be lowered."""
    print_status("Torque will be switched off and the arm will fall. Support it.")
    if not yes and not (sys.stdin.isatty() and confirm("Switch torque off?")):
        raise IkservoError(
            "Cancelled; torque stays on.", "To go on without being asked, add --yes."
        )
    disable_torque()
    print_status("Torque is off.")
