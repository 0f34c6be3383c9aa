"""A reading of many servos, thought through once and then carried out every cycle."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache

from ikservo.hardware.packets.block import READ_OVER, rounds
from ikservo.hardware.packets.layout import Layout, is_telling
from ikservo.hardware.packets.notation import Wanted, own_register
from ikservo.hardware.packets.span import Span
from ikservo.hardware.servo import ServoSpec
from ikservo.registers import Access, Area, Family, Register

__all__ = ["Cell", "Plan", "Round", "plan_reading", "plan_writing"]


@dataclass(frozen=True, slots=True)
class Round:
    """What can be asked at one time.

    Attributes:
        servos: Whom.
        spans: What memory, by id.
        layouts: Where in it stands what, by id.
        asked: The same in words.
        steady: Nothing of it changes by itself.
        groups: The spans of each family, which has its own questions.
    """

    servos: Sequence[ServoSpec]
    spans: Mapping[int, Span]
    layouts: Mapping[int, Layout]
    asked: str
    steady: bool
    groups: Mapping[Family, Mapping[int, Span]]

    def only(self, servos: Sequence[ServoSpec]) -> Round:
        """Return the same for some of the servos."""
        groups = _by_family(servos, self.spans)
        return Round(servos, self.spans, self.layouts, self.asked, self.steady, groups)


@dataclass(frozen=True, slots=True)
class Plan:
    """All rounds of a reading, and whom it concerns."""

    servo_ids: Sequence[int]
    rounds: Sequence[Round]


@dataclass(frozen=True, slots=True)
class Cell:
    """One servo's own register of a writing.

    Attributes:
        telling: See ``is_telling``.
        plain: Any integer in its range may be written at any time.
    """

    servo: ServoSpec
    register: Register
    telling: bool
    plain: bool


def plan_writing(servos: Iterable[ServoSpec], wanted: Wanted) -> list[Cell]:
    """Return the servos' own registers for what is to be written.

    Raises:
        UnknownNameError: A servo has no such register.
    """
    own = [(servo, own_register(servo, wanted)) for servo in servos]
    return [Cell(servo, r, is_telling(servo, r), _is_plain(r)) for servo, r in own]


def _is_plain(register: Register) -> bool:
    return register.access is Access.RW and register.area is Area.RAM


def plan_reading(wanted: Mapping[ServoSpec, Sequence[Wanted]]) -> Plan:
    """Return how to read of each servo its own registers.

    Raises:
        UnknownNameError: A servo has no such register.
    """
    own = {
        servo.id: {key: own_register(servo, key) for key in keys} for servo, keys in wanted.items()
    }
    servos = {servo.id: servo for servo in wanted}
    runs_of_rounds = rounds({i: row.values() for i, row in own.items()}, READ_OVER)
    return Plan(tuple(servos), [_round(servos, own, runs) for runs in runs_of_rounds])


def _round(
    servos: Mapping[int, ServoSpec],
    own: Mapping[int, Mapping[Wanted, Register]],
    runs: Mapping[int, Sequence[Register]],
) -> Round:
    first, asked = next(iter(runs.values())), [servos[i] for i in runs]
    spans = {i: _span(run[0].address, run[-1].end) for i, run in runs.items()}
    return Round(
        servos=asked,
        spans=spans,
        layouts={i: Layout(servos[i], own[i], run) for i, run in runs.items()},
        asked=f"read {', '.join(register.name for register in first)}",
        steady=all(register.steady for run in runs.values() for register in run),
        groups=_by_family(asked, spans),
    )


@cache
def _span(address: int, end: int) -> Span:
    """Return the same object for equal stretches: it is compared every cycle."""
    return Span(address, end - address)


def _by_family(
    servos: Iterable[ServoSpec], spans: Mapping[int, Span]
) -> Mapping[Family, Mapping[int, Span]]:
    groups: dict[Family, dict[int, Span]] = {}
    for servo in servos:
        groups.setdefault(servo.table.family, {})[servo.id] = spans[servo.id]
    return groups
