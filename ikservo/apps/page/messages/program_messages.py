"""Messages that edit, check and run the page's program of steps.

Each step has a number, which it keeps when other steps are added, moved or removed.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field

from ikservo.apps.page.messages.message_fields import Name, PageMessage
from ikservo.apps.teaching.program import Label, Repeat, Speed

StepNumber = Annotated[int, Field(ge=1, le=2**31)]
Place = Annotated[int, Field(ge=0, le=1000)]
Wait = Annotated[float, Field(gt=0, le=3600, allow_inf_nan=False)]


class AddStep(PageMessage):
    """Add a step.

    Attributes:
        what: The present joint positions, those of the shown target, a grid whose first place is
            the present tip, a named pose, a recording, the gripper, a wait, a pause until a person
            continues, or another program.
        path: The path to the present pose or the target: a joint motion, or a line of the tip.
        pose: The name of a named pose.
        recording: The name of a recording in the folder of the programs.
        program: The name of a program in that folder.
        wait_s: The duration of a wait.
        after: The step after which the new step is inserted; None to append the step.
    """

    kind: Literal["add_step"]
    what: Literal[
        "arm", "target", "grid", "pose", "recording", "program", "open", "close", "wait", "pause"
    ]
    path: Literal["joints", "line"] = "joints"
    pose: Name | None = None
    recording: Name | None = None
    program: Name | None = None
    wait_s: Wait = 1.0
    after: StepNumber | None = None


class ChangeStep(PageMessage):
    """Set all that can be changed of a step.

    Attributes:
        speed: The speed; None for the speed of the program.
        wait_s: The duration of a wait; None for other steps.
        pause: The task of the person in a pause; None for other steps.
        only_if: The condition under which the step runs; None for always.
        grid: The keys of the grid that change, as in a program file, which checks them; None for
            other steps.
        corner: The key of the step or its grid that is taken from the present tip: the first place,
            or the distance to the next row or column, if the tip is at the last one.
    """

    kind: Literal["change_step"]
    step: StepNumber
    speed: Speed | None = None
    wait_s: Wait | None = None
    pause: Label | None = None
    only_if: Literal["grasped", "not grasped"] | None = None
    grid: dict[str, Any] | None = None
    corner: Literal["tip_m", "row_m", "column_m"] | None = None


class MoveStep(PageMessage):
    """Move a step to a place in the list, counted from 0."""

    kind: Literal["move_step"]
    step: StepNumber
    to: Place


class DeleteStep(PageMessage):
    """Remove a step."""

    kind: Literal["delete_step"]
    step: StepNumber


class SetProgram(PageMessage):
    """Set the default speed of the steps and the number of repetitions."""

    kind: Literal["set_program"]
    speed: Speed
    repeat: Repeat


class ProgramFile(PageMessage):
    """Begin, load or save a program; with ``overwrite``, saving may replace another program."""

    kind: Literal["program_file"]
    action: Literal["new", "load", "save"]
    name: Name = "program"
    overwrite: bool = False


class RunProgram(PageMessage):
    """Check the program, play it, run one step, or pause after the present step.

    Attributes:
        step: The step to begin with; None for the first step.
    """

    kind: Literal["run_program"]
    action: Literal["check", "play", "step", "pause"]
    step: StepNumber | None = None


class ShowStep(PageMessage):
    """Show the motion of a step from the arm's position; None ends that."""

    kind: Literal["show_step"]
    step: StepNumber | None


class RecordStep(PageMessage):
    """Record the arm while it is guided by hand; ``on`` = False ends the recording and adds it."""

    kind: Literal["record_step"]
    on: bool


ProgramMessage = (
    AddStep
    | ChangeStep
    | MoveStep
    | DeleteStep
    | SetProgram
    | ProgramFile
    | RunProgram
    | RecordStep
)
