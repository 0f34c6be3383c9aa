"""Measurements as markdown tables: ratios first, because times differ between machines."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from decimal import Decimal

from judging import Score

__all__ = ["Row", "missing_table", "speed_table"]

_ROUNDS = ("home", "near", "line")
_OURS = "ikservo"
_COLUMNS = (
    "arm",
    "target",
    "solver",
    "median, ours / theirs",
    "success %",
    "median µs",
    "p95 µs",
    "p99 µs",
    "largest step °",
    "batch/s",
)


@dataclass(frozen=True)
class Row:
    """One solver on one arm and kind of target.

    Attributes:
        scores: Score by round.
        batch_hz: Solves per second of its own batch call; None if it has none.
    """

    arm: str
    dof: int
    kind: str
    solver: str
    version: str
    scores: dict[str, Score]
    batch_hz: float | None


def speed_table(rows: list[Row]) -> str:
    """Return the table; a cell with three numbers means from home / from near / along lines."""
    lines = [_line(_COLUMNS), "|---|---|---|" + "---:|" * (len(_COLUMNS) - 3)]
    ours = {(row.arm, row.kind): row for row in rows if row.solver == _OURS}
    lines += [_line(_cells(row, ours.get((row.arm, row.kind)))) for row in rows]
    return "\n".join(lines) + "\n"


def missing_table(refusals: Iterable[tuple[str, str, str, str]]) -> str:
    """Return a table of the missing measurements, from (solver, arm, kind, reason)."""
    where: dict[tuple[str, str], list[str]] = {}
    for solver, arm, kind, reason in refusals:
        where.setdefault((solver, reason), []).append(f"{arm} {kind}")
    lines = [_line(("solver", "reason", "where")), "|---|---|---|"]
    lines += [_line((solver, why, ", ".join(at))) for (solver, why), at in where.items()]
    return "\n".join(lines) + "\n" if where else ""


def _cells(row: Row, ours: Row | None) -> list[str]:
    return [
        f"{row.arm} ({row.dof})",
        row.kind,
        f"{row.solver} {row.version}",
        _each(row, lambda name, score: _ratio(ours, name, score)),
        _each(row, lambda _, score: _success(score)),
        _each(row, lambda _, score: _short(score.median_us)),
        _each(row, lambda _, score: _short(score.p95_us)),
        _each(row, lambda _, score: _short(score.p99_us)),
        _short(math.degrees(row.scores["line"].largest_step_rad)) if "line" in row.scores else "–",
        "–" if row.batch_hz is None else f"{row.batch_hz:,.0f}",
    ]


def _each(row: Row, say: Callable[[str, Score], str]) -> str:
    names = [name for name in _ROUNDS if name in row.scores]
    return " / ".join(say(name, row.scores[name]) for name in names)


def _ratio(ours: Row | None, name: str, score: Score) -> str:
    if ours is None:
        return "–"
    return f"{Decimal(f'{ours.scores[name].median_us / score.median_us:.2g}'):f}"


def _success(score: Score) -> str:
    """Return per cent, rounded down, and the number of targets if the time was up early."""
    percent = f"{math.floor(score.success * 1000) / 10:g}"
    return percent if score.asked == score.targets else f"{percent} of {score.asked}"


def _short(number: float) -> str:
    return f"{number:.3g}" if number < 1000 else f"{number:,.0f}"


def _line(cells: Iterable[str]) -> str:
    return f"| {' | '.join(cells)} |"
