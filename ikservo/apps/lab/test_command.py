"""``ikservo test``: measure an arm's accuracy and repeatability according to ISO 9283."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any

import typer

from ikservo import __version__
from ikservo.app_discovery import find_part
from ikservo.apps.lab.accuracy_report import (
    accuracy_fields,
    accuracy_page,
    statements,
    summary_rows,
    touched_fields,
    touched_poses,
)
from ikservo.apps.lab.accuracy_test import PARTS, AccuracyTest, TestSettings
from ikservo.arm import ZeroSource
from ikservo.cli.model_options import model_from_option
from ikservo.cli.open_and_confirm import confirm_motion, open_from_options
from ikservo.cli.option_groups import Without
from ikservo.cli.options import ArmConnection, MotionOptions, NamedArmConnection, PointsOption
from ikservo.cli.quantities import parse_time_s
from ikservo.cli.terminal import (
    format_port,
    print_json,
    print_lines,
    print_status,
    print_table,
    progress_bar,
)
from ikservo.cli.terminal_dialogue import Operator
from ikservo.cli.wiggle_prompt import check_directions_once
from ikservo.errors import IkservoError, InputError, format_point
from ikservo.files.writing import FileWriteError, check_writable, write_atomic
from ikservo.model import Model

_ALL_PARTS = ",".join(PARTS)

Cycles = Annotated[int, typer.Option("--cycles", help="Rounds of poses; ISO 9283 requires 30.")]
PathCycles = Annotated[
    int,
    typer.Option("--path-cycles", help="Cycles of each path at each speed; 10 in the standard."),
]
Drift = Annotated[
    float,
    typer.Option(
        "--drift",
        parser=parse_time_s,
        metavar="TIME",
        help="Duration of the drift test; 60min in the standard; default: 5min.",
        show_default=False,
    ),
]
Parts = Annotated[
    str, typer.Option("--parts", metavar="NAMES", help="Parts to measure, separated by commas.")
]
Touch = Annotated[
    bool,
    typer.Option(
        "--touch", help="Measure by hand instead: torque off, put the tip on known points."
    ),
]
Touches = Annotated[
    int, typer.Option("--touches", min=1, max=100, help="Number of touches per point.")
]


@dataclass(frozen=True, kw_only=True)
class ReportOptions:
    """The HTML file of the report."""

    html: Annotated[
        Path | None,
        typer.Option(
            "--html",
            metavar="FILE",
            help="HTML file for the report; default: a name with the date.",
        ),
    ] = None
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace an existing report.")] = (
        False
    )
    note: Annotated[
        str, typer.Option("--note", help="Note for the report: payload, servos, changes.")
    ] = ""

    def page_path(self, arm: str, started: datetime) -> Path:
        """Return the path of the report.

        Raises:
            InputError: The file exists.
            FileWriteError: The file cannot be written; this is checked before the arm moves.
        """
        path = self.html or Path(f"ikservo-test-{arm}-{started:%Y%m%d-%H%M%S}.html")
        if path.exists() and not self.overwrite:
            raise InputError(f"{path} exists.", "Choose another file, or add --overwrite.")
        try:
            check_writable(path.parent)
        except FileWriteError as error:
            raise FileWriteError(path, error.why) from error
        return path


def command(
    connection: NamedArmConnection,
    *,
    cycles: Cycles = 30,
    path_cycles: PathCycles = 10,
    drift: Drift = 300.0,
    parts: Parts = _ALL_PARTS,
    report: ReportOptions,
    touch: Touch = False,
    points: PointsOption = None,
    touches: Touches = 3,
    options: Annotated[MotionOptions, Without("dry_run")],
) -> None:
    """Measure accuracy and repeatability of poses and paths, and drift, to ISO 9283.

    The arm moves fast, for about half an hour, in a cube of free space in front of it; Ctrl-C stops
    it and keeps the measurements. The figures come from the arm's own joint sensors.

    ikservo test so101 --port sim

    ikservo test so101 --cycles 5 --path-cycles 3 --drift 60s --html so101.html --note "no payload"

    ikservo test so101 --touch          accuracy on a printed sheet, by hand
    """
    if touch:
        _test_by_touch(connection, report, points, touches, options)
        return
    if points:
        raise InputError("--points and --touches need --touch.", "Add: --touch")
    names = tuple(name.strip() for name in parts.split(",") if name.strip())
    settings = TestSettings(cycles, path_cycles, drift, names)
    started = datetime.now(UTC)
    with open_from_options(connection, options) as machine:
        path = report.page_path(machine.model.name, started)
        test = AccuracyTest(machine, settings)
        print_status(
            f"{machine.model.title} on {format_port(machine.port_name)}: it moves fast in a cube "
            f"of {1000 * test.cube.edge_m:.0f} mm, centred at {format_point(test.cube.center_m)}."
        )
        confirm_motion(machine, yes=options.yes)
        check_directions_once(machine, options)
        stopped: BaseException | None = None
        try:
            with progress_bar() as show:
                if show is not None:
                    test.on_step = show
                test.run()
        except (IkservoError, KeyboardInterrupt, SystemExit) as error:  # SystemExit: SIGTERM
            stopped = error
        why = str(getattr(stopped, "message", "") or machine.stopped_for) if stopped else ""
        simulated = machine.zeros is ZeroSource.SIMULATED
        head = _head(machine.model, started, report.note, why, simulated=simulated)
        fields = head | accuracy_fields(test, settings)
        if any(fields[part] for part in PARTS):
            write_atomic(path, accuracy_page(fields))
            _print(fields, path, json=options.json)
        if stopped is not None:
            raise stopped


def _test_by_touch(
    connection: ArmConnection,
    report: ReportOptions,
    points: Path | None,
    touches: int,
    options: MotionOptions,
) -> None:
    """Measure accuracy from touches, and report it like the test by motions."""
    model, started = model_from_option(connection.arm), datetime.now(UTC)
    path = report.page_path(model.name, started)
    operator = Operator.of(None, yes=options.yes)
    found = find_part("test --touch")(model, connection.port, points, touches, operator)
    why = "" if found.stopped is None else str(getattr(found.stopped, "message", "") or "Ctrl-C")
    head = _head(model, started, report.note, why, simulated=False)
    fields = head | touched_fields(touched_poses(found.tips))
    write_atomic(path, accuracy_page(fields))
    _print(fields, path, json=options.json)
    if found.stopped is not None:
        raise found.stopped


def _head(
    model: Model, started: datetime, note: str, stopped: str, *, simulated: bool
) -> dict[str, Any]:
    return {
        "arm": model.name,
        "title": model.title,
        "date": started.strftime("%Y-%m-%d %H:%M UTC"),
        "version": __version__,
        "simulated": simulated,
        "note": note,
        "stopped": stopped,
    }


def _print(fields: dict[str, Any], path: Path, *, json: bool) -> None:
    if json:
        print_json("test", **fields, path=path)
        return
    print_table(("", "where", "value", "cycles"), summary_rows(fields))
    print_lines(statements(fields))
    print_status(f"Saved: {path}")
