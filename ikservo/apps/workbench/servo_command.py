"""``ikservo servo``: registers of single servos, on an arm or alone on a line."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import typer

from ikservo.apps.workbench.eeprom_restore import Restoration, plan_restoration, write_restoration
from ikservo.apps.workbench.packet_decoding import decode_packets
from ikservo.apps.workbench.servo_plot import read_joint_maps, show_plot
from ikservo.apps.workbench.servo_tune_command import tune_joint
from ikservo.apps.workbench.servo_workbench import (
    RegisterReading,
    ServoLine,
    find_register,
    holds_torque,
    identify_servo,
    open_servos,
    parse_register_value,
    plan_writes,
    read_registers,
    reset_servo,
    restart_servo,
    write_registers,
)
from ikservo.arm.opening import servo_specs
from ikservo.cli.model_options import model_from_option
from ikservo.cli.options import (
    ArmOption,
    DurationOption,
    JsonOption,
    OverwriteOption,
    ServoConnection,
    ServoPortOption,
    YesOption,
)
from ikservo.cli.quantities import parse_angle_rad, parse_time_s
from ikservo.cli.results import Field, Fields, json_values, print_records
from ikservo.cli.terminal import print_json, print_lines, print_status, print_table
from ikservo.cli.terminal_dialogue import Operator
from ikservo.errors import IkservoError, InputError, UnknownNameError
from ikservo.hardware.eeprom import read_backup, write_backup
from ikservo.hardware.packet_log import read_packet_log
from ikservo.hardware.packets import BROADCAST_ID
from ikservo.hardware.port_names import real_time_port
from ikservo.hardware.servo import ServoSpec
from ikservo.maintenance.dialogue import Question, Unasked
from ikservo.registers import control_table


def _complete_registers(ctx: Any, incomplete: str) -> list[str]:  # noqa: ANN401  # typer hides click's types
    """Complete a prefix to registers of the model, or of all models."""
    from ikservo.apps.workbench.servo_workbench import register_names  # noqa: PLC0415

    ending = "=" if ctx.command.name.endswith("write") else ""
    names = register_names(ctx.params.get("servo_model"))
    return [f"{name}{ending}" for name in names if name.startswith(incomplete)]


Registers = Annotated[
    list[str],
    typer.Argument(
        metavar="REGISTER...", autocompletion=_complete_registers, help="Names of the registers."
    ),
]
Values = Annotated[
    list[str],
    typer.Argument(
        metavar="REGISTER=VALUE...",
        autocompletion=_complete_registers,
        help="A plain integer is a raw value from the data sheet; a number with a unit is a "
        "quantity: "
        "90deg, 7.4V, 500mA, 20ms, 60%.",
    ),
]
Plotted = Annotated[
    list[str] | None,
    typer.Argument(
        metavar="[REGISTER...|JOINT...]",
        autocompletion=_complete_registers,
        help="Registers to plot, or joints, whose angles are plotted in degrees.",
    ),
]
Gains = Annotated[
    list[str] | None,
    typer.Argument(
        metavar="[REGISTER=VALUE...]", autocompletion=_complete_registers, help="Gains to try."
    ),
]
BackupFile = Annotated[Path, typer.Argument(metavar="FILE", help="A backup in a TOML file.")]
PacketFile = Annotated[Path, typer.Argument(metavar="FILE", help="A file with recorded packets.")]
ServoId = Annotated[
    str | None,
    typer.Option("--id", metavar="ID", help="The servo: its id, or its joint with --arm."),
]
ServoIds = Annotated[
    str | None,
    typer.Option("--id", metavar="ID[,ID...]", help="Servos: ids, or joints with --arm."),
]
ServoModel = Annotated[
    str | None,
    typer.Option("--model", help="Without --arm: model of the servo, if it is not recognized."),
]
BaudRate = Annotated[
    int | None,
    typer.Option("--baud", min=1_200, max=12_000_000, help="Without --arm: try only this rate."),
]
Errors = Annotated[bool, typer.Option("--errors", help="Print only faulty packets.")]
Period = Annotated[
    float, typer.Option("--period", parser=parse_time_s, help="Time between two readings.")
]
Step = Annotated[
    float | None,
    typer.Option("--step", parser=parse_angle_rad, help="Amplitude; default: 10deg, sine 2deg."),
]
Sine = Annotated[
    str | None,
    typer.Option(
        "--sine",
        metavar="HZ[,HZ]",
        help="Follow a sine of this frequency; two frequencies give a chirp.",
    ),
]
Suggest = Annotated[bool, typer.Option("--suggest", help="Try about ten gains; suggest the best.")]
DryRun = Annotated[bool, typer.Option("--dry-run", help="Print what would be written.")]
To = Annotated[
    Path | None,
    typer.Option("--to", metavar="FILE", help="Backup file; default: ID_MODEL.toml."),
]
OtherModel = Annotated[
    bool, typer.Option("--other-model", help="Restore a backup of another servo model.")
]


@dataclass(frozen=True, kw_only=True)
class ServoLineOptions:
    """The serial line of servos that may belong to an arm."""

    arm: ArmOption = None
    port: ServoPortOption = None
    servo_model: ServoModel = None
    baud: BaudRate = None

    def open(self, servo_id: str | None = None) -> AbstractContextManager[ServoLine]:
        """Open the line; without an arm, search only for this servo if one is given.

        Raises:
            InputError: The options contradict each other.
        """
        if self.arm:
            if self.servo_model or self.baud:
                raise InputError("--model and --baud are for servos without an arm.", "Omit --arm.")
            return open_servos(model_from_option(self.arm), self.port)
        if servo_id is not None and not servo_id.isdecimal():
            raise InputError(
                f"{servo_id!r} is not an id.", "Give an id, or a joint together with --arm."
            )
        number = None if servo_id is None else int(servo_id)
        table = control_table(self.servo_model) if self.servo_model else None
        return open_servos(None, self.port, servo_id=number, table=table, baud_rate=self.baud)


def table(servo_id: ServoId = None, *, options: ServoLineOptions, json: JsonOption = False) -> None:
    """Print every register of a servo.

    ikservo servo table --port /dev/ttyACM0 --id 3
    """
    with options.open(servo_id) as line:
        _print_registers(line, line.find(servo_id), [], json=json)


def read(
    registers: Registers,
    *,
    servo_id: ServoId = None,
    options: ServoLineOptions,
    json: JsonOption = False,
) -> None:
    """Read registers of a servo.

    ikservo servo read present_voltage p_gain --arm so101 --id elbow_flex
    """
    with options.open(servo_id) as line:
        _print_registers(line, line.find(servo_id), registers, json=json)


def write(
    values: Values,
    *,
    servo_id: ServoId = None,
    options: ServoLineOptions,
    dry_run: DryRun = False,
    yes: YesOption = False,
    json: JsonOption = False,
) -> None:
    """Write registers of a servo; nothing moves unless a goal is written.

    ikservo servo write p_gain=16 max_temperature_limit=65C --arm so101 --id 3
    """
    with options.open(servo_id) as line:
        servo = line.find(servo_id)
        registers: dict[Any, int] = {}
        for word in values:
            name, equals, text = word.partition("=")
            if not equals:
                raise InputError(f"{word!r} has no value.", f"For example: {name}=16")
            register = find_register(servo.table, name)
            registers[register] = parse_register_value(register, text)
        changes = plan_writes(line, servo, registers)
        texts = [str(each) for each in changes]
        if changes and not dry_run:
            print_status(f"{servo}: {', '.join(texts)}")
            moving = any(each.register.name.startswith("goal_") for each in changes)
            warning = " The joint moves at once, without any collision check." if moving else ""
            if holds_torque(line, servo):
                warning += " Its torque is on: support the arm."
            question = Question(f"Write {servo}?{warning}", Unasked.ERROR)
            if not Operator.of(None, yes=yes).agrees(question):
                raise IkservoError("Cancelled; nothing was written.")
        if not dry_run:
            write_registers(line, servo, changes)
        if json:
            print_json(
                "servo-write", id=servo.id, joint=servo.name, model=servo.table.model_name,
                written=not dry_run,
                changes=[
                    {"register": each.register.name, "before": each.found, "after": each.expected}
                    for each in changes
                ],
            )  # fmt: skip
            return
        mark = "would write" if dry_run else "✓"
        print_lines([f"{mark} {servo}: {', '.join(texts) or 'nothing to change'}"])


def ping(servo_id: ServoId = None, *, options: ServoLineOptions, json: JsonOption = False) -> None:
    """Print model and firmware of servos.

    ikservo servo ping --arm so101
    """
    with options.open(servo_id) as line:
        chosen = line.bus.servos.values() if servo_id is None else [line.find(servo_id)]
        rows = [_Identity(servo, *identify_servo(line, servo)) for servo in chosen]
        print_records("servo-ping", "servos", rows, _IDENTITIES, json=json)


def reboot(
    servo_id: ServoId = None,
    *,
    options: ServoLineOptions,
    yes: YesOption = False,
    json: JsonOption = False,
) -> None:
    """Restart a servo; this switches its torque off.

    ikservo servo reboot --arm so101 --id 3
    """
    with options.open(servo_id) as line:
        _restart(line, line.find(servo_id), restart_servo, "restarted", "", yes=yes, json=json)


def reset(
    servo_id: ServoId = None,
    *,
    options: ServoLineOptions,
    yes: YesOption = False,
    json: JsonOption = False,
) -> None:
    """Reset a servo to its factory settings; this switches its torque off.

    ikservo servo reset --port /dev/ttyACM0 --id 3
    """
    done, lost = "reset to factory settings", " Its calibration and settings will be lost."
    with options.open(servo_id) as line:
        _restart(line, line.find(servo_id), reset_servo, done, lost, yes=yes, json=json)


def backup(
    servo_id: ServoId = None,
    *,
    options: ServoLineOptions,
    to: To = None,
    overwrite: OverwriteOption = False,
    json: JsonOption = False,
) -> None:
    """Copy the EEPROM of a servo to a file.

    ikservo servo backup --arm so101 --id 3
    """
    with options.open(servo_id) as line:
        servo = line.find(servo_id)
        path = to or Path(f"{servo.id:03}_{servo.table.model_name}.toml")
        if path.exists() and not overwrite:
            raise InputError(f"{path} exists.", "Choose another file, or add --overwrite.")
        write_backup(line.bus, servo.id, path)
    if json:
        print_json("servo-backup", id=servo.id, joint=servo.name, path=path)
        return
    print_lines([f"✓ {servo}: EEPROM copied to {path}"])


def restore(
    file: BackupFile,
    *,
    servo_id: ServoId = None,
    options: ServoLineOptions,
    other_model: OtherModel = False,
    dry_run: DryRun = False,
    yes: YesOption = False,
    json: JsonOption = False,
) -> None:
    """Write a backup of the EEPROM into a servo.

    ikservo servo restore 003_sts3215.toml --arm so101
    """
    copy = read_backup(file)
    with options.open(servo_id) as line:
        plan = plan_restoration(line.bus, copy, servo_id, other_model=other_model)
        restore_backup(line, plan, dry_run=dry_run, yes=yes, json=json)


def plot(
    plotted: Plotted = None,
    *,
    servo_ids: ServoIds = None,
    options: ServoLineOptions,
    period: Period = 0.1,
    duration: DurationOption = None,
    json: JsonOption = False,
) -> None:
    """Plot registers of servos, or angles of joints, over time.

    ikservo servo plot elbow_flex --arm so101          the angle of the joint

    ikservo servo plot --arm so101 --id elbow_flex,wrist_flex
    """
    words, ids = plotted or [], list(dict.fromkeys(servo_ids.split(","))) if servo_ids else []
    options = replace(options, port=real_time_port(options.port))
    with options.open(servo_ids if len(ids) == 1 else None) as line:
        maps = read_joint_maps(line, model_from_option(options.arm), words) if options.arm else {}
        servos = [*map(line.find, ids), *(line.bus.servos[i] for i in maps)]
        chosen = list(dict.fromkeys(servos) or line.bus.servos.values())
        show_plot(line, chosen, words, maps, period, duration, json=json)


def tune(
    gains: Gains = None,
    *,
    connection: ServoConnection,
    servo_id: ServoId = None,
    step: Step = None,
    sine: Sine = None,
    suggest: Suggest = False,
    yes: YesOption = False,
    json: JsonOption = False,
) -> None:
    """Move a joint quickly with its present gains and other gains, and compare the responses.

    ikservo servo tune --suggest --arm so101 --id elbow_flex
    """
    frequencies_hz = None
    if sine is not None:
        number = r"([0-9]{1,3}(?:\.[0-9]{1,6})?)"
        match = re.fullmatch(f"{number}(?:,{number})?", sine)
        if match is None:
            raise InputError(
                f"{sine!r} is not a frequency.", "For example: --sine 2, or --sine 0.5,5"
            )
        frequencies_hz = float(match[1]), float(match[2] or match[1])
    tune_joint(
        connection, servo_id, gains or [], step, frequencies_hz, suggest=suggest, yes=yes, json=json
    )


def packets(
    file: PacketFile,
    *,
    servo_id: ServoId = None,
    arm: ArmOption = None,
    servo_model: ServoModel = None,
    errors: Errors = False,
    json: JsonOption = False,
) -> None:
    """Print a file of packets, recorded by IKSERVO_PACKETS=log.pcapng or another program.

    ikservo servo packets log.pcapng --arm so101
    """
    specs = servo_specs(model_from_option(arm)) if arm else []
    only = {spec.id for spec in specs if servo_id in (spec.name, str(spec.id))}
    if servo_id is not None and not only:
        if not servo_id.isdecimal():
            raise UnknownNameError("servo", servo_id, [spec.name for spec in specs])
        only = {int(servo_id)}
    tables = {spec.id: spec.table for spec in specs}
    if servo_model:
        tables = dict.fromkeys(range(BROADCAST_ID), control_table(servo_model))
    before_s: float | None = None
    count = faulty = 0
    for packet in decode_packets(read_packet_log(file), tables):
        count, faulty = count + 1, faulty + bool(packet.error)
        gap_ms = 0.0 if before_s is None else 1000 * (packet.time_s - before_s)
        before_s = packet.time_s
        if only and packet.servo_id not in (*only, BROADCAST_ID):  # a broadcast is for each servo
            continue
        if errors and not packet.error:
            continue
        if json:
            print_json(
                "servo-packet", time_s=packet.time_s, sent=packet.sent, id=packet.servo_id,
                meaning=packet.meaning, error=packet.error, bytes=packet.data.hex(" "),
            )  # fmt: skip
            continue
        arrow = "→" if packet.sent else "←"
        whom = {None: "?", BROADCAST_ID: "all"}.get(packet.servo_id, str(packet.servo_id))
        text = f"{packet.meaning} [{packet.error}]" if packet.error else packet.meaning
        start = f"{packet.time_s % 1000:10.6f} {gap_ms:+8.3f} ms {arrow} {whom:>3}  "
        print_lines([f"{start}{text}  {packet.data.hex(' ').upper()}"], indent=len(start))
    if not json:
        print_status(f"{count} packets, {faulty} with an error.")


_REGISTERS: Fields[RegisterReading] = (
    Field("name", "register", value=lambda one: one.register.name),
    Field("address", "address", value=lambda one: one.register.address),
    Field("size", value=lambda one: one.register.size),
    Field("raw", "raw"),
    Field("value", "value", lambda one: one.text),
    Field("unit", value=lambda one: one.register.unit.symbol),
    Field("lower", value=lambda one: one.register.range[0]),
    Field("upper", value=lambda one: one.register.range[1]),
    Field(
        "range",
        "range",
        lambda one: "{}…{}".format(*one.register.range) if one.register.is_writable else "",
        lambda one: list(one.register.range),
    ),
    Field(
        "access",
        "access",
        lambda one: "write" if one.register.is_writable else "read",
        lambda one: one.register.access.name,
    ),
    Field("area", "area", value=lambda one: one.register.area.name),
    Field("default", "default", lambda one: "" if one.default is None else str(one.default)),
    Field("first", "first copy", lambda one: str(one.first) if one.changed else ""),
)


def _print_registers(
    line: ServoLine, servo: ServoSpec, names: Sequence[str], *, json: bool
) -> None:
    readings = read_registers(line, servo, names)
    if json:
        print_json(
            "servo-registers", id=servo.id, joint=servo.name, model=servo.table.model_name,
            registers=[json_values(each, _REGISTERS) for each in readings],
        )  # fmt: skip
        return
    print_status(f"{servo}, {servo.table.model_name}")
    columns = [field for field in _REGISTERS if field.label]
    rows = [[", ".join(field.texts(each)) for field in columns] for each in readings]
    print_table([field.label for field in columns], rows)


@dataclass(frozen=True, slots=True)
class _Identity:
    servo: ServoSpec
    number: int
    firmware: str


_IDENTITIES: Fields[_Identity] = (
    Field("id", "id", value=lambda one: one.servo.id),
    Field("joint", "joint", value=lambda one: one.servo.name),
    Field("model", "model", value=lambda one: one.servo.table.model_name),
    Field("model_number", "number", value=lambda one: one.number),
    Field("firmware", "firmware"),
)


def _restart(
    line: ServoLine,
    servo: ServoSpec,
    restart: Callable[[ServoLine, ServoSpec], object],
    done: str,
    lost: str,
    *,
    yes: bool,
    json: bool,
) -> None:
    text = f"{servo}: torque will be switched off; support the arm.{lost} Continue?"
    if not Operator.of(None, yes=yes).agrees(Question(text, Unasked.ERROR)):
        raise IkservoError("Cancelled; nothing was changed.")
    restart(line, servo)
    if json:
        print_json("servo-restart", id=servo.id, joint=servo.name, done=done)
        return
    print_lines([f"✓ {servo}: {done}; torque {'on' if holds_torque(line, servo) else 'off'}"])


def restore_backup(
    line: ServoLine, plan: Restoration, *, dry_run: bool = False, yes: bool, json: bool
) -> None:
    """Print a restoration, ask, write it to its servo, and print the result.

    Raises:
        IkservoError: The user declined.
        BusError: The servo does not reply, or did not keep a value.
    """
    count = len(plan.changes)
    print_status(f"{plan.servo}: {count or 'no'} register{'s' * (count != 1)} to restore.")
    texts = [str(each) for each in plan.changes]
    for text in texts:
        print_status(f"    {text}")
    for each in plan.kept:
        print_status(f"    {each.register} stays {each.found}; the backup has {each.expected}")
    if not dry_run:
        question = Question(f"Write these to {plan.servo}?", Unasked.ERROR)
        if plan.changes and not Operator.of(None, yes=yes).agrees(question):
            raise IkservoError("Cancelled; the servo was not changed.")
        write_restoration(line.bus, plan)
    if json:
        print_json(
            "setup", joint=plan.servo.name, id=plan.servo.id, model=plan.servo.table.model_name,
            backup=str(plan.backup.path), written=[] if dry_run else texts,
            kept=[each.register.name for each in plan.kept],
        )  # fmt: skip
    elif not dry_run:
        print_lines([f"✓ {plan.servo}: {', '.join(texts) or 'nothing to change'}"])
    if texts and not dry_run:
        print_status(
            "A calibration may depend on the changed values. Check the arm: ikservo doctor"
        )
