"""Several registers in one answer: neighbours are read together."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence

from ikservo.registers import Register

__all__ = ["READ_OVER", "neighbours", "rounds", "written"]


READ_OVER = 8
"""Bytes between two registers that cost no more than a second question to six servos."""


def neighbours(registers: Iterable[Register], gap: int = 0) -> list[list[Register]]:
    """Return the registers in runs, each of which one read covers.

    Args:
        registers: Of one servo.
        gap: How many bytes that nobody wants may lie between two of a run. What may change by
            itself and what may not are kept apart then, for the one is read twice on a bad line.
    """
    rows = list(registers)
    if len(rows) == 1:
        return [rows]
    runs: list[list[Register]] = []
    for register in sorted(set(rows), key=lambda r: r.address):
        if runs and _joins(runs[-1][-1], register, gap):
            runs[-1].append(register)
        else:
            runs.append([register])
    return runs


def _joins(last: Register, register: Register, gap: int) -> bool:
    between = register.address - last.end
    return between == 0 or (0 < between <= gap and last.steady is register.steady)


def rounds(
    own: Mapping[int, Collection[Register]], gap: int = 0
) -> Iterator[dict[int, list[Register]]]:
    """Yield for each round of questions the run of neighbours that each servo is asked for.

    Args:
        own: The registers of each servo that are wanted, by id.
        gap: See ``neighbours``.
    """
    runs = {servo_id: neighbours(registers, gap) for servo_id, registers in own.items()}
    for k in range(max((len(r) for r in runs.values()), default=0)):
        yield {servo_id: r[k] for servo_id, r in runs.items() if k < len(r)}


def written(data: Mapping[Register, bytes], run: Sequence[Register]) -> bytes:
    """Return the bytes that one write to a run of neighbours carries."""
    return b"".join(data[register] for register in run)
