"""The page's dialogues without an open arm: their messages, and the state that the page shows."""

from __future__ import annotations

import contextlib
import threading
from dataclasses import asdict
from multiprocessing import get_context
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from ikservo.apps.importing.new_arm import NewArm
from ikservo.apps.page.messages.message_fields import Name, PageMessage
from ikservo.apps.page.messages.page_messages import BadMessageError
from ikservo.apps.page.panels.dialogue_process import ArmSketch, DialogueEnd, Task, run_dialogue
from ikservo.maintenance.dialogue import ACCEPT, Entry, Notice, Progress, Question

_MAX_LINES = 200
_LET_GO_S = 10.0  # time for the process to finish a write, switch torque off and close the port


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


class AnswerDialogue(PageMessage):
    """Answer question ``number`` of the dialogue."""

    kind: Literal["answer_dialogue"]
    number: Annotated[int, Field(ge=1, le=10_000)]
    answer: Annotated[str, Field(max_length=512)]


class LeaveDialogue(PageMessage):
    """Leave the dialogue; nothing more is written."""

    kind: Literal["leave_dialogue"]


class DialoguePanel:
    """Runner of one dialogue at a time, in a separate process; holds its state for the page.

    *Stop all* closes the pipe to that process, which checks it before each step of a motion.

    Args:
        folder: The folder in which the arms' folders are made.
        is_local: Whether the page is served to this machine only. Other machines may not create an
            arm, because that reads and writes files of this machine.
    """

    def __init__(self, folder: Path, *, is_local: bool = True) -> None:
        self._folder, self._is_local = folder, is_local
        self._ending: BaseProcess | None = None
        self._reset()

    def _reset(self) -> None:
        self._process, self._line = None, None
        self._lines: list[str] = []
        self._sketch: ArmSketch | None = None
        self._joint = ""
        self._progress, self._number = Progress(""), 0
        self._question: Question | Entry | None = None
        self._moves_servos = self._has_port = False
        self._ended: DialogueEnd | None = None

    @property
    def is_running(self) -> bool:
        """Whether a dialogue is running."""
        return self._line is not None

    def start_new_arm(self, message: StartNewArm) -> None:
        """Begin the dialogue that makes the folder of a new arm.

        Raises:
            BadMessageError: A dialogue is running, or the page is served to other machines.
        """
        if not self._is_local:
            raise BadMessageError(
                "A page on another machine cannot create an arm.",
                "In a terminal on the arm's computer, run: ikservo arms new",
            )
        source = Path(message.source.strip()).expanduser() if message.source.strip() else None
        new = NewArm(message.name, self._folder, source, port=message.port or None)
        self.start(new, moves_servos=new.port is not None)

    def start(self, task: Task, *, moves_servos: bool = False) -> None:
        """Begin a dialogue.

        Raises:
            BadMessageError: A dialogue is running.
        """
        if self.is_running:
            raise BadMessageError("Another dialogue is running.", "Finish or leave that one first.")
        if self._ending is not None and self._ending.is_alive():  # it still has the port
            raise BadMessageError("The previous task is being ended.", "Try again in a moment.")
        self._reset()
        self._moves_servos, self._has_port = moves_servos, task.port is not None
        context = get_context("spawn")
        self._line, theirs = context.Pipe()
        self._process = context.Process(target=run_dialogue, args=(theirs, task), daemon=True)
        self._process.start()
        theirs.close()

    def answer(self, message: AnswerDialogue) -> None:
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
        if self._moves_servos and self.is_running:
            self._close_line()
            self._ended = DialogueEnd(
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
        self._line, self._question, self._progress = None, None, Progress("")
        if self._process is not None:
            grace_s = _LET_GO_S if self._has_port else 0.0
            threading.Thread(target=_end, args=(self._process, grace_s)).start()
            self._ending = self._process

    def read(self) -> tuple[Path, ...]:
        """Read new items of the dialogue; return the folders that it has written."""
        while self._line is not None:
            try:
                if not self._line.poll():
                    break
                item = self._line.recv()
            except (EOFError, OSError):
                item = DialogueEnd(error="The dialogue failed; the terminal says why.")
            match item:
                case Notice(text, joint):
                    self._lines = [*self._lines, text][-_MAX_LINES:]
                    self._joint = joint or self._joint
                case ArmSketch():
                    self._sketch = item
                case Progress():
                    self._progress = item
                case Question() | Entry():
                    self._question, self._number = item, self._number + 1
                case DialogueEnd():
                    self._ended, self._line, self._progress = item, None, Progress("")
                    return item.folders
                case _:
                    continue
        return ()

    def fields(self) -> dict[str, object] | None:
        """Return the state for the page; None if no dialogue was started."""
        if self._line is None and self._ended is None:
            return None
        ended, question = self._ended or DialogueEnd(), self._question
        progress = self._progress
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
            "joint": self._joint,
            "sketch": asdict(self._sketch) if self._sketch and self._joint else None,
            "progress": "" if question else str(progress),
            "share": progress.done / progress.total if progress.total and not question else None,
            "question": shown,
            "number": self._number,
            "result": ended.result,
            "error": ended.error,
            "moves_servos": self._moves_servos and self.is_running,
        }


def _end(process: BaseProcess, grace_s: float) -> None:
    """Wait for a process to end, and terminate it if it does not."""
    process.join(grace_s)
    if process.is_alive():
        process.terminate()
        process.join(_LET_GO_S)
        process.kill()
