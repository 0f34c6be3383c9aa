"""``ikservo test --touch``: accuracy from touches of known points, guided by hand."""

from __future__ import annotations

from collections.abc import Generator
from functools import partial
from pathlib import Path

from ikservo.cli.answers import answers_from, apply_or_explain
from ikservo.cli.calibrate_screen import disable_torque, print_servos
from ikservo.cli.calibrate_touch import read_points
from ikservo.cli.terminal import print_status
from ikservo.errors import CalibrationError, IkservoError, format_point
from ikservo.maintenance.accuracy_test import PoseResult
from ikservo.maintenance.calibration_session import TorqueOffArm, open_torque_off
from ikservo.maintenance.touch_off import TouchOffSession
from ikservo.maintenance.touched_accuracy import repeated_targets, touched_poses
from ikservo.model import Model
from ikservo.model.touch_procedure import (
    ScriptedTouchAnswers,
    TouchOffState,
    TouchTarget,
    apply_answer,
    place_sheet,
)

__all__ = ["TouchedPoints", "measure_by_touch"]

_KEYS = {"\n": "touch", "\r": "touch", "s": "skip", "u": "undo", "a": "accept"}


class TouchedPoints:
    """The touches of a test, kept also where it is stopped.

    Attributes:
        poses: The touched points, with where the tip was by the arm's joints.
        stopped: Why it ended early; None where it did not.
    """

    def __init__(self) -> None:
        self.poses: list[PoseResult] = []
        self.stopped: BaseException | None = None


def measure_by_touch(
    model: Model, port: str | None, points: Path | None, times: int, *, yes: bool, interactive: bool
) -> TouchedPoints:
    """Switch torque off and let the user put the tip on known points.

    Args:
        model: The arm.
        port: See ``open_torque_off``.
        points: A file of points; None for the printed sheet.
        times: How often each is touched.
        yes: Whether torque is switched off without being asked, and each touch is taken as soon
            as the arm was moved and is held still.
        interactive: Whether a user may be asked.

    Raises:
        CalibrationError: The arm is not calibrated, or no point was touched.
        InputError: No user is there to answer.
    """
    found = TouchedPoints()
    with open_torque_off(model, port) as limp_arm:
        session = TouchOffSession(limp_arm)
        targets = session.reachable_targets(_targets(model, points))
        if not targets:
            raise CalibrationError("No point is within reach of the tip.", "Check the points.")
        disable_torque(limp_arm, interactive=interactive, yes=yes)
        print_servos(limp_arm, "home")
        state = session.start_touch_off(repeated_targets(targets, times))
        try:
            for each in _dialogue(limp_arm, state, yes=yes, interactive=interactive):
                found.poses = touched_poses(session.present, each.touches)
        except (IkservoError, KeyboardInterrupt) as error:
            found.stopped = error
    if not found.poses and found.stopped is not None:
        raise found.stopped
    if not found.poses:
        raise CalibrationError("No point was touched; there is nothing to report.")
    return found


def _targets(model: Model, points: Path | None) -> list[TouchTarget]:
    if points is not None:
        return read_points(points)
    edge_m, targets = place_sheet(model, None, None)
    print_status(
        f"Lay the sheet docs/touch-grid.svg flat in front of the arm, its near edge "
        f"{edge_m * 1000:.0f} mm from the base's origin, its arrow pointing away from the arm."
    )
    return targets


def _dialogue(
    limp_arm: TorqueOffArm, state: TouchOffState, *, yes: bool, interactive: bool
) -> Generator[TouchOffState]:
    """Read the servos and apply answers until every point was touched; yield after each answer."""
    script = ScriptedTouchAnswers(None) if yes else None
    last_line = ""
    with answers_from(script, lambda _, key: _KEYS.get(key), interactive=interactive) as source:
        while state.current_target is not None:
            reading = limp_arm.read_positions()
            if reading is None:
                continue
            state = state.update(*reading)
            last_line = _print_task(state.current_target, state, last_line)
            answer = source.next_answer(state, reading[0])
            if answer == "accept":
                return
            if answer:
                state = apply_or_explain(
                    partial(apply_answer, state, answer), state, source, print_status
                )
                yield state


def _print_task(target: TouchTarget | None, state: TouchOffState, last_line: str) -> str:
    if target is None or target.position_m is None:
        return last_line
    number = f"Touch {len(state.touches) + 1} of {len(state.touches) + len(state.places)}"
    line = (
        f"{number}: put the tip on {target.name} at {format_point(target.position_m)}.\n"
        "  Enter   s skip   u undo   a finish   Ctrl-C stop"
    )
    if line != last_line:
        print_status(line)
    return line
