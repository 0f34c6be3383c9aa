"""Several registers in one answer: neighbours are read together."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence

from ikservo.registers import Register

__all__ = ["decoded", "neighbours", "rounds"]


def neighbours(registers: Iterable[Register]) -> list[list[Register]]:
    """Return the registers in runs without a gap, each of which one read covers."""
    runs: list[list[Register]] = []
    for register in sorted(set(registers), key=lambda r: r.address):
        if runs and runs[-1][-1].end == register.address:
            runs[-1].append(register)
        else:
            runs.append([register])
    return runs


def rounds(own: Mapping[int, Sequence[Register]]) -> Iterator[dict[int, list[Register]]]:
    """Yield for each round of questions the run of neighbours that each servo is asked for.

    Args:
        own: The registers wanted of each servo, by id.
    """
    runs = {servo_id: neighbours(registers) for servo_id, registers in own.items()}
    for k in range(max((len(r) for r in runs.values()), default=0)):
        yield {servo_id: r[k] for servo_id, r in runs.items() if k < len(r)}


def decoded(block: bytes, run: Sequence[Register]) -> dict[Register, int]:
    """Return the raw numbers in a block that begins with the first register of a run."""
    start = run[0].address
    return {r: r.decode(block[r.address - start : r.end - start]) for r in run}
