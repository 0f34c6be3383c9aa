"""Several registers in one answer: neighbours are read together."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence

from ikservo.registers import Register

__all__ = ["neighbours", "rounds", "written"]


def neighbours(registers: Iterable[Register]) -> list[list[Register]]:
    """Return the registers in runs without a gap, each of which one read covers."""
    rows = list(registers)
    if len(rows) == 1:
        return [rows]
    runs: list[list[Register]] = []
    for register in sorted(set(rows), key=lambda r: r.address):
        if runs and runs[-1][-1].end == register.address:
            runs[-1].append(register)
        else:
            runs.append([register])
    return runs


def rounds(own: Mapping[int, Collection[Register]]) -> Iterator[dict[int, list[Register]]]:
    """Yield for each round of questions the run of neighbours that each servo is asked for.

    Args:
        own: The registers of each servo that are wanted, by id.
    """
    runs = {servo_id: neighbours(registers) for servo_id, registers in own.items()}
    for k in range(max((len(r) for r in runs.values()), default=0)):
        yield {servo_id: r[k] for servo_id, r in runs.items() if k < len(r)}


def written(data: Mapping[Register, bytes], run: Sequence[Register]) -> bytes:
    """Return the bytes that one write to a run of neighbours carries."""
    return b"".join(data[register] for register in run)
