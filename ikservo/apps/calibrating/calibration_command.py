"""``ikservo calibration``: compare a calibration file with the servos, and synchronise them."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Annotated

import typer

from ikservo.app_discovery import find_part
from ikservo.apps.calibrating.by_hand_dialogue import switch_torque_off
from ikservo.apps.calibrating.calibration_session import (
    TorqueOffArm,
    adopt_calibration,
    check_adoptable,
    find_adoptable,
    open_torque_off,
    pull_calibration,
    push_calibration,
    register_differences,
)
from ikservo.apps.calibrating.calibration_table import COLUMNS, calibration_row
from ikservo.arm.opening import resolve_port
from ikservo.calibration.calibration_file import (
    load_calibration_file,
    parse_calibration,
    restore_calibration,
    undo_calibration,
)
from ikservo.calibration.paths import calibration_path, calibrations_of
from ikservo.calibration.records import Calibration
from ikservo.calibration.transaction import resume, roll_back
from ikservo.cli.model_options import model_from_option
from ikservo.cli.options import JsonOption, NamedServoConnection, YesOption
from ikservo.cli.terminal import print_json, print_lines, print_status, print_table
from ikservo.cli.terminal_dialogue import Operator
from ikservo.errors import CalibrationError, ExitCode, IkservoError, InputError
from ikservo.files.writing import BACKUP_SUFFIX
from ikservo.hardware.bus import ServoBus
from ikservo.hardware.port_names import serial_number_of
from ikservo.hardware.transport import refuse_other_machines
from ikservo.maintenance.dialogue import Question, Unasked
from ikservo.model import Model

Source = Annotated[
    Path | None, typer.Option("--from", metavar="FILE", help="Calibration to adopt.")
]


def show(connection: NamedServoConnection, *, json: JsonOption = False) -> None:
    """Print the zeros, signs and ranges of an arm; its servos need not be connected.

    ikservo calibration show so101
    """
    path, calibration = _of_file(connection, load_calibration_file)
    if json:
        tables = calibration.model_dump(mode="json")
        print_json("calibration-show", path=path, calibration=tables)
        return
    adapter = calibration.usb_serial_number or "without a serial number"
    print_lines(
        [f"{path}", f"calibrated on {calibration.written:%Y-%m-%d %H:%M}, adapter {adapter}"]
    )
    print_table(COLUMNS, map(calibration_row, calibration.joints))


def restore(connection: NamedServoConnection, *, json: JsonOption = False) -> None:
    """Replace a damaged calibration file with the previous one; the servos are not read.

    ikservo calibration restore so101
    """
    path, calibration = _of_file(connection, lambda path, _: restore_calibration(path))
    if json:
        print_json("calibration-restore", path=path, written=str(calibration.written))
    else:
        _report_restored(path, calibration)


def undo(connection: NamedServoConnection, *, json: JsonOption = False) -> None:
    """Undo the last calibration by camera or touch-off; restore the calibration before it.

    ikservo calibration undo so101
    """
    path, calibration = _of_file(connection, lambda path, _: undo_calibration(path))
    if json:
        print_json("calibration-undo", path=path, written=str(calibration.written))
    else:
        _report_restored(path, calibration)


def diff(connection: NamedServoConnection, *, json: JsonOption = False) -> None:
    """Compare the calibration file with the servos; exit code 6 if they differ.

    ikservo calibration diff so101
    """
    with _opened(connection) as limp_arm:
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


def push(connection: NamedServoConnection, *, yes: YesOption = False) -> None:
    """Write the calibration file into the servos; this switches their torque off.

    ikservo calibration push so101
    """
    with _opened(connection) as limp_arm:
        if _confirm_transfer(limp_arm, "the servos (torque goes off)", yes=yes):
            print_lines([f"Servos and {push_calibration(limp_arm)} agree."])


def pull(connection: NamedServoConnection, *, yes: YesOption = False) -> None:
    """Write offsets and limits of the servos into the calibration file.

    ikservo calibration pull so101
    """
    with _opened(connection) as limp_arm:
        if _confirm_transfer(limp_arm, str(limp_arm.path), yes=yes):
            print_lines([f"Servos and {pull_calibration(limp_arm)} agree."])


def adopt(
    connection: NamedServoConnection, *, source: Source = None, yes: YesOption = False
) -> None:
    """Use the calibration that was made with another adapter for this arm.

    ikservo calibration adopt so101
    """
    with _opened(connection) as limp_arm:
        path, calibration = find_adoptable(limp_arm, source)
        print_lines([f"Saved to {_confirm_adoption(limp_arm, path, calibration, yes=yes)}"])
        print_status(f"Check each joint: ikservo calibrate {calibration.arm} --wiggle")


def complete_write(connection: NamedServoConnection, *, yes: YesOption = False) -> None:
    """Finish writing a calibration into the servos after an interruption.

    ikservo calibration resume so101
    """
    _end_interrupted_write(connection, resume, "completed", yes=yes)


def revert(connection: NamedServoConnection, *, yes: YesOption = False) -> None:
    """Undo an interrupted write of a calibration into the servos.

    ikservo calibration revert so101
    """
    _end_interrupted_write(connection, roll_back, "reverted", yes=yes)


def _opened(
    connection: NamedServoConnection, *, settled: bool = True
) -> AbstractContextManager[TorqueOffArm]:
    return open_torque_off(model_from_option(connection.arm), connection.port, settled=settled)


def _of_file(
    connection: NamedServoConnection, read: Callable[[Path, str], Calibration | None]
) -> tuple[Path, Calibration]:
    """Find the calibration file of an arm, and read or restore it."""
    model = model_from_option(connection.arm)
    path = _find_file(model, connection.port)
    calibration = read(path, model.name)
    if calibration is None:
        raise CalibrationError(
            f"There is no {path}.", f"Calibrate the arm: ikservo calibrate {model.name}"
        )
    return path, calibration


def _report_restored(path: Path, calibration: Calibration) -> None:
    print_lines([f"Restored {path}, written on {calibration.written:%Y-%m-%d}."])
    print_status(f"Compare it with the servos: ikservo calibration diff {calibration.arm}")


def _find_file(model: Model, port: str | None) -> Path:
    """Find the calibration of the arm at a port, or else its only calibration."""
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


def _confirm_transfer(limp_arm: TorqueOffArm, target: str, *, yes: bool) -> bool:
    """Print the differences and ask whether to write them; return False if there are none."""
    found = register_differences(limp_arm)
    if not found:
        print_lines(["Servos and calibration file agree; nothing to do."])
        return False
    for difference in found:
        print_status(str(difference))
    question = Question(f"Write this into {target}?", Unasked.NEEDS_YES)
    if not Operator.of(None, yes=yes).agrees(question):
        raise IkservoError(
            "Cancelled; nothing was written.", "To write without being asked, add --yes."
        )
    return True


def import_recorded(model: Model, port: str | None, path: Path, *, yes: bool, json: bool) -> None:
    """Save the calibration that is attached to a recording as the calibration of the arm.

    Raises:
        CalibrationError: The calibration does not fit the servos, or none is attached.
        FileFormatError: The file cannot be read.
    """
    text: str | None = find_part("import recording")(path)
    if text is None:
        raise CalibrationError(
            f"No calibration is attached to {path}.",
            "A calibration is attached when a calibrated arm is recorded as MCAP: ikservo "
            "record FILE.mcap",
        )
    calibration = parse_calibration(path, text)
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
    made_on = calibration.usb_serial_number or "without a serial number"
    print_status(f"{path} (adapter {made_on}): ids, models, offsets and limits match these servos.")
    if not Operator.of(None, yes=yes).agrees(Question("Is this the same arm?", Unasked.NEEDS_YES)):
        raise IkservoError(
            "Cancelled; nothing was saved.", "To save without being asked, add --yes."
        )
    return adopt_calibration(limp_arm, calibration)


def _end_interrupted_write(
    connection: NamedServoConnection,
    step: Callable[[ServoBus, Path], object],
    done: str,
    *,
    yes: bool,
) -> None:
    with _opened(connection, settled=False) as limp_arm:
        if not limp_arm.journal_path.exists():
            print_lines(["No interrupted write; nothing to do."])
            return
        Operator.of(None, yes=yes).run(switch_torque_off(limp_arm))
        step(limp_arm.bus, limp_arm.journal_path)
        print_lines([f"The interrupted calibration was {done}."])
