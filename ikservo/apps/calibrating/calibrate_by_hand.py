"""``ikservo calibrate`` by hand: options and output; the dialogue has its own module."""

from __future__ import annotations

from collections import Counter
from collections.abc import Generator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import typer

from ikservo.apps.calibrating.by_hand_dialogue import (
    CalibrationOptions,
    calibrate_by_hand,
    switch_torque_off,
)
from ikservo.apps.calibrating.by_hand_procedure import CalibrationState, warnings
from ikservo.apps.calibrating.calibration_result import CalibrationResult
from ikservo.apps.calibrating.calibration_session import (
    TorqueOffArm,
    base_calibration,
    open_torque_off,
)
from ikservo.calibration import Limits
from ikservo.cli.quantities import parse_angle_rad, parse_length_m
from ikservo.cli.terminal import print_json, print_lines, print_status
from ikservo.cli.terminal_dialogue import Operator
from ikservo.cli.wiggle_prompt import check_new_signs
from ikservo.errors import BadValueError, StoppedError, shown
from ikservo.hardware.port_names import is_simulated, with_simulator_option
from ikservo.maintenance.dialogue import ScriptedAnswers
from ikservo.maintenance.direction_check import confirm_directions, directions_confirmed
from ikservo.model import Model


def calibrate(
    model: Model, port: str | None, options: CalibrationOptions, operator: Operator, *, json: bool
) -> None:
    """Run a calibration by hand and save its result; the simulator moves a simulated arm."""
    options.check(model)
    if port is not None and is_simulated(port) and "?" not in port:
        port = with_simulator_option(port, f"pose={options.pose}&hand=calibrate")
        operator = replace(operator, script=operator.script or ScriptedAnswers(None), yes=True,
                           interactive=False)  # fmt: skip
        print_status("A simulated hand moves the simulated joints and answers the questions.")
    with open_torque_off(model, port) as limp_arm:
        base = base_calibration(limp_arm, options.joints) if options.joints else None
        known = base is None or directions_confirmed(model, limp_arm.bus.port.name)
        operator.run(switch_torque_off(limp_arm))
        with reporting_unchanged_state():
            print_servos(limp_arm, options.pose)
            state, outcome = operator.run(calibrate_by_hand(limp_arm, options, base))
            path = limp_arm.save(outcome)
        port_name = limp_arm.bus.port.name
    print_result(outcome, state, path, json=json)
    opposite = [s.name for s in state.subjects if state.sign(s) != s.joint_map.sign]
    if is_simulated(outcome.calibration.usb_serial_number):
        return
    tested = check_new_signs(model, port, opposite, operator)
    if known and tested and all(s.name in state.signs for s in state.subjects):
        confirm_directions(model, port_name)  # each joint moved as the files say


@contextmanager
def reporting_unchanged_state() -> Generator[None]:
    """On Ctrl-C during a calibration by hand, report that nothing was saved.

    Raises:
        StoppedError: The user pressed Ctrl-C, or the input ended.
    """
    try:
        yield
    except (KeyboardInterrupt, typer.Abort):
        raise StoppedError("Stopped: nothing was saved; torque is off.") from None


def print_servos(limp_arm: TorqueOffArm, pose: str) -> None:
    """Print the servos found and the reference pose."""
    servos = list(limp_arm.facts.values())
    counts = Counter(facts.table.model_name for facts in servos)
    listed = ", ".join(f"{count} {name}" for name, count in counts.items())
    firmware = ", ".join(sorted({facts.firmware for facts in servos}))
    print_status(
        f"{limp_arm.model.title} on {limp_arm.bus.port.name}: {listed}, firmware {firmware}."
    )
    print_status(pose_description(limp_arm.model, pose))


def pose_description(model: Model, pose: str) -> str:
    """Describe where the tip is in a named pose.

    Raises:
        UnknownNameError: The arm has no such pose.
    """
    x, y, z = (1000.0 * model.chain.forward(model.chain_pose(pose))[:3, 3]).tolist()
    ahead = f"{abs(x):.0f} mm {'in front of' if x >= 0.0 else 'behind'} the base"
    aside = f", {abs(y):.0f} mm to its {'left' if y > 0.0 else 'right'}" if abs(y) >= 1.0 else ""
    height_m = z - 1000.0 * (model.floor_m or 0.0)
    return (
        f'In the pose "{pose}", the tip is {ahead}{aside}, and {height_m:.0f} mm above the table.'
    )


def parse_limits(model: Model, texts: Sequence[str]) -> Mapping[str, Limits]:
    """Parse the ranges of ``--limit``, by joint.

    Raises:
        BadValueError: A value is not a range.
        UnknownNameError: The arm has no such joint.
    """
    limits: dict[str, Limits] = {}
    for text in texts:
        name, _, ends = text.partition("=")
        low, colon, high = ends.partition(":")
        if not colon:
            raise BadValueError("The limit", shown(text), "JOINT=LOW:HIGH, as in elbow_flex=-80:80")
        unit = model.joint(name).joint_map.unit
        parse = parse_length_m if unit == "m" else parse_angle_rad
        lower, upper = parse(low), parse(high)
        if not lower < upper:
            raise BadValueError(f"The limit of {name}", shown(ends), "the lower end first")
        limits[name] = Limits.of(name, lower, upper, "user", unit)
    return limits


def print_result(
    outcome: CalibrationResult, state: CalibrationState, path: Path, *, json: bool
) -> None:
    """Print the saved calibration."""
    calibration = outcome.calibration
    if json:
        joints = [joint.model_dump(exclude_none=True) for joint in calibration.joints]
        print_json(
            "calibrate", path=path, arm=calibration.arm, joints=joints, findings=[*warnings(state)]
        )
        return
    print_lines([f"Saved to {path}"])
    if is_simulated(calibration.usb_serial_number):
        print_status(
            "The simulation ended; the next simulated arm uses the arm file's zeros and signs."
        )
    else:
        print_status(f"Check it: ikservo where --arm {calibration.arm}")
