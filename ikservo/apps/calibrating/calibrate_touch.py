"""``ikservo calibrate --touch``: touch known points with the tip to calibrate the link geometry."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from ikservo.apps.calibrating.by_hand_dialogue import switch_torque_off
from ikservo.apps.calibrating.calibrate_by_hand import print_servos, reporting_unchanged_state
from ikservo.apps.calibrating.calibration_session import find_lost_camera, open_torque_off
from ikservo.apps.calibrating.touch_dialogue import estimate_fields, estimate_geometry
from ikservo.apps.calibrating.touch_off import TouchOffSession
from ikservo.apps.calibrating.touch_procedure import TouchTarget, place_sheet
from ikservo.cli.options import PointsOption
from ikservo.cli.quantities import parse_length_m
from ikservo.cli.terminal import print_json, print_lines, print_status
from ikservo.cli.terminal_dialogue import Operator
from ikservo.errors import FileFormatError
from ikservo.files.reading import read_text
from ikservo.model import Model

_MAX_BYTES = 64 * 1024
_EXPECTED = "NAME X Y Z in the arm's base frame, in metres or with a unit, such as 120mm"


def read_points(path: Path) -> list[TouchTarget]:
    """Read the points from a file; ``#`` starts a comment.

    Raises:
        FileFormatError: The file cannot be read, or a line is not a point; the message names it.
    """
    targets: list[TouchTarget] = []
    for number, line in enumerate(read_text(path, _MAX_BYTES).splitlines(), start=1):
        fields = line.partition("#")[0].split()
        if not fields:
            continue
        where = f"line {number}"
        if len(fields) != 4:
            raise FileFormatError(path, where, "is not a point", _EXPECTED)
        try:
            position_m = np.array([parse_length_m(field) for field in fields[1:]])
        except typer.BadParameter as error:
            raise FileFormatError(path, where, error.message.rstrip("."), _EXPECTED) from error
        targets.append(TouchTarget(fields[0], position_m))
    return targets


_REPEATS = 20


@dataclass(frozen=True, kw_only=True)
class TouchOffOptions:
    """The points of a touch-off; by default, the points on the printed sheet."""

    points: PointsOption = None
    same_point: Annotated[
        bool,
        typer.Option("--same-point", help="Touch one fixed point of unknown position repeatedly."),
    ] = False
    edge_m: Annotated[
        float | None,
        typer.Option(
            "--sheet-origin",
            parser=parse_length_m,
            help="Distance from the base to the near edge of the sheet.",
        ),
    ] = None  # None: the sheet is below the tool in the pose home
    block_m: Annotated[
        float | None,
        typer.Option(
            "--block-height",
            parser=parse_length_m,
            help="Height of the block that you put on every other cross.",
        ),
    ] = None


def run_touch_off(
    model: Model, port: str | None, options: TouchOffOptions, operator: Operator, *, json: bool
) -> None:
    """Run a touch-off, show its estimate, and save it if it improves the calibration.

    Raises:
        CalibrationError: The arm is not calibrated, or the touches do not suffice or do not
            improve the calibration.
        InputError: There is no user to answer.
    """
    with open_torque_off(model, port) as limp_arm:
        session = TouchOffSession(limp_arm)
        targets = session.reachable_targets(make_targets(model, options))
        operator.run(switch_torque_off(limp_arm))
        with reporting_unchanged_state():
            print_servos(limp_arm, "home")
            for warning in find_lost_camera(session.calibration):
                print_status(warning)
            start = session.start_touch_off(targets)
            state, found = operator.run(estimate_geometry(limp_arm, start))
            path = session.save(found, datetime.now(UTC))
    if json:
        print_json("touch-off", path=path, **estimate_fields(state, found))
    else:
        print_lines([f"Saved to {path}"])


def make_targets(model: Model, options: TouchOffOptions) -> list[TouchTarget]:
    """Make the points to touch, and print where to put the sheet."""
    if options.same_point:
        print_status(
            "Put the tip on one fixed point again and again, each time in another posture."
        )
        return [TouchTarget("the point") for _ in range(_REPEATS)]
    if options.points:
        return read_points(options.points)
    edge_m, targets = place_sheet(model, options.edge_m, options.block_m)
    print_status(
        f"Lay the sheet docs/touch-grid.svg flat in front of the arm, its near edge "
        f"{edge_m * 1000:.0f} mm from the base's origin, its arrow pointing away from the arm."
    )
    return targets
