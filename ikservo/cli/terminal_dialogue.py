"""Dialogues with a user at a terminal, who presses keys, or with a script of answers."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer
from rich.console import ConsoleDimensions, Group
from rich.live import Live
from rich.table import Table
from rich.text import Text

from ikservo.calibration.joint_map import JointUnit
from ikservo.cli.options import YesOption
from ikservo.cli.terminal import (
    PROGRESS_LINE,
    Keys,
    confirm,
    open_console,
    print_status,
    read_answer,
    read_keys,
)
from ikservo.errors import IkservoError, InputError
from ikservo.maintenance.dialogue import (
    ACCEPT,
    Entry,
    EntryDialogue,
    HandRequest,
    JointProgress,
    JointReadout,
    Notice,
    Progress,
    Question,
    Result,
    ScriptedAnswers,
    Unasked,
)

_MAX_BAR_CHARS, _MIN_BAR_CHARS = 24, 8
_OTHER_COLUMNS = 64  # width of a row without its bar, in characters
_NARROW = _OTHER_COLUMNS + _MIN_BAR_CHARS  # below this, the arm file's range is omitted
_REFRESH_STEPS = 4  # readings per screen update


@dataclass(frozen=True, slots=True)
class Operator:
    """The operator who answers a dialogue: a user, a script, or nobody.

    Attributes:
        script: The answers to the requests; None reads keys.
        yes: Whether the user has agreed to everything beforehand.
        interactive: Whether the user may be asked.
    """

    script: ScriptedAnswers | None
    yes: bool
    interactive: bool

    @classmethod
    def of(cls, entries: Sequence[str] | None, *, yes: bool, no_input: bool = False) -> Operator:
        """Return the operator for a command's options; ``entries`` are the answers of a script."""
        scripted = entries is not None
        return cls(
            ScriptedAnswers(entries) if scripted or yes else None,
            yes,
            not (scripted or yes or no_input) and sys.stdin.isatty(),
        )

    def run(self, dialogue: EntryDialogue[Result]) -> Result:
        """Run a dialogue to its end, and return its result.

        Raises:
            InputError: There is neither a script nor a user; the error names options to use
                instead.
            CalibrationError: An answer in the script is not possible.
            IkservoError: The errors that the dialogue raises.
        """
        answer: str | None = None
        with closing(dialogue), closing(_RequestScreen(self)) as screen:
            while True:
                try:
                    item = dialogue.send(answer)
                except StopIteration as end:
                    return end.value
                answer = None
                if isinstance(item, HandRequest):
                    answer = screen.show_and_answer(item)
                elif isinstance(item, Progress):
                    PROGRESS_LINE.show(str(item))
                else:
                    screen.close()
                    if isinstance(item, Notice):
                        print_status(item.text)
                    elif isinstance(item, Entry):
                        answer = self.ask(item)
                    elif self.agrees(item):
                        answer = ACCEPT

    def ask(self, entry: Entry) -> str:
        """Ask for a word or value until it is valid; return the default if nobody can be asked.

        Raises:
            InputError: Nobody can be asked, and there is no default; the error names the option.
        """
        while self.interactive:
            default = f" [{entry.default}]" if entry.default else ""
            listed = f" ({', '.join(entry.choices)})" if entry.choices else ""
            answer = read_answer(f"{entry.text}{listed}{default}: ").strip() or entry.default
            if answer and (not entry.choices or answer in entry.choices):
                return answer
            print_status(f"Type one of: {', '.join(entry.choices)}." if entry.choices else
                         "Type an answer, then Enter.")  # fmt: skip
        if not entry.default:
            raise InputError(
                f"{entry.text} Cannot ask: input is not a terminal.", f"Give {entry.option}."
            )
        return entry.default

    def agrees(self, question: Question) -> bool:
        """Ask a question, and return whether the answer is yes."""
        if self.interactive:
            return confirm(question.text)
        if question.unasked is Unasked.ERROR and not self.yes:
            text = f"{question.text} Cannot ask: input is not a terminal."
            raise InputError(text, "Give --yes.")
        agreed = self.yes or self.script is not None
        return question.unasked is Unasked.YES or (question.unasked is not Unasked.NO and agreed)


@dataclass(frozen=True, kw_only=True)
class AnswerOptions:
    """The options that determine who answers the questions of a calibration."""

    from_script: Annotated[
        Path | None,
        typer.Option("--from-script", metavar="FILE", help="File with the answers, one per line."),
    ] = None
    yes: YesOption = False
    no_input: Annotated[
        bool, typer.Option("--no-input", help="Never ask; fail if a question is necessary.")
    ] = False

    def operator(self, read_script: Callable[[Path], Sequence[str]]) -> Operator:
        """Return the operator who answers; ``read_script`` reads the answers from a file."""
        entries = None if self.from_script is None else read_script(self.from_script)
        return Operator.of(entries, yes=self.yes, no_input=self.no_input)


class _RequestScreen:
    """Screen that shows requests, reads the keyboard during a request, and returns answers."""

    def __init__(self, operator: Operator) -> None:
        self._script, self._interactive = operator.script, operator.interactive
        self._open = ExitStack()
        self._keys: Keys | None = None
        self._live: Live | None = None
        self._line = ""
        self._error: IkservoError | None = None
        self._updates = 0
        self._size: ConsoleDimensions | None = None

    def close(self) -> None:
        """Release the keyboard and the screen until the next request."""
        self._open.close()
        self._keys = self._live = None
        PROGRESS_LINE.clear()

    def show_and_answer(self, request: HandRequest) -> str | None:
        """Show a request; return the answer if there is one."""
        if self._script is None and self._keys is None:
            if not (self._interactive and sys.stdin.isatty()):
                raise InputError(
                    "Cannot ask: input is not a terminal.", "Give --yes, or --from-script FILE."
                )
            self._keys = self._open.enter_context(read_keys())
        if request.error and self._script:
            raise request.error
        if request.readings is not None and sys.stderr.isatty():
            self._draw(request, request.readings)
        else:
            if request.error is not self._error:
                self._error = request.error
                if request.error:
                    print_status(request.error_text)
            line = request.line
            if self._script is None:
                line += f"\n  {_key_help(request)}"
            if line != self._line:
                self._line = line
                print_status(line)
        if self._script:
            return self._script.next_answer(request)
        pressed = self._keys()[:1].lower() if self._keys else ""
        key = "Enter" if pressed in ("\n", "\r") else pressed
        choice = next((each for each in request.choices if key and each.key == key), None)
        if choice is None or (choice.joints and not choice.joint):
            return None
        return f"{choice.answer} {choice.joint}".strip()

    def _draw(self, request: HandRequest, readings: tuple[JointReadout, ...]) -> None:
        """Draw a bar for each joint, and the keys below."""
        if self._live is None:
            console = open_console(stderr=True)
            self._live = Live(console=console, refresh_per_second=15, transient=True)
            self._open.enter_context(self._live)
            self._size = console.size
        self._updates += 1
        if self._updates % _REFRESH_STEPS:
            return
        size = self._live.console.size
        if size != self._size:  # lines that a terminal has wrapped cannot be overwritten
            self._size = size
            self._live.console.clear()
        parts: list[Text | Table] = [Text(request.line, style="bold")]
        if readings:
            parts.append(_joint_table(readings, request.current, size.width))
        parts.append(Text(_key_help(request), style="dim"))
        if request.error:
            parts.append(
                Text(f"{request.error.message} {request.error.command_hint}", style="yellow")
            )
        self._live.update(Group(*parts))


def _key_help(request: HandRequest) -> str:
    keys = [f"{choice.key} {choice.label}" for choice in request.choices if choice.label]
    return "   ".join([*keys, "Ctrl-C stop"])


def _joint_table(readings: tuple[JointReadout, ...], current: str, width: int) -> Table:
    """Return a table with a row for each joint, at most as wide as the terminal."""
    table = Table(box=None, pad_edge=False, header_style="dim")
    columns = ["joint", "", "swept", "arm file", ""]
    has_room = width >= _NARROW
    for column in columns if has_room else [c for c in columns if c != "arm file"]:
        table.add_column(column, no_wrap=True, overflow="ellipsis")
    length = min(max(width - _OTHER_COLUMNS, _MIN_BAR_CHARS), _MAX_BAR_CHARS)
    for readout in readings:
        unit, expected = readout.subject.joint_map.unit, readout.subject.expected
        progress = readout.state.value
        moved = readout.state is not JointProgress.UNMOVED
        row = [
            Text(readout.name, style="bold" if readout.name == current else ""),
            _range_bar(readout, length),
            Text(_format_range(readout.low, readout.high, unit) if moved else ""),
        ]
        if has_room:
            range_text = _format_range(expected.lower.value, expected.upper.value, unit)
            row.append(Text(range_text, "dim"))
        table.add_row(*row, Text(progress, style="green" if "✓" in progress else "yellow"))
    return table


def _format_range(low: float, high: float, unit: JointUnit) -> str:
    """Format a range as ``-100° … 100°`` or ``15.0 … 37.0 mm``: short, for a table."""
    if unit == "m":
        return f"{low * 1000:z.1f} … {high * 1000:z.1f} mm"
    return f"{math.degrees(low):z.0f}° … {math.degrees(high):z.0f}°"


def _range_bar(readout: JointReadout, length: int) -> Text:
    """Return a bar with a joint's position and recorded range between the arm file's limits."""
    low, high = readout.subject.expected.lower.value, readout.subject.expected.upper.value

    def cell(position: float) -> int:
        return min(length - 1, max(0, round((position - low) / (high - low) * (length - 1))))

    cells = ["┄"] * length
    for k in range(cell(readout.low), cell(readout.high) + 1):
        cells[k] = "━"
    cells[cell(readout.position)] = "●"
    return Text("├" + "".join(cells) + "┤")
