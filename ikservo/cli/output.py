"""What a command prints: one JSON object, or tables and lines for a person."""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, is_dataclass
from typing import Any

from ikservo.cli.folding import folded, width_of

__all__ = ["note", "point", "port_words", "print_json", "print_lines", "print_table"]


_QUANTITY = re.compile(r"[-+]?[\d.]+( ?[°%]| mm| ms)?")
# Off a terminal a row stays one line, however long it is.
_WIDE = 1000


def print_json(schema: str, **fields: object) -> None:
    """Print one object on stdout; ``schema`` is the name of its kind, ``where`` or ``move``."""
    answer = {"schema": f"ikservo/{schema}/1", **fields}
    print(json.dumps(answer, default=_plain, ensure_ascii=False))  # noqa: T201


def print_lines(lines: Iterable[str], indent: int = 0) -> None:
    """Print lines of data on stdout, folded on a terminal; all but the first of each indented."""
    for line in lines:
        print(folded(line, sys.stdout, indent))  # noqa: T201


def print_table(columns: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    """Print a table on stdout; columns of numbers are set flush right.

    Columns at the right that do not fit a terminal are printed below each row instead.
    """
    from rich.console import Console  # noqa: PLC0415
    from rich.table import Table  # noqa: PLC0415

    rows = [list(row) for row in rows]
    terminal = width_of(sys.stdout)
    fitting = len(columns) if terminal is None else _fitting(columns, rows, terminal)
    table = Table(box=None, pad_edge=False, header_style="bold")
    for i, column in enumerate(columns[:fitting]):
        right = bool(rows) and all(_QUANTITY.fullmatch(row[i]) for row in rows)
        table.add_column(column, justify="right" if right else "left", no_wrap=True)
    for row in rows:
        table.add_row(*row[:fitting])
    console = Console(width=terminal or _WIDE, markup=False, highlight=False)
    if fitting == len(columns):
        console.print(table)
        return
    with console.capture() as capture:
        console.print(table)
    head, *printed = capture.get().splitlines()
    print(head)  # noqa: T201  # in bold, whose codes take no columns
    for line, row in zip(printed, rows, strict=True):
        rest = zip(columns[fitting:], row[fitting:], strict=True)
        words = ", ".join(f"{column} {value}" for column, value in rest if value)
        print_lines([line.rstrip(), *([f"    {words}"] if words else [])], indent=4)


def _fitting(columns: Sequence[str], rows: Sequence[Sequence[str]], width: int) -> int:
    """Return how many columns fit a width, two spaces between them; at least one."""
    used = 0
    for i, column in enumerate(columns):
        used += max(len(text) for text in (column, *(row[i] for row in rows))) + 2 * (i > 0)
        if used > width:
            return max(i, 1)
    return len(columns)


def note(message: str) -> None:
    """Tell the person something that is not data, on stderr."""
    print(folded(message, sys.stderr), file=sys.stderr)  # noqa: T201


def port_words(port: str) -> str:
    """Return a port's name as a person gave it; a simulated one without its arm file."""
    return "sim" if port.startswith("sim:") else port


def point(position_m: Sequence[float]) -> str:
    """Return ``(0.250, 0.050, 0.150) m``."""
    return f"({', '.join(f'{x:z.3f}' for x in position_m)}) m"


def _plain(value: Any) -> object:  # noqa: ANN401
    """Return what JSON can say of arrays, dataclasses and mappings."""
    if hasattr(value, "tolist"):
        return value.tolist()
    if is_dataclass(value) and not isinstance(value, type):
        return asdict(value)
    if isinstance(value, Mapping):
        return dict(value)  # pyright: ignore[reportUnknownArgumentType, reportUnknownVariableType]
    return str(value)
