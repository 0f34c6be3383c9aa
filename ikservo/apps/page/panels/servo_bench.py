"""The servo page: one port, named on the command line, and its thread.

Writes pass the same checks as in ``ikservo servo write``. Only a trial of gains moves a joint:
the port is then closed, and the arm is opened at that port with its guard.
"""

from __future__ import annotations

import itertools
import queue
import threading
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, TypeAdapter

from ikservo.apps.page.messages.message_fields import Name, PageMessage
from ikservo.apps.page.messages.page_messages import (
    BadMessageError,
    ReadServo,
    WriteRegister,
    validate_message,
)
from ikservo.apps.page.panels.servo_panel import table_frame, write_limp, write_values
from ikservo.apps.page.panels.servo_trial import (
    describe_trials,
    trial_frame,
    try_on_joint,
    tunable_names,
)
from ikservo.apps.page.server.auth import Permission
from ikservo.apps.page.server.downloads import Download, DownloadOffers
from ikservo.apps.page.server.server import Frame
from ikservo.apps.workbench.eeprom_restore import plan_restoration, write_restoration
from ikservo.apps.workbench.servo_samples import Sample, live_registers, sample_registers
from ikservo.apps.workbench.servo_workbench import (
    ServoLine,
    find_register,
    holds_torque,
    identify_servo,
    open_servos,
    parse_register_value,
    restart_servo,
    shown_unit,
)
from ikservo.arm.arm import Arm
from ikservo.arm.opening import open_own_arm
from ikservo.errors import IkservoError, InputError, PortError
from ikservo.hardware.eeprom import backup_text, parse_backup
from ikservo.hardware.port_names import real_time_port
from ikservo.hardware.register_batches import Register
from ikservo.hardware.scan import ScanProgress
from ikservo.hardware.servo import ServoSpec
from ikservo.model import Model
from ikservo.remedies import in_page

_PERIOD_S, _SPAN_S = 0.1, 60  # sample period, and time span of plots
_MAX_WAITING = 8
_POLL_S = 0.1  # period in which closing is noticed


class WorkOnServo(PageMessage):
    """Search the port, or work on one of its servos.

    Attributes:
        names: The registers to plot; empty: the registers of the motion.
        text: The backup to restore.
        address: The new id and baud rate.
        gains: The raw numbers to try, by register.
        step_deg: The step that the joint makes with these gains, degrees.
    """

    kind: Literal["work_on_servo"]
    action: Literal[
        "search", "torque_on", "torque_off", "led_on", "led_off", "reboot", "backup", "restore",
        "move", "plot", "try", "suggest", "stop",
    ]  # fmt: skip
    joint: Name = "-"
    gains: dict[Name, int] = Field(default_factory=dict[Name, int], max_length=8)
    step_deg: Annotated[float, Field(ge=1.0, le=90.0)] = 10.0
    names: list[Name] = Field(default_factory=list[Name], max_length=10)
    text: Annotated[str, Field(max_length=2000)] = ""
    address: tuple[int, int] = Field(default=(0, 0), strict=False)


BenchMessage = ReadServo | WriteRegister | WorkOnServo
_MESSAGES: TypeAdapter[BenchMessage] = TypeAdapter(
    Annotated[BenchMessage, Field(discriminator="kind")]
)
read_bench_message = partial(validate_message, _MESSAGES)
"""Parse and validate a message from the servo page."""


@dataclass(slots=True, eq=False)
class _LivePlot:
    """Registers of one servo over the last minute: numbered rows of times and values."""

    servo: ServoSpec
    registers: Sequence[Register]
    samples: Iterator[Sample]
    rows: deque[tuple[int, float, list[float | None]]] = field(
        default_factory=lambda: deque(maxlen=round(_SPAN_S / _PERIOD_S))
    )

    def take_sample(self) -> None:
        sample, number = next(self.samples), self.rows[-1][0] + 1 if self.rows else 1
        values = sample.values.get(self.servo.id, {})
        factors = {each: shown_unit(each)[1] for each in self.registers}
        row = [round(values[r] * f, 4) if r in values else None for r, f in factors.items()]
        self.rows.append((number, round(sample.time_s, 2), row))

    def series(self) -> dict[str, object]:
        names = [(register.name, shown_unit(register)[0]) for register in self.registers]
        series = [{"quantity": n, "unit": unit, "joint": str(self.servo)} for n, unit in names]
        return {"span_s": _SPAN_S, "series": series}


@dataclass(slots=True)
class _Page:
    """An open page with its permission, sent frames and frames to send."""

    permission: Permission
    sent: dict[str, Frame] = field(default_factory=dict[str, Frame])
    plot: _LivePlot | None = None
    last_row: int = 0
    files: deque[tuple[str, str]] = field(default_factory=deque[tuple[str, str]])


class ServoBench:
    """Backend of the pages that show the servos on a port (``SessionBackend``).

    Args:
        port: The port, as the user named it.
        model: The arm of the servos; None for every servo that replies on the line.
        downloads: Offers backups for download.
    """

    def __init__(self, port: str, model: Model | None, downloads: DownloadOffers) -> None:
        self._model, self._port, self._downloads = model, real_time_port(port), downloads
        self._numbers = itertools.count(1)
        self._pages: dict[int, _Page] = {}
        self._commands: queue.Queue[tuple[int, BenchMessage]] = queue.Queue(_MAX_WAITING)
        self._opened: dict[ServoSpec, Mapping[str, int]] = {}
        self._plot: _LivePlot | None = None
        self._frames: dict[str, Frame] = {}
        self._moved: dict[int, int] = {}
        self._shown: list[dict[str, object]] = []
        self._arm: Arm | None = None
        self._trial: WorkOnServo | None = None
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name="ikservo servos", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop a trial and close the port; torque stays unchanged."""
        self._closing.set()
        self._stop_trial()
        self._thread.join()

    # --- SessionBackend ---

    def connect(self, permission: Permission) -> int:
        """Register a page and return its number."""
        number = next(self._numbers)
        self._pages[number] = _Page(permission)
        return number

    def disconnect(self, client_id: int) -> None:
        """Remove a page."""
        del self._pages[client_id]
        if not self._pages:
            self._plot = None  # no page is left
            self._stop_trial()

    def receive(self, client_id: int, message: BenchMessage) -> None:
        """Queue a request from a page.

        Raises:
            BadMessageError: The request is not permitted, or too many requests are waiting.
        """
        if isinstance(message, WorkOnServo) and message.action == "stop":
            self._stop_trial()
            return
        if self._pages[client_id].permission is not Permission.CONTROL:
            raise BadMessageError("This page can only watch.", "Open the control address.")
        try:
            self._commands.put_nowait((client_id, message))
        except queue.Full:
            raise BadMessageError("The servos are busy.", "Try again in a moment.") from None

    def frames(self, client_id: int) -> list[Frame]:
        """Return the new frames for a page."""
        page, plot = self._pages[client_id], self._plot
        now = dict(self._frames)
        fresh = [each for kind, each in now.items() if page.sent.get(kind) is not each]
        page.sent = now
        while page.files:
            name, text = page.files.popleft()
            url = self._downloads.offer(Download(name, lambda text=text: [text], "text/plain"))
            fresh.append({"kind": "download", "url": url, "name": name})
        if plot is not page.plot:
            page.plot, page.last_row = plot, 0
        rows = [row for row in list(plot.rows) if row[0] > page.last_row] if plot else []
        if plot and rows:
            times, values = [row[1] for row in rows], list(zip(*(r[2] for r in rows), strict=True))
            first = {} if page.last_row else plot.series()
            fresh.append({"kind": "plots", "times": times, "values": values, **first})
            page.last_row = rows[-1][0]
        return fresh

    # --- the thread of the line ---

    def _run(self) -> None:
        while not self._closing.is_set():
            self._plot, trial = None, self._trial
            if trial is not None and self._model is not None:
                self._try_gains(self._model, trial)
            else:
                self._show_line("Searching …", [])
            try:
                with open_servos(self._model, self._port, on_step=self._show_progress) as opened:
                    self._show_servos(line := opened.with_ids(self._moved))
                    if trial is not None:
                        self._show_table(line, line.find(trial.joint))
                    while not self._closing.is_set() and self._work(line):
                        line = opened.with_ids(self._moved) if self._moved else opened
            except IkservoError as error:
                self._show_line(_text(error), [])
                while not self._closing.is_set() and not _is_search(self._next_command(_POLL_S)):
                    pass

    def _next_command(self, wait_s: float) -> tuple[int, BenchMessage] | None:
        try:
            return self._commands.get(wait_s > 0.0, wait_s)
        except queue.Empty:
            return None

    def _work(self, line: ServoLine) -> bool:
        """Handle a request from a page, or take a sample; return False to search the port again."""
        plot = self._plot
        command = self._next_command(0.0 if plot else _POLL_S)
        if _is_search(command):
            return False
        try:
            if command is not None:
                request = command[1]
                if isinstance(request, WorkOnServo) and request.action in ("try", "suggest"):
                    if self._model is None:
                        raise InputError(
                            "Gains can only be tried on a joint of an arm.",
                            "Start the page with the name of the arm: "
                            "ikservo view --servos --arm NAME",
                        )
                    self._trial = request  # the port is closed for it
                    return False
                return self._obey(line, *command)
            if plot is not None:
                plot.take_sample()
        except PortError:
            raise
        except (IkservoError, OSError) as error:
            self._plot = None if command is None else plot
            self._say(_text(error))
        return True

    def _obey(self, line: ServoLine, client_id: int, command: BenchMessage) -> bool:
        servo, note = line.find(command.joint), ""
        match command:
            case WriteRegister(name=name, value=value):
                register = find_register(servo.table, name)
                if not _is_written_here(register.name):
                    raise InputError(f"The page cannot write {register}.")
                note = write_limp(line, servo, {register: parse_register_value(register, value)})
            case WorkOnServo(action="move", address=(new_id, rate)):
                codes = {bits: code for code, bits in servo.table.baud_rates.items()}
                if rate not in codes:
                    raise InputError(f"{servo} does not support {rate} baud.")
                address = {servo.table.id: new_id, servo.table.baud_rate: codes[rate]}
                note = write_limp(line, servo, address)
                if self._model is None:
                    self._say(note)
                    return False
                by_file = {now: own for own, now in self._moved.items()}.get(servo.id, servo.id)
                self._moved[by_file], self._plot = new_id, None
                line = line.with_ids({servo.id: new_id})
                servo = line.find(str(new_id))
                self._show_servos(line)
                note += f" Change id {by_file} in the arm file before the arm moves."
            case WorkOnServo(action="plot", names=names):
                shown = [find_register(servo.table, name) for name in names]
                shown = shown or live_registers(servo.table)
                samples = sample_registers(line.bus, {servo.id: shown}, _PERIOD_S)
                self._plot = _LivePlot(servo, shown, samples)
            case ReadServo():
                pass
            case WorkOnServo(action="restore", text=text):
                note = _restore(line, servo, text)
            case WorkOnServo(action="backup") if page := self._pages.get(client_id):
                name = f"{servo.id:03}_{servo.table.model_name}.toml"
                page.files.append((name, backup_text(line.bus, servo.id)))
            case WorkOnServo(action="reboot"):
                restart_servo(line, servo)
                state = "on" if holds_torque(line, servo) else "off"
                note = f"{servo}: restarted; torque {state}."
            case WorkOnServo(action=action):
                name, _, state = action.partition("_")
                register = find_register(servo.table, {"torque": "torque_enable"}.get(name, name))
                note = write_values(line, servo, {register: int(state == "on")})
        self._show_table(line, servo)
        self._say(note)  # the changes are shown by then
        return True

    # --- trials of gains ---

    def _stop_trial(self) -> None:
        """Stop the joint of a trial and restore its former gains; safe from any thread."""
        self._trial = None
        if (arm := self._arm) is not None:
            arm.stop("Stopped on the servo page.")

    def _try_gains(self, model: Model, trial: WorkOnServo) -> None:
        """Move a joint with its present and other gains, show both, and keep the present gains."""
        self._show_line(f"{trial.joint} is moving …", self._shown)
        try:
            with open_own_arm(model, self._port) as arm:
                self._arm = arm
                if self._trial is trial and not self._closing.is_set():
                    trials = try_on_joint(arm, trial.joint, trial.gains, trial.step_deg,
                                          suggest=trial.action == "suggest")  # fmt: skip
                    self._frames["trial"] = trial_frame(trial.joint, trials)
                    self._say(describe_trials(trials))
        except (IkservoError, OSError) as error:
            self._say(_text(error))
        finally:
            self._arm = self._trial = None

    def _say(self, text: str) -> None:
        self._frames["note"] = {"kind": "note", "text": text}

    def _show_table(self, line: ServoLine, servo: ServoSpec) -> None:
        frame = table_frame(line, servo, "", _is_written_here)
        rows: Sequence[dict[str, Any]] = frame["registers"]
        opened = self._opened.setdefault(servo, {row["name"]: row["raw"] for row in rows})
        for row in rows:
            if row["writable"] and opened[row["name"]] != row["raw"]:
                row["first"] = opened[row["name"]]
        torque, rates = holds_torque(line, servo), list(servo.table.baud_rates.values())
        self._frames["servo"] = {
            **frame,
            "torque": torque,
            "baud_rates": rates,
            "baud_rate": line.bus.port.baudrate,
            "led": "led" in servo.table.registers,
            "tunable": tunable_names(servo) if self._model else [],
        }

    def _show_progress(self, progress: ScanProgress) -> None:
        if self._closing.is_set():
            raise InputError("The page was closed.")
        share = progress.pinged / progress.ids
        self._show_line(f"{progress.baud_rate} baud, {progress.protocol}: {share:.0%}", [], share)

    def _show_servos(self, line: ServoLine) -> None:
        """Show the servos that reply, and their firmware."""
        rows: list[dict[str, object]] = []
        for servo in line.bus.servos.values():
            try:
                _, firmware = identify_servo(line, servo)
            except PortError:
                raise
            except IkservoError:
                firmware = "no reply"
            name, model = servo.name or str(servo.id), servo.table.model_name
            rows.append({"name": name, "id": servo.id, "model": model, "firmware": firmware})
        self._shown = rows
        self._show_line("", rows)

    def _show_line(
        self, text: str, servos: list[dict[str, object]], done: float | None = None
    ) -> None:
        port = (self._port or "").partition("?")[0]
        line = {"port": port, "text": text, "done": done, "servos": servos}
        self._frames["line"] = {"kind": "line", **line}


def _is_search(command: tuple[int, BenchMessage] | None) -> bool:
    return command is not None and getattr(command[1], "action", "") == "search"


def _text(error: Exception) -> str:
    if not isinstance(error, IkservoError):
        return str(error)
    return f"{error.message} {in_page(error.command_hint)}".strip()


def _is_written_here(name: str) -> bool:
    return not name.startswith("goal_") and name not in ("torque_enable", "lock", "id", "baud_rate")


def _restore(line: ServoLine, servo: ServoSpec, text: str) -> str:
    """Write a backup; describe the written and the skipped registers."""
    backup = parse_backup(Path("backup.toml"), text)
    plan = plan_restoration(line.bus, backup, str(servo.id))
    write_restoration(line.bus, plan)
    written = ", ".join(map(str, plan.changes))
    kept = ", ".join(str(each.register) for each in plan.kept)
    left = f"; unchanged: {kept}" if kept else ""
    return f"{servo}: {written or 'nothing to change'}{left}."
