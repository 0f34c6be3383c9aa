"""What a command prints: one JSON object, or tables and lines for a person."""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, is_dataclass
from typing import Any

__all__ = ["note", "point", "print_json", "print_lines", "print_table"]


_QUANTITY = re.compile(r"[-+]?[\d.]+( ?[°%]| mm| ms)?")
# Off a terminal a row stays one line, however long it is.
_WIDE = 1000


def print_json(schema: str, **fields: object) -> None:
    """Print one object on stdout; ``schema`` is the name of its kind, ``where`` or ``move``."""
    answer = {"schema": f"ikservo/{schema}/1", **fields}
    print(json.dumps(answer, default=_plain, ensure_ascii=False))  # noqa: T201


def print_lines(lines: Iterable[str]) -> None:
    """Print lines of data on stdout."""
    for line in lines:
        print(line)  # noqa: T201


def print_table(columns: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    """Print a table on stdout; columns of numbers are set flush right."""
    from rich.console import Console  # noqa: PLC0415
    from rich.table import Table  # noqa: PLC0415

    rows = [list(row) for row in rows]
    table = Table(box=None, pad_edge=False, header_style="bold")
    for i, column in enumerate(columns):
        right = bool(rows) and all(_QUANTITY.fullmatch(row[i]) for row in rows)
        table.add_column(column, justify="right" if right else "left", overflow="fold")
    for row in rows:
        table.add_row(*row)
    width = None if sys.stdout.isatty() else _WIDE
    Console(width=width, markup=False, highlight=False).print(table)


def note(message: str) -> None:
    """Tell the person something that is not data, on stderr."""
    print(message, file=sys.stderr)  # noqa: T201


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
