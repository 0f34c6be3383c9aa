"""An arm that has been let go, so that a person can move it while its servos are read."""

from __future__ import annotations

from collections.abc import Collection, Generator, Iterator, Mapping
from contextlib import contextmanager
from datetime import datetime
from importlib.metadata import version
from pathlib import Path

from ikservo.arm.line import open_line
from ikservo.arm.own import check_models, holds_free, serial_number_of, within_a_turn
from ikservo.calibration import Limits
from ikservo.calibration.filing.calibration_file import text_of
from ikservo.calibration.filing.store import calibration_path, journal_path, partial_path
from ikservo.calibration.in_servos.compare import contradictions_with, refuse
from ikservo.calibration.in_servos.memory import ServoFacts, facts_of
from ikservo.calibration.in_servos.transaction import changes_for, commit, settle
from ikservo.calibration.sweeping.homing import Travel, bare_tick
from ikservo.calibration.sweeping.outcome import About, Outcome, conclude
from ikservo.calibration.sweeping.subject import Subject
from ikservo.calibration.sweeping.sweep import Wizard
from ikservo.calibration.ticks.encoder import encoder_of
from ikservo.hardware.bus import ServoBus
from ikservo.hardware.torque import torque_off
from ikservo.model import Model, ModelJoint
from ikservo.registers import Role

__all__ = ["LooseArm", "loose_arm"]

READ_EVERY_S = 0.02
_MOST_FAILURES = 25


class LooseArm:
    """The servos of an arm while it is calibrated; see ``loose_arm``.

    Attributes:
        model: What the arm file says.
        bus: The line.
        facts: Every servo as it was found, by id.
        serial_number: Of the USB adapter; empty where it has none.
        settled: What was cleared up of an earlier calibration; empty where nothing was.
    """

    def __init__(self, model: Model, bus: ServoBus, *, settled: bool = True) -> None:
        self.model, self.bus = model, bus
        self.serial_number = serial_number_of(bus.port.name)
        self.settled = settle(bus, self.journal_path) if settled else ""
        self.facts = {servo_id: facts_of(bus, servo_id) for servo_id in bus.servos}
        self._failures = 0
        self._next_s = bus.clock.now_s()

    @property
    def path(self) -> Path:
        """Return where its calibration lies."""
        return calibration_path(self.model.name, self.serial_number)

    @property
    def journal_path(self) -> Path:
        """Return where it is noted what is being written."""
        return journal_path(self.model.name, self.serial_number)

    @property
    def partial_path(self) -> Path:
        """Return where an interrupted self-calibration keeps the joints it has measured."""
        return partial_path(self.model.name, self.serial_number)

    def subjects(
        self,
        pose: str,
        known: Mapping[str, Travel] | None = None,
        only: Collection[str] = (),
    ) -> list[Subject]:
        """Return the joints to be calibrated from a named pose; all of them if ``only`` is empty.

        Raises:
            UnknownNameError: The arm has no such pose.
        """
        positions = self.model.pose(pose)
        return [
            self._subject(joint, positions[joint.name], (known or {}).get(joint.name))
            for joint in self.model.joints
            if not only or joint.name in only
        ]

    def holding(self) -> list[str]:
        """Return the servos whose torque is on."""
        torque = self.bus.sync_read(self.bus.servos, Role.TORQUE_ENABLE, raw=True).complete()
        return [str(self.bus.servos[i]) for i, on in torque.items() if on]

    def let_go(self) -> None:
        """Switch torque off; whoever calibrates holds the arm.

        Raises:
            BusError: A servo did not hear; the others are off.
        """
        for error in torque_off(self.bus, self.bus.servos).values():
            raise error

    def read(self) -> tuple[float, dict[int, int]] | None:
        """Wait for the next beat; return time [s] and bare ticks by id, or None if one is missing.

        Raises:
            BusError: Servos have been silent for half a second.
        """
        reading = self.read_reported()
        if reading is None:
            return None
        at_s, ticks = reading
        return at_s, {i: _bare(self.facts[i], tick) for i, tick in ticks.items()}

    def read_reported(self) -> tuple[float, dict[int, int]] | None:
        """Wait for the next beat; return time [s] and ticks as the servos report them by id.

        Raises:
            BusError: Servos have been silent for half a second.
        """
        clock = self.bus.clock
        clock.sleep_until(self._next_s)
        self._next_s = max(self._next_s + READ_EVERY_S, clock.now_s())
        readings = self.bus.sync_read(self.bus.servos, Role.PRESENT_POSITION, raw=True)
        self._failures = self._failures + 1 if readings.errors else 0
        if self._failures > _MOST_FAILURES:
            readings.complete()
        if readings.errors:
            return None
        return clock.now_s(), dict(readings.values)

    def conclude(
        self,
        wizard: Wizard,
        pose: str,
        written: datetime,
        *,
        write_limits: bool = False,
        user: Mapping[str, Limits] | None = None,
        facts: Mapping[int, ServoFacts] | None = None,
    ) -> Outcome:
        """Work out the calibration; see ``ikservo.calibration.sweeping.outcome``.

        ``facts`` is how the servos should be taken to be, where that is not as they were found.
        """
        about = About(
            arm=self.model.name,
            written=written.replace(microsecond=0),
            tool_version=version("ikservo"),
            usb_serial_number=self.serial_number,
            family=next(iter(self.facts.values())).table.family,
            anchor_pose=pose,
        )
        found = facts or self.facts
        return conclude(wizard, found, about, write_limits=write_limits, user=user)

    def cut_by_servos(self, outcome: Outcome) -> Iterator[str]:
        """Yield whose range the servo's own limits would cut, one line each."""
        for joint in self.model.joints:
            own = outcome.calibration.joint(joint.name)
            if own is None or own.extended:
                continue
            joint_map = own.joint_map(joint.joint_map)
            limits = outcome.calibration.narrowed(own, joint.limits)
            held = [own.servo.holds[name] for name in _limit_names(self.facts[own.servo.id])]
            if any(held) and not holds_free(joint_map, limits, (held[0], held[1])):
                yield (
                    f"{joint.name}: its servo's own limits, {held[0]} to {held[1]}, are narrower "
                    "than the range found; replace them with --write-limits."
                )

    def save(self, outcome: Outcome) -> Path:
        """Write the servos and the file as one, read everything back, and return the file.

        Raises:
            IkservoError: It failed; either nothing is changed, or the message says how to go on.
        """
        changes = changes_for(self.bus, outcome.memory)
        text = text_of(outcome.calibration)
        commit(self.bus, self.journal_path, self.path, text, changes)
        self.facts = {servo_id: facts_of(self.bus, servo_id) for servo_id in self.bus.servos}
        refuse(contradictions_with(outcome.calibration, self.facts))
        return self.path

    def _subject(self, joint: ModelJoint, pose: float, known: Travel | None) -> Subject:
        encoder = encoder_of(self.bus.servos[joint.servo.id].table)
        shadows = tuple(servo.id for servo in joint.shadows)
        turn = encoder.ticks if encoder.wraps else 0
        expected = within_a_turn(joint.limits, joint.joint_map, encoder)
        return Subject(joint.joint_map, turn, expected, pose, shadows, known)


@contextmanager
def loose_arm(model: Model, port: str | None, *, settled: bool = True) -> Generator[LooseArm]:
    """Open an arm for calibration; torque stays as it is until ``let_go``.

    Args:
        model: The arm.
        port: See ``choose_port``.
        settled: Whether a writing that was broken off must be cleared up first.

    Raises:
        PortError: No port, or it cannot be opened.
        ServoSilentError: A servo does not answer; names all that do not.
        CalibrationError: A servo is of another model, or a calibration is half written.
    """
    with open_line(model, port) as bus:
        check_models(bus)
        bus.learn_return_delays()
        yield LooseArm(model, bus, settled=settled)


def _limit_names(facts: ServoFacts) -> tuple[str, str]:
    table = facts.table
    low, high = table.find(Role.MIN_POSITION_LIMIT), table.find(Role.MAX_POSITION_LIMIT)
    return low.name, high.name


def _bare(facts: ServoFacts, tick: int) -> int:
    return bare_tick(facts.table.family, tick, facts.offset, encoder_of(facts.table))
