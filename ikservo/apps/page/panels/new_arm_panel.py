"""The dialogue of `ikservo arms new` on the page, in a separate process.

Reading foreign descriptions and fitting meshes takes seconds of processor time. In a separate
process, this does not delay the control of open arms, and Leave ends it at once. The process
also moves servos: Stop all closes the pipe, which it checks before each step of a motion.
"""

from __future__ import annotations

import contextlib
import os
import threading
from dataclasses import dataclass
from multiprocessing import get_context
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from ikservo.apps.importing.draft import ArmDraft
from ikservo.apps.importing.folder import write_drafts
from ikservo.apps.importing.new_arm import NewArm, draft_new_arm
from ikservo.apps.page.messages.message_fields import Name, PageMessage
from ikservo.apps.page.messages.page_messages import BadMessageError
from ikservo.control.stop_requests import exiting_on_signals
from ikservo.errors import IkservoError
from ikservo.maintenance.dialogue import ACCEPT, Entry, Notice, Progress, Question, Unasked

_MAX_LINES = 200
_LET_GO_S = 10.0  # time for the process to switch torque off and close the port
_NICE = 10


class StartNewArm(PageMessage):
    """Make the folder of a new arm.

    Attributes:
        name: The name of the arm.
        source: Path of a description or its folder on the machine of the server; empty for an arm
            that is measured with a ruler.
        port: The port of the servos; empty if they are not connected.
    """

    kind: Literal["new_arm"]
    name: Name
    source: Annotated[str, Field(max_length=1024)] = ""
    port: Annotated[str, Field(max_length=256)] = ""


class AnswerNewArm(PageMessage):
    """Answer question ``number`` of the dialogue."""

    kind: Literal["answer_new_arm"]
    number: Annotated[int, Field(ge=1, le=10_000)]
    answer: Annotated[str, Field(max_length=512)]


class CancelNewArm(PageMessage):
    """Leave the dialogue; nothing is written."""

    kind: Literal["cancel_new_arm"]


@dataclass(frozen=True, slots=True)
class _Ended:
    """The end of a dialogue: the folders that were written, or an error."""

    folders: tuple[Path, ...] = ()
    error: str = ""


class NewArmPanel:
    """Runs one dialogue at a time and keeps its state for the page.

    Args:
        folder: The folder in which the arms' folders are made.
        is_local: Whether the page is served to this machine only. Other machines may not create an
            arm, because that reads and writes files of this machine.
    """

    def __init__(self, folder: Path, *, is_local: bool = True) -> None:
        self._folder, self._is_local = folder, is_local
        self._reset()

    def _reset(self) -> None:
        self._process, self._line = None, None
        self._lines: list[str] = []
        self._progress, self._number = "", 0
        self._question: Question | Entry | None = None
        self._has_servos = False
        self._ended: _Ended | None = None

    @property
    def is_running(self) -> bool:
        """Whether a dialogue is running."""
        return self._line is not None

    def start(self, message: StartNewArm) -> None:
        """Begin a dialogue.

        Raises:
            BadMessageError: A dialogue is running, or the page is served to other machines.
        """
        if not self._is_local:
            raise BadMessageError(
                "A page on another machine cannot create an arm.",
                "In a terminal on the arm's computer, run: ikservo arms new",
            )
        if self.is_running:
            raise BadMessageError(
                "An arm is already being created.", "Finish or cancel that arm first."
            )
        self._reset()
        source = Path(message.source.strip()).expanduser() if message.source.strip() else None
        context = get_context("spawn")
        self._line, theirs = context.Pipe()
        new = NewArm(message.name, self._folder, source, port=message.port or None)
        self._has_servos = new.port is not None
        self._process = context.Process(target=_run, args=(theirs, new), daemon=True)
        self._process.start()
        theirs.close()

    def answer(self, message: AnswerNewArm) -> None:
        """Give an answer; drop it if its question is no longer open.

        Raises:
            BadMessageError: The text is not one of the possible answers.
        """
        if self._line is None or self._question is None or message.number != self._number:
            return
        answer = message.answer.strip()
        if isinstance(self._question, Entry):
            answer = answer or self._question.default
            choices = self._question.choices
            if not answer or (choices and answer not in choices):
                known = f"Answer with one of: {', '.join(choices)}" if choices else ""
                raise BadMessageError("An answer is missing.", known)
        self._question = None
        with contextlib.suppress(OSError):
            self._line.send(answer)

    def stop_servos(self) -> None:
        """End the dialogue if it may be moving a servo; the servo's torque is switched off."""
        if self._has_servos and self.is_running:
            self._close_line()
            self._ended = _Ended(
                error="Stopped; the torque of the servos is off. Nothing was written."
            )

    def close(self) -> None:
        """End the dialogue, if there is one; unfinished arms are not written."""
        if self.is_running:
            self._close_line()
        self._reset()

    def _close_line(self) -> None:
        """Close the pipe; terminate the process if it does not end by itself."""
        if self._line is not None:
            self._line.close()
        self._line, self._question, self._progress = None, None, ""
        if self._process is not None:
            grace_s = _LET_GO_S if self._has_servos else 0.0
            threading.Thread(target=_end, args=(self._process, grace_s)).start()

    def read(self) -> tuple[Path, ...]:
        """Read new items of the dialogue; return the folders that it has written."""
        while self._line is not None:
            try:
                if not self._line.poll():
                    break
                item = self._line.recv()
            except (EOFError, OSError):
                item = _Ended(error="The conversion failed; the terminal says why.")
            match item:
                case Notice(text):
                    self._lines = [*self._lines, text][-_MAX_LINES:]
                case Progress(text):
                    self._progress = text
                case Question() | Entry():
                    self._question, self._number = item, self._number + 1
                case _Ended():
                    self._ended, self._line, self._progress = item, None, ""
                    return item.folders
                case _:
                    continue
        return ()

    def fields(self) -> dict[str, object] | None:
        """Return the state for the page; None without a dialogue."""
        if self._line is None and self._ended is None:
            return None
        ended, question = self._ended or _Ended(), self._question
        shown = None
        if isinstance(question, Question):
            buttons = [[ACCEPT, question.label], ["no", "no"]]
            shown = {"text": question.text, "buttons": buttons, "default": "", "choices": []}
        elif question is not None:
            shown = {
                "text": question.text,
                "buttons": [],
                "default": question.default,
                "choices": list(question.choices),
            }
        return {
            "lines": self._lines,
            "progress": "" if question else self._progress,
            "question": shown,
            "number": self._number,
            "folders": [str(path) for path in ended.folders],
            "error": ended.error,
            "has_servos": self._has_servos and self.is_running,
        }


def _run(line: Connection, new: NewArm) -> None:
    """Run the dialogue in this process; all values pass through the pipe."""
    if hasattr(os, "nice"):
        os.nice(_NICE)
    try:
        answer = None
        with exiting_on_signals(), contextlib.closing(draft_new_arm(new)) as dialogue:
            while True:
                try:
                    answer = _tell(line, dialogue.send(answer))
                except StopIteration as end:
                    drafts: list[ArmDraft] = end.value
                    break
        for draft in drafts:
            for text in (*draft.decisions, *draft.dropped):
                line.send(Notice(f"{draft.name}: {text}"))
        where = ", ".join(str(new.folder.absolute() / draft.name) for draft in drafts)
        if _tell(line, Question(f"Write {where}?", Unasked.NO, label="write")) == ACCEPT:
            line.send(_Ended(tuple(write_drafts(drafts, new.folder))))
        else:
            line.send(_Ended(error="Nothing was written."))
    except IkservoError as error:
        line.send(_Ended(error=f"{error.message} {error.command_hint}".strip()))
    except (EOFError, OSError):  # the page has left the dialogue
        return


def _tell(line: Connection, item: object) -> str | None:
    """Send an item of the dialogue, and wait for the answer if it is a question.

    Raises:
        EOFError: The page was closed.
        OSError: The page was closed; noticed when writing.
    """
    line.send(item)
    return line.recv() if isinstance(item, Question | Entry) or line.poll() else None


def _end(process: BaseProcess, grace_s: float) -> None:
    """Wait for a process to end, and terminate it if it does not."""
    process.join(grace_s)
    if process.is_alive():
        process.terminate()
        process.join()
