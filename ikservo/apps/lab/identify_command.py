"""``ikservo identify``: move the arm slowly to find its masses, friction and stiffness."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

import typer

from ikservo.apps.lab.arm_identification import QUICK_TOUR, IdentificationRun
from ikservo.apps.lab.drive_recording import DriveRecording
from ikservo.apps.lab.duty_model import JOINT_PARAMETERS
from ikservo.apps.lab.health_log import (
    HealthRecord,
    append_record,
    health_path,
    identified_health,
    read_records,
)
from ikservo.apps.lab.parameter_estimation import Identification, ParameterEstimate
from ikservo.arm.opening import require_own_port
from ikservo.calibration.identified_file import save_identified
from ikservo.cli.open_and_confirm import confirm_motion, motion_progress_bar, open_from_options
from ikservo.cli.option_groups import Without
from ikservo.cli.options import MotionOptions, ServoConnection
from ikservo.cli.terminal import (
    format_port,
    print_json,
    print_lines,
    print_status,
    print_table,
    progress_bar,
)
from ikservo.cli.wiggle_prompt import check_directions_once
from ikservo.files.writing import check_writable
from ikservo.model.identified_drives import body_joints
from ikservo.planning.reports import MotionProgress

Quick = Annotated[
    bool,
    typer.Option(
        "--quick", help="Use three postures instead of eight; fewer parameters are determined."
    ),
]
_KEYS = (*JOINT_PARAMETERS, "stiffness_nm_rad", "backlash_rad")


@dataclass(frozen=True, kw_only=True)
class IdentifyOptions(MotionOptions):
    """Options of the motion; the arm moves even in a dry run."""

    dry_run: Annotated[bool, typer.Option("--dry-run", help="Identify, but save nothing.")] = False


def command(
    *,
    connection: ServoConnection,
    quick: Quick = False,
    options: Annotated[IdentifyOptions, Without("collision", "uncalibrated", "tip")],
) -> None:
    """Move the arm slowly to find its own masses, friction, stiffness and backlash.

    It moves all joints through the whole reach of the arm for some minutes: clear that space, and
    leave the jaws empty.

    ikservo identify --arm so101
    """
    with open_from_options(connection, options) as machine:
        run = IdentificationRun.plan(require_own_port(machine), QUICK_TOUR if quick else None)
        if not options.dry_run:  # find a full disk before the arm moves for minutes
            check_writable(run.path.parent)
            read_records(health_path(machine.model.name, run.arm.context.serial_number))
        announce_tour(run, options)
        found = run.identify(record_tour(run))
        now = datetime.now(UTC)
        path = None if options.dry_run else save_identified(run.file(found, now))
        if path is not None:
            log = health_path(machine.model.name, run.arm.context.serial_number)
            joints = identified_health(run.arm.context.servos.bus, found)
            append_record(log, HealthRecord(written=now, source="identify", joints=joints))
    carried = dict(zip(body_joints(machine.model, run.dynamics), found.bodies, strict=True))
    if options.json:
        print_json(
            "identify",
            arm=machine.model.name,
            path=path,
            duration_s=run.duration_s,
            joints=[_joint_fields(found, name, carried[name]) for name in found.joints],
            payload_kg=_estimate_fields(found.estimates["payload_kg"]),
        )
    else:
        _print_report(found, carried, path)


def announce_tour(run: IdentificationRun, options: MotionOptions) -> None:
    """Print what will move, ask for confirmation, and move the arm to the start of its tour.

    Raises:
        IkservoError: The user declined.
        InputError: A real arm would move, without --yes and without a terminal.
    """
    machine, legs = run.arm, len(run.excitation.legs)
    print_status(
        f"{machine.model.title} on {format_port(machine.port_name)}: it moves to its pose home, "
        f"then makes {legs} slow motions of all joints throughout its reach, "
        f"{run.duration_s:.0f} s. Clear its reach. Ctrl-C stops the arm, which then holds."
    )
    confirm_motion(machine, yes=options.yes)
    check_directions_once(machine, options)
    with motion_progress_bar() as on_progress:
        run.go_to_start(on_progress)


def record_tour(run: IdentificationRun) -> DriveRecording:
    """Run the tour; on a terminal, show the number of the current motion and the time left."""
    tour = run.excitation
    with progress_bar() as show:

        def draw(progress: MotionProgress) -> None:
            if show:
                motion = f"motion {tour.leg_at(progress.elapsed_s) + 1} of {len(tour.legs)}"
                show(motion, progress.elapsed_s, progress.duration_s)

        recording = run.record(draw)
    print_status("Measured. The estimation takes a few seconds.")
    return recording


def _print_report(found: Identification, carried: dict[str, str], path: Path | None) -> None:
    print_table(
        ["joint", "stiffness", "friction", "load friction", "backlash", "mass"],
        [_row(found, name, carried[name]) for name in found.joints],
    )
    print_lines(
        [
            "Stiffness in N m/rad, friction in N m; ± one standard error. Values in parentheses",
            "are not determined by the motion and stay near those in the servo tables and the "
            "arm file.",
            "Backlash can only be found with servos that measure their current and with room to "
            "swing upright; with",
            "--quick there are no swings.",
            *_conclusions(found),
            "Nothing was saved." if path is None else f"Saved to {path}",
        ]
    )


def _row(found: Identification, name: str, body: str) -> list[str]:
    def estimate(key: str) -> ParameterEstimate | None:
        return found.estimates.get(f"{name}.{key}")

    backlash, play = "–", estimate("backlash_rad")
    if play is not None and play.determined:
        backlash = f"{math.degrees(play.value):.2f} ± {math.degrees(play.error):.1g}°"
    return [
        name,
        _format(estimate("stiffness_nm_rad")),
        _format_sum(estimate("coulomb_nm"), estimate("slow_nm")),
        _format_sum(estimate("load"), estimate("slow_load")),
        backlash,
        _format(found.estimates[f"{body}.mass_scale"], "× "),
    ]


def _format(estimate: ParameterEstimate | None, sign: str = "") -> str:
    if estimate is None:
        return "–"
    if not estimate.determined:
        return f"({sign}{estimate.value:.3g})"
    return f"{sign}{estimate.value:.3g} ± {estimate.error:.1g}"


def _format_sum(one: ParameterEstimate | None, other: ParameterEstimate | None) -> str:
    """Format the friction at rest, a sum of two parts that vary differently with speed."""
    if one is None or other is None:
        return "–"
    error = min(one.error, other.error)
    return _format(ParameterEstimate(one.value + other.value, error, one.error_before))


def _conclusions(found: Identification) -> Iterator[str]:
    payload = found.estimates["payload_kg"]
    grams, error = 1000.0 * payload.value, 1000.0 * payload.error
    if not payload.determined:
        yield "The motion does not determine the mass in the jaws."
    elif payload.value > 2.0 * payload.error:
        yield f"The jaws hold {grams:.0f} ± {error:.0f} g, or the last link is that much heavier."
    else:
        yield f"The jaws are empty ({grams:.0f} ± {error:.0f} g)."
    tables = [name for name, own in found.validation.items() if not own.is_better]
    if tables:
        yield (
            f"The servo tables predict {', '.join(tables)} equally well, so these keep their "
            f"tabulated values."
        )
    worst = max(found.validation, key=lambda name: found.validation[name].identified, default=None)
    if worst is not None:
        own = found.validation[worst]
        yield (
            "On motions that were not used for the estimation, the lag of each joint behind its "
            f"goal is predicted to {math.degrees(own.identified):.2f}° rms or better ({worst}; "
            f"{math.degrees(own.nominal):.2f}° before)."
        )


def _joint_fields(found: Identification, name: str, body: str) -> dict[str, object]:
    validation = found.validation.get(name)
    return {
        "name": name,
        **{key: _estimate_fields(found.estimates.get(f"{name}.{key}")) for key in _KEYS},
        "mass_scale": _estimate_fields(found.estimates[f"{body}.mass_scale"]),
        "lag_error_rad": validation and validation.identified,
        "lag_error_before_rad": validation and validation.nominal,
    }


def _estimate_fields(estimate: ParameterEstimate | None) -> dict[str, object] | None:
    return estimate and {
        "value": estimate.value,
        "error": estimate.error,
        "determined": estimate.determined,
    }
