"""Terminal output and input: JSON, tables, progress bars, single keys."""

from __future__ import annotations

import json
import os
import re
import sys
from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, is_dataclass
from typing import Any

from ikservo.cli.text_wrapping import fold_for_stream, terminal_width

__all__ = [
    "Keys",
    "Show",
    "format_point",
    "format_port",
    "print_json",
    "print_lines",
    "print_status",
    "print_table",
    "progress_bar",
    "read_keys",
]


_QUANTITY = re.compile(r"[-+]?[\d.]+( ?[°%]| mm| ms)?")
# Off a terminal a row stays one line, however long it is.
_WIDE = 1000


def print_json(schema: str, **fields: object) -> None:
    """Print one object on stdout; ``schema`` is the name of its kind, ``where`` or ``move``."""
    answer = {"schema": f"ikservo/{schema}/1", **fields}
    print(json.dumps(answer, default=_to_json_value, ensure_ascii=False))  # noqa: T201


def print_lines(lines: Iterable[str], indent: int = 0) -> None:
    """Print lines of data on stdout, folded on a terminal; all but the first of each indented."""
    for line in lines:
        print(fold_for_stream(line, sys.stdout, indent))  # noqa: T201


def print_table(columns: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    """Print a table on stdout; columns of numbers are set flush right.

    Columns at the right that do not fit a terminal are printed below each row instead.
    """
    from rich.console import Console  # noqa: PLC0415
    from rich.table import Table  # noqa: PLC0415

    rows = [list(row) for row in rows]
    terminal = terminal_width(sys.stdout)
    fitting = len(columns) if terminal is None else _count_fitting_columns(columns, rows, terminal)
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


def _count_fitting_columns(
    columns: Sequence[str], rows: Sequence[Sequence[str]], width: int
) -> int:
    """Return how many columns fit a width, two spaces between them; at least one."""
    used = 0
    for i, column in enumerate(columns):
        used += max(len(text) for text in (column, *(row[i] for row in rows))) + 2 * (i > 0)
        if used > width:
            return max(i, 1)
    return len(columns)


def print_status(message: str) -> None:
    """Tell the person something that is not data, on stderr."""
    print(fold_for_stream(message, sys.stderr), file=sys.stderr)  # noqa: T201


def format_port(port: str) -> str:
    """Return a port's name as a person gave it; a simulated one without its arm file."""
    return "sim" if port.startswith("sim:") else port


def format_point(position_m: Sequence[float]) -> str:
    """Return ``(0.250, 0.050, 0.150) m``."""
    return f"({', '.join(f'{x:z.3f}' for x in position_m)}) m"


def _to_json_value(value: Any) -> object:  # noqa: ANN401
    """Return what JSON can say of arrays, dataclasses and mappings."""
    if hasattr(value, "tolist"):
        return value.tolist()
    if is_dataclass(value) and not isinstance(value, type):
        return asdict(value)
    if isinstance(value, Mapping):
        return dict(value)  # pyright: ignore[reportUnknownArgumentType, reportUnknownVariableType]
    return str(value)


Show = Callable[[str, float, float], None]
"""Takes what is being done, how much of it is done, and how much there is."""


@contextmanager
def progress_bar() -> Generator[Show | None]:
    """Yield what draws a progress bar, or None where nobody would see it."""
    if not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console  # noqa: PLC0415
    from rich.progress import BarColumn, TextColumn  # noqa: PLC0415
    from rich.progress import Progress as Bar  # noqa: PLC0415

    columns = (BarColumn(), TextColumn("{task.description}"))
    with Bar(*columns, console=Console(stderr=True), transient=True) as drawn:
        task = drawn.add_task("", total=None)

        def show(what: str, done: float, total: float) -> None:
            drawn.update(task, description=what, completed=done, total=total)

        yield show


Keys = Callable[[], str]
"""Returns the keys that were pressed since the last call, in order; empty for none."""

_MAX_KEY_BYTES = 1024
# Arrow and function keys arrive as several characters, whose letters must not pass for keys.
_ESCAPE_SEQUENCE = re.compile("\x1b(\\[[0-?]*[ -/]*[@-~]|O.|.)?", re.DOTALL)


@contextmanager
def read_keys() -> Generator[Keys]:
    """Yield a function that returns the keys pressed since its last call.

    What was typed before is discarded, as is what is left unread at the end; the terminal is then
    set back.
    """
    if sys.platform == "win32":
        _windows_keys()
        yield _windows_keys
        return
    import termios  # noqa: PLC0415  # there is none on Windows
    import tty  # noqa: PLC0415

    before = termios.tcgetattr(sys.stdin)
    try:
        tty.setcbreak(sys.stdin, termios.TCSAFLUSH)  # Ctrl-C still interrupts
        yield _posix_keys
    finally:
        termios.tcsetattr(sys.stdin, termios.TCSAFLUSH, before)


def _posix_keys() -> str:
    import select  # noqa: PLC0415

    # Read from the descriptor itself: `sys.stdin` would read ahead and hide keys from `select`.
    descriptor = sys.stdin.fileno()
    if not select.select([descriptor], [], [], 0)[0]:
        return ""
    typed = os.read(descriptor, _MAX_KEY_BYTES).decode("utf-8", "ignore")
    return _ESCAPE_SEQUENCE.sub("", typed)


def _windows_keys() -> str:
    import msvcrt  # noqa: PLC0415  # there is none elsewhere

    typed = ""
    while msvcrt.kbhit():  # pyright: ignore[reportUnknownMemberType, reportAttributeAccessIssue]
        key: str = msvcrt.getwch()  # pyright: ignore[reportUnknownMemberType, reportAttributeAccessIssue, reportUnknownVariableType]
        typed = f"{typed}{key}"
    return typed
