"""The program that a page edits: steps with permanent numbers, and its files."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ikservo.apps.page.running.record_job import SUFFIX
from ikservo.apps.teaching.program import (
    MAX_STEPS,
    Program,
    ProgramStep,
    Repeat,
    Speed,
    check_program,
    read_program,
    write_program,
)
from ikservo.errors import BadValueError, InputError, UnknownNameError
from ikservo.files.reading import config_dir


@dataclass(frozen=True, slots=True)
class DraftStep:
    """A step and its permanent number, which does not depend on its place in the list."""

    number: int
    step: ProgramStep


class ProgramFolder:
    """The folder of the programs that a page saves and loads, one TOML file each.

    Args:
        path: The folder; ``programs`` in the user's configuration folder if None.
    """

    def __init__(self, path: Path | None = None) -> None:
        self.path = config_dir() / "programs" if path is None else path

    def names(self) -> list[str]:
        """Return the names of the programs, without the suffix."""
        return sorted(path.stem for path in self.path.glob("*.toml"))

    def file(self, name: str) -> Path:
        """Return the file of a program."""
        return self.path / f"{name}.toml"

    def recordings(self) -> list[str]:
        """Return the names of the recordings, without the suffix."""
        return sorted(path.stem for path in self.path.glob(f"*{SUFFIX}"))

    def recording_file(self, name: str) -> str:
        """Return the file name of a recording.

        Raises:
            UnknownNameError: There is no recording of that name.
        """
        names = self.recordings()
        if name not in names:
            raise UnknownNameError("recording", name, names)
        return name + SUFFIX


class ProgramDraft:
    """The steps of a program as a page edits them.

    Args:
        arm: The arm's name.
        folder: The folder of the programs.

    Attributes:
        steps: The steps, in order.
        speed: The default speed of the steps.
        repeat: The number of repetitions of all steps.
        name: The name of the program file; empty until it is saved or loaded.
        changed: Whether the draft differs from its file.
        revision: Changes with every edit.
    """

    def __init__(self, arm: str, folder: ProgramFolder) -> None:
        self._arm, self.folder = arm, folder
        self._next_number = 1
        self.steps: tuple[DraftStep, ...] = ()
        self.speed: Speed = "slow"
        self.repeat: Repeat = 1
        self.name = ""
        self.changed = False
        self.revision = 0
        self.names, self.recordings = folder.names(), folder.recordings()

    def add(self, step: ProgramStep, after: int | None = None) -> int:
        """Add a step after another step, or at the end; return its number.

        Raises:
            InputError: There are too many steps, or the step before it no longer exists.
        """
        if len(self.steps) >= MAX_STEPS:
            raise InputError(f"A program has at most {MAX_STEPS} steps.", "Nothing was added.")
        place = len(self.steps) if after is None else self.place_of(after) + 1
        added = self._number_step(step)
        self._set_steps((*self.steps[:place], added, *self.steps[place:]))
        return added.number

    def change(self, number: int, *, speed: Speed | None, **values: Any) -> None:  # noqa: ANN401
        """Set the values that ``ChangeStep`` describes.

        Raises:
            InputError: The step no longer exists, or has no such value.
            FileFormatError: A program cannot have such a step.
        """
        place = self.place_of(number)
        old = self.steps[place].step
        for key in ("wait_s", "pause", "grid"):
            if (values[key] is None) != (getattr(old, key) is None):
                raise InputError("This step has another action.", "Nothing was changed.")
        if speed is not None and not old.has_speed:
            raise InputError("This step has no speed.", "Nothing was changed.")
        steps: list[object] = [each.step for each in self.steps]
        steps[place] = old.model_dump(exclude_defaults=True) | {"speed": speed, **values}
        tables = {"format": 1, "arm": self._arm, "steps": steps}
        new = check_program(Path("the program"), tables).steps[place]
        changed = replace(self.steps[place], step=new)
        self._set_steps((*self.steps[:place], changed, *self.steps[place + 1 :]))

    def move(self, number: int, to: int) -> None:
        """Move a step to a place in the list, or to its end.

        Raises:
            InputError: The step no longer exists.
        """
        moved = self.steps[self.place_of(number)]
        others = [each for each in self.steps if each is not moved]
        self._set_steps((*others[:to], moved, *others[to:]))

    def delete(self, number: int) -> None:
        """Remove a step.

        Raises:
            InputError: The step no longer exists.
        """
        place = self.place_of(number)
        self._set_steps((*self.steps[:place], *self.steps[place + 1 :]))

    def set_options(self, speed: Speed, repeat: Repeat) -> None:
        """Set the default speed of the steps and the number of repetitions."""
        self.speed, self.repeat = speed, repeat
        self._note_change(changed=True)

    def place_of(self, number: int) -> int:
        """Return the place of a step in the list.

        Raises:
            InputError: The step no longer exists.
        """
        for place, each in enumerate(self.steps):
            if each.number == number:
                return place
        raise InputError("That step no longer exists.", "Nothing was changed.")

    def program(self) -> Program:
        """Return the draft as a program.

        Raises:
            InputError: The draft has no steps.
        """
        if not self.steps:
            raise InputError("The program has no steps.", "Add a step first.")
        steps = tuple(each.step for each in self.steps)
        return Program(format=1, arm=self._arm, speed=self.speed, repeat=self.repeat, steps=steps)

    def clear(self) -> None:
        """Begin a new program."""
        self.speed, self.repeat, self.name, self.steps = "slow", 1, "", ()
        self._note_change(changed=False)

    def load(self, name: str) -> None:
        """Replace the draft by a program that is loaded from its file.

        Raises:
            UnknownNameError: There is no program of that name.
            FileFormatError: The file is malformed.
            BadValueError: The program belongs to another arm.
        """
        names = self.folder.names()
        if name not in names:
            raise UnknownNameError("program", name, names)
        read = read_program(self.folder.file(name))
        if read.arm != self._arm:
            raise BadValueError("The program", f"for {read.arm}", f"a program for {self._arm}")
        self.speed, self.repeat, self.name = read.speed, read.repeat, name
        self.steps = tuple(map(self._number_step, read.steps))
        self._note_change(changed=False)

    def save(self, name: str, *, overwrite: bool) -> Path:
        """Save the program; return its file.

        Raises:
            InputError: The program has no steps, or another program has that name.
            FileWriteError: The file cannot be written; an existing file is unchanged.
        """
        path, program = self.folder.file(name), self.program()
        if name != self.name and path.exists() and not overwrite:
            raise InputError(
                f"A program named {name} already exists.", "Replace it, or rename this one."
            )
        write_program(path, program)
        self.name = name
        self._note_change(changed=False)
        return path

    def _number_step(self, step: ProgramStep) -> DraftStep:
        numbered = DraftStep(self._next_number, step)
        self._next_number += 1
        return numbered

    def _set_steps(self, steps: Iterable[DraftStep]) -> None:
        self.steps = tuple(steps)
        self._note_change(changed=True)

    def _note_change(self, *, changed: bool) -> None:
        self.changed = changed
        self.names, self.recordings = self.folder.names(), self.folder.recordings()
        self.revision += 1
