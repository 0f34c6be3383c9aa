"""Terminal output and input: JSON, tables, folded lines, progress bars, keys, prompts.

A prompt discards input typed before it was printed, because a key meant for an earlier prompt must
not let an arm move or go limp. For the same reason no prompt has a default answer.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import re
import shutil
import sys
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, is_dataclass
from typing import TYPE_CHECKING, Any, TextIO

from ikservo.errors import CONTROL, printable

if TYPE_CHECKING:
    from rich.console import Console, ConsoleOptions, RenderableType
    from rich.segment import Segment

# A command starts at `ikservo` or another program's name and ends at punctuation.
_COMMAND = re.compile(r"(?:ikservo|sudo|pip|xacro)\s")
_ENDS = (".", ",", ";", ":", ")", "?")

_QUANTITY = re.compile(r"[-+]?[\d.]+( ?[°%]| mm| ms)?")
# If stdout is not a terminal, rows are not folded.
_WIDE = 1000

_ANSWERS = {"y": True, "yes": True, "n": False, "no": False}
_MAX_ANSWER_BYTES = 4096


def terminal_width(stream: TextIO) -> int | None:
    """Return the width of a terminal in columns; None for other streams, which are not folded."""
    if not stream.isatty():
        return None
    columns = os.environ.get("COLUMNS", "")
    if columns.isdigit() and int(columns):
        return int(columns)
    try:
        return os.get_terminal_size(stream.fileno()).columns or None
    except (OSError, ValueError):
        return shutil.get_terminal_size().columns


def fold_for_stream(text: str, stream: TextIO = sys.stderr, indent: int = 0) -> str:
    """Return printable text, folded if the stream is a terminal; see `fold`."""
    text, width = printable(text), terminal_width(stream)
    if width is None:
        return text
    return "\n".join("\n".join(fold(line, width, indent)) for line in text.split("\n"))


def fold(line: str, width: int, indent: int = 0) -> list[str]:
    """Fold one line into lines of at most ``width`` columns.

    Spaces at the start are kept; ``indent`` is the indentation of all lines but the first. A word
    that is longer than a line, such as a path, gets a line of its own and is not split.
    """
    if len(line) <= width:
        return [line]
    lead = line[: len(line) - len(line.lstrip())]
    lines, current = list[str](), lead
    for chunk in _split_words(line[len(lead) :], width - max(indent, len(lead))):
        joined = f"{current} {chunk}" if current.strip() else f"{current}{chunk}"
        if len(joined) > width and current.strip():
            lines.append(current)
            joined = " " * max(indent, len(lead)) + chunk
        current = joined
    return [*lines, current]


def _split_words(text: str, width: int) -> Iterator[str]:
    """Yield words, with a command that fits a line as one word; runs of spaces are kept."""
    words = re.findall(r"\S+(?:\s+(?=\s))?", text)
    at = 0
    while at < len(words):
        end = at + 1
        if _COMMAND.match(words[at].lstrip("('") + " "):
            ends = (i + 1 for i in range(at, len(words)) if words[i].rstrip().endswith(_ENDS))
            end = next(ends, len(words))
        chunk = " ".join(words[at:end])
        if len(chunk) > width:
            chunk, end = words[at], at + 1
        yield chunk.rstrip() if end == len(words) else chunk
        at = end


def print_json(schema: str, **fields: object) -> None:
    """Print one JSON object on stdout; ``schema`` is its name, such as ``move``.

    Control characters are escaped, because a terminal would execute them. The output is flushed,
    because a program at the other end of a pipe may wait for it while the command runs.
    """
    named = {"schema": f"ikservo/{schema}/1", **fields}
    text = json.dumps(named, default=_to_json_value, ensure_ascii=False)
    print(CONTROL.sub(lambda found: f"\\u{ord(found[0]):04x}", text), flush=True)  # noqa: T201


def print_lines(lines: Iterable[str], indent: int = 0) -> None:
    """Print lines on stdout, folded on a terminal with continuation lines indented."""
    for line in lines:
        print(fold_for_stream(line, sys.stdout, indent))  # noqa: T201


def print_table(columns: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    """Print a table on stdout; columns of numbers are right-aligned.

    Columns at the right that do not fit a terminal are printed below each row instead.
    """
    from rich.console import Console  # noqa: PLC0415
    from rich.table import Table  # noqa: PLC0415

    rows = [[printable(text) for text in row] for row in rows]
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
    """Count the columns that fit into a width with two spaces between them; at least one."""
    used = 0
    for i, column in enumerate(columns):
        used += max(len(text) for text in (column, *(row[i] for row in rows))) + 2 * (i > 0)
        if used > width:
            return max(i, 1)
    return len(columns)


def open_console(*, stderr: bool = False) -> Console:
    """Return a Rich console that prints no control characters of its input."""
    from rich.console import Console  # noqa: PLC0415
    from rich.segment import Segment  # noqa: PLC0415

    class PrintableConsole(Console):
        def render(
            self, renderable: RenderableType, options: ConsoleOptions | None = None
        ) -> Iterable[Segment]:
            for segment in super().render(renderable, options):
                yield (
                    segment if segment.control else Segment(printable(segment.text), segment.style)
                )

    return PrintableConsole(stderr=stderr, highlight=False)


def print_text(text: str) -> None:
    """Print text unchanged on stdout, except for unprintable characters on a terminal."""
    sys.stdout.write(printable(text) if sys.stdout.isatty() else text)
    sys.stdout.flush()


class ProgressLine:
    """The last line of stderr, if it is a terminal: the present action, until another text."""

    def __init__(self) -> None:
        self._is_shown = False

    def show(self, text: str) -> None:
        """Show the present action."""
        if sys.stderr.isatty():
            self._is_shown = True
            print(f"\r\x1b[2K{printable(text)} …", end="", file=sys.stderr, flush=True)  # noqa: T201

    def clear(self) -> None:
        """Remove the line."""
        if self._is_shown:
            self._is_shown = False
            print("\r\x1b[2K", end="", file=sys.stderr, flush=True)  # noqa: T201


PROGRESS_LINE = ProgressLine()
"""The line that ``print_status`` removes before it prints."""


def print_status(message: str) -> None:
    """Print a message for the user on stderr."""
    PROGRESS_LINE.clear()
    print(fold_for_stream(message, sys.stderr), file=sys.stderr)  # noqa: T201


def format_port(port: str) -> str:
    """Format a port's name as the user gave it; a simulated port without its arm file."""
    return "sim" if port.startswith("sim:") else port


def _to_json_value(value: Any) -> object:  # noqa: ANN401
    """Convert arrays, dataclasses and mappings to JSON values."""
    if hasattr(value, "tolist"):
        return value.tolist()
    if is_dataclass(value) and not isinstance(value, type):
        return asdict(value)
    if isinstance(value, Mapping):
        return dict(value)  # pyright: ignore[reportUnknownArgumentType, reportUnknownVariableType]
    return str(value)


Show = Callable[[str, float, float], None]
"""Callback with a description, the completed amount, and the total (infinite if unknown)."""


@contextmanager
def progress_bar() -> Generator[Show | None]:
    """Yield a callback that draws a progress bar, or None if stderr is not a terminal."""
    if not sys.stderr.isatty():
        yield None
        return
    from rich.progress import BarColumn, TextColumn, TimeRemainingColumn  # noqa: PLC0415
    from rich.progress import Progress as Bar  # noqa: PLC0415

    left = (TimeRemainingColumn(), TextColumn("left"))
    columns = (BarColumn(), TextColumn("{task.description}"), *left)
    with Bar(*columns, console=open_console(stderr=True), transient=True) as bar:
        task = bar.add_task("", total=None)

        def show(what: str, done: float, total: float) -> None:
            known = total if math.isfinite(total) else None
            bar.update(task, description=printable(what), completed=done, total=known)

        yield show


Keys = Callable[[], str]
"""Function that returns the keys pressed since the last call, in order; empty for none."""

_MAX_KEY_BYTES = 1024
# Arrow and function keys arrive as several characters, which must not be read as letter keys.
_ESCAPE_SEQUENCE = re.compile("\x1b(\\[[0-?]*[ -/]*[@-~]|O.|.)?", re.DOTALL)


@contextmanager
def read_keys() -> Generator[Keys]:
    """Yield a function that returns the keys pressed since its last call.

    Input typed before that is discarded. At the end, the terminal is restored and unread input is
    discarded.
    """
    if sys.platform == "win32":
        _windows_keys()
        yield _windows_keys
        return
    import termios  # noqa: PLC0415  # not available on Windows
    import tty  # noqa: PLC0415

    before = termios.tcgetattr(sys.stdin)
    try:
        tty.setcbreak(sys.stdin, termios.TCSAFLUSH)  # Ctrl-C still interrupts
        yield _posix_keys
    finally:
        termios.tcsetattr(sys.stdin, termios.TCSAFLUSH, before)


def _posix_keys() -> str:
    import select  # noqa: PLC0415

    # Not from `sys.stdin`, which would read ahead and hide keys from `select`.
    descriptor = sys.stdin.fileno()
    if not select.select([descriptor], [], [], 0)[0]:
        return ""
    typed = os.read(descriptor, _MAX_KEY_BYTES).decode("utf-8", "ignore")
    return _ESCAPE_SEQUENCE.sub("", typed)


def _windows_keys() -> str:
    import msvcrt  # noqa: PLC0415  # available on Windows only

    typed = ""
    while msvcrt.kbhit():  # pyright: ignore[reportUnknownMemberType, reportAttributeAccessIssue]
        key: str = msvcrt.getwch()  # pyright: ignore[reportUnknownMemberType, reportAttributeAccessIssue, reportUnknownVariableType]
        typed = f"{typed}{key}"
    return typed


def confirm(question: str) -> bool:
    """Ask a question and return yes or no; repeat it for any other input, including Enter.

    Raises:
        typer.Abort: The input ended (Ctrl-D, or the terminal was closed).
    """
    while True:
        report = read_answer(f"{question} [y/n]: ").strip().lower()
        if report in _ANSWERS:
            return _ANSWERS[report]
        print_status("Type y or n, then Enter.")


def wait_for_enter(request: str) -> None:
    """Print a request and return once Enter is pressed.

    Raises:
        typer.Abort: The input ended.
    """
    read_answer(f"{request} ")


def read_answer(prompt: str) -> str:
    """Discard pending input, print a prompt on stderr and return the next line.

    Raises:
        typer.Abort: The input ended.
    """
    _discard_input()
    print(fold_for_stream(prompt.rstrip(), sys.stderr), end=" ", file=sys.stderr, flush=True)  # noqa: T201
    try:
        line = _read_line()
    except OSError:  # the terminal was closed
        line = ""
    except KeyboardInterrupt:
        print_status("")
        raise
    if not line:
        print_status("")
        import typer  # noqa: PLC0415  # `--version` needs no typer

        raise typer.Abort
    return line.rstrip("\r\n")


def _discard_input() -> None:
    if sys.platform == "win32":
        import msvcrt  # noqa: PLC0415

        while msvcrt.kbhit():  # pyright: ignore[reportUnknownMemberType, reportAttributeAccessIssue]
            msvcrt.getwch()  # pyright: ignore[reportUnknownMemberType, reportAttributeAccessIssue]
        return
    import termios  # noqa: PLC0415  # not available on Windows

    with contextlib.suppress(termios.error):  # a closed terminal has no input
        termios.tcflush(sys.stdin, termios.TCIFLUSH)


def _read_line() -> str:
    """Read a line with its newline; empty at the end of the input."""
    if sys.platform == "win32":
        return sys.stdin.readline()
    # Not from `sys.stdin`, which would keep a second typed line for later.
    typed = b""
    while not typed.endswith(b"\n"):
        more = os.read(sys.stdin.fileno(), _MAX_ANSWER_BYTES)
        if not more:
            break
        typed += more
    return typed.decode("utf-8", "replace")
