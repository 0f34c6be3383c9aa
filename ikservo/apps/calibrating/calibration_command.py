"""``ikservo calibration``: compare a calibration file with the servos, and synchronise them."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ikservo.apps.calibrating.calibration_dialogue import switch_torque_off
from ikservo.apps.calibrating.calibration_session import (
    TorqueOffArm,
    adopt_calibration,
    find_adoptable,
    open_torque_off,
    pull,
    push,
    register_differences,
)
from ikservo.apps.calibrating.calibration_table import COLUMNS, calibration_row
from ikservo.apps.calibrating.recorded_calibration import (
    check_adoptable,
    read_recorded_calibration,
)
from ikservo.arm.opening import resolve_port
from ikservo.calibration.calibration_file import (
    load_calibration_file,
    restore_calibration,
    undo_calibration,
)
from ikservo.calibration.paths import calibration_path, calibrations_of
from ikservo.calibration.records import Calibration
from ikservo.calibration.transaction import resume, roll_back
from ikservo.cli.completion import complete_from
from ikservo.cli.model_options import model_from_option
from ikservo.cli.options import JsonOption, NamedServoConnection, YesOption
from ikservo.cli.terminal import print_json, print_lines, print_status, print_table
from ikservo.cli.terminal_dialogue import Operator
from ikservo.errors import CalibrationError, ExitCode, IkservoError, InputError, UnknownNameError
from ikservo.files.writing import BACKUP_SUFFIX
from ikservo.hardware.port_names import serial_number_of
from ikservo.hardware.transport import refuse_other_machines
from ikservo.maintenance.dialogue import Question, Unasked
from ikservo.model import Model

ACTIONS = ("show", "diff", "push", "pull", "adopt", "restore", "undo", "resume", "revert")
Action = Annotated[
    str,
    typer.Argument(
        metavar="show|diff|push|pull|adopt|restore|undo|resume|revert",
        autocompletion=complete_from(*ACTIONS),
        help="show: print it. diff: compare. push: file into servos. pull: servos into file. "
        "adopt: use that of another adapter. restore: replace a damaged file by the previous one. "
        "undo: back to the one before. resume, revert: complete or undo an interrupted write.",
    ),
]
Source = Annotated[
    Path | None, typer.Option("--from", metavar="FILE", help="Calibration to adopt.")
]


def command(
    action: Action,
    connection: NamedServoConnection,
    *,
    source: Source = None,
    yes: YesOption = False,
    json: JsonOption = False,
) -> None:
    """Compare an arm's calibration with its servos, or copy one to the other.

    ikservo calibration show so101          zeros, signs, ranges

    ikservo calibration diff so101          exit 6 if they differ

    ikservo calibration push so101          write the file into the servos

    ikservo calibration pull so101          write the servos into the file

    ikservo calibration adopt so101         the arm is on another adapter than before

    ikservo calibration restore so101       replace a damaged file by the one before

    ikservo calibration undo so101          back to the one before the last camera or touch-off
    """
    if action not in ACTIONS:
        raise UnknownNameError("action", action, ACTIONS)
    if source and action != "adopt":
        raise InputError(f"--from cannot be used with {action}.", "It belongs to: adopt")
    model, port = model_from_option(connection.arm), connection.port
    if action in ("show", "restore", "undo"):
        _show_or_restore(model, port, action, json=json)
        return
    interrupted = action in ("resume", "revert")
    with open_torque_off(model, port, settled=not interrupted) as limp_arm:
        if action == "diff":
            _print_differences(limp_arm, json=json)
        elif interrupted:
            _resolve_interrupted(limp_arm, action, yes=yes)
        elif action == "adopt":
            path, calibration = find_adoptable(limp_arm, source)
            print_lines([f"Saved to {_confirm_adoption(limp_arm, path, calibration, yes=yes)}"])
            print_status(f"Check each joint: ikservo calibrate {calibration.arm} --wiggle")
        else:
            _transfer_calibration(limp_arm, action, yes=yes)


def _show_or_restore(model: Model, port: str | None, action: str, *, json: bool) -> None:
    """Print or restore a calibration; the servos are not asked, and need not be connected."""
    path = _find_file(model, port)
    calibration = (
        load_calibration_file(path, model.name)
        if action == "show"
        else (restore_calibration if action == "restore" else undo_calibration)(path)
    )
    if calibration is None:
        raise CalibrationError(
            f"There is no {path}.", f"Calibrate the arm: ikservo calibrate {model.name}"
        )
    if action != "show":
        if json:
            written = str(calibration.written)
            if action == "undo":
                print_json("calibration-undo", path=path, written=written)
            else:
                print_json("calibration-restore", path=path, written=written)
            return
        print_lines([f"Restored {path}, of {calibration.written:%Y-%m-%d}."])
        print_status(f"Compare it with the servos: ikservo calibration diff {model.name}")
        return
    if json:
        tables = calibration.model_dump(mode="json")
        print_json("calibration-show", path=path, calibration=tables)
        return
    adapter = calibration.usb_serial_number or "without a number"
    print_lines(
        [f"{path}", f"calibrated on {calibration.written:%Y-%m-%d %H:%M}, adapter {adapter}"]
    )
    print_table(COLUMNS, map(calibration_row, calibration.joints))


def _find_file(model: Model, port: str | None) -> Path:
    """Find the calibration of the arm at a port, or else the only one there is of it."""
    if port is not None:
        refuse_other_machines(port)
        return calibration_path(model.name, serial_number_of(resolve_port(model, port)))
    folder = calibration_path(model.name, "").parent
    backups = (path.with_suffix("") for path in folder.glob(f"{model.name}*.toml{BACKUP_SUFFIX}"))
    paths = sorted({*calibrations_of(model.name), *backups})
    if len(paths) > 1:
        listed = ", ".join(path.name for path in paths)
        raise InputError(f"{model.name} has several calibrations: {listed}.", "Choose with --port.")
    return paths[0] if paths else calibration_path(model.name, "")


def _print_differences(limp_arm: TorqueOffArm, *, json: bool) -> None:
    found = register_differences(limp_arm)
    if json:
        print_json("calibration-diff", path=limp_arm.path, differences=found)
    elif found:
        rows = [[d.joint, str(d.servo_id), d.register, d.expected, d.found] for d in found]
        print_table(["joint", "id", "register", "file", "servo"], rows)
    else:
        print_lines(["Servos and calibration file agree."])
    if found:
        raise typer.Exit(ExitCode.CALIBRATION)


def _transfer_calibration(limp_arm: TorqueOffArm, action: str, *, yes: bool) -> None:
    found = register_differences(limp_arm)
    if not found:
        print_lines(["Servos and calibration file agree; nothing to do."])
        return
    for difference in found:
        print_status(str(difference))
    target = "the servos (torque goes off)" if action == "push" else str(limp_arm.path)
    question = Question(f"Write this into {target}?", Unasked.NEEDS_YES)
    if not Operator.of(None, yes=yes).agrees(question):
        raise IkservoError("Cancelled; nothing was written.", "Without asking: --yes")
    path = push(limp_arm) if action == "push" else pull(limp_arm)
    print_lines([f"Servos and {path} agree."])


def import_recorded(model: Model, port: str | None, path: Path, *, yes: bool, json: bool) -> None:
    """Save the calibration that is attached to a recording as the arm's own.

    Raises:
        CalibrationError: It does not fit the servos, or the recording has none.
        FileFormatError: The file cannot be read.
    """
    calibration = read_recorded_calibration(path)
    with open_torque_off(model, port) as limp_arm:
        check_adoptable(limp_arm, path, calibration)
        saved = _confirm_adoption(limp_arm, path, calibration, yes=yes)
    if json:
        print_json("import-recording", path=saved, recording=path)
    else:
        print_lines([f"Saved to {saved}"])
    print_status(f"Check each joint: ikservo calibrate {calibration.arm} --wiggle")


def _confirm_adoption(
    limp_arm: TorqueOffArm, path: Path, calibration: Calibration, *, yes: bool
) -> Path:
    made_on = calibration.usb_serial_number or "without a number"
    print_status(
        f"{path}, made on adapter {made_on}: ids, models, offsets and limits match these servos."
    )
    if not Operator.of(None, yes=yes).agrees(Question("Is this the same arm?", Unasked.NEEDS_YES)):
        raise IkservoError("Cancelled; nothing was saved.", "Without asking: --yes")
    return adopt_calibration(limp_arm, calibration)


def _resolve_interrupted(limp_arm: TorqueOffArm, action: str, *, yes: bool) -> None:
    if not limp_arm.journal_path.exists():
        print_lines(["No interrupted write; nothing to do."])
        return
    Operator.of(None, yes=yes).run(switch_torque_off(limp_arm))
    step = resume if action == "resume" else roll_back
    step(limp_arm.bus, limp_arm.journal_path)
    done = "completed" if action == "resume" else "reverted"
    print_lines([f"The interrupted calibration was {done}."])
