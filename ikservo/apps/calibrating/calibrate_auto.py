"""``ikservo calibrate --auto``: the arm finds its joint ranges by itself."""

from __future__ import annotations

from ikservo.apps.calibrating.auto_calibration_setup import restore_encoders
from ikservo.apps.calibrating.auto_dialogue import calibrate_against_stops, confirm_search
from ikservo.apps.calibrating.by_hand_dialogue import CalibrationOptions, switch_torque_off
from ikservo.apps.calibrating.calibrate_by_hand import print_result, print_servos
from ikservo.apps.calibrating.calibration_session import open_torque_off
from ikservo.cli.second_interrupt import second_interrupt_lowers
from ikservo.cli.terminal import print_status
from ikservo.cli.terminal_dialogue import Operator
from ikservo.maintenance.direction_check import confirm_directions
from ikservo.model import Model


def calibrate_auto(
    model: Model,
    port: str | None,
    options: CalibrationOptions,
    operator: Operator,
    *,
    json: bool,
) -> None:
    """Record the reference pose, let the arm find its ranges, and save the calibration.

    Raises:
        CalibrationError: The arm file forbids it, or a joint hit something that is not its stop.
        InputError: The user could not be asked for confirmation.
        StoppedError: The user interrupted; the arm holds.
    """
    options.check(model)
    operator.run(confirm_search(model, "Ctrl-C"))
    with open_torque_off(model, port) as limp_arm:
        operator.run(switch_torque_off(limp_arm))
        print_servos(limp_arm, options.pose)
        with restore_encoders(limp_arm, print_status):
            state, outcome, path = operator.run(
                calibrate_against_stops(limp_arm, options, print_status, second_interrupt_lowers)
            )
        if operator.interactive:
            # Each direction has just been confirmed.
            confirm_directions(model, limp_arm.bus.port.name)
    print_result(outcome, state, path, json=json)
