"""Dialogues of the page that run in a separate process: a new arm, ids of servos, a check.

Reading foreign descriptions and searching for servos take seconds of processor time. In a separate
process, this does not delay the control of open arms, and Leave ends it at once.
"""

from __future__ import annotations

import contextlib
import os
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np

from ikservo.apps.importing.draft import ArmDraft
from ikservo.apps.importing.folder import write_drafts
from ikservo.apps.importing.new_arm import NewArm, draft_new_arm
from ikservo.apps.workbench.commissioning import (
    configure_servos,
    open_line,
    planned_settings,
    remaining_settings,
)
from ikservo.apps.workbench.doctor import diagnose
from ikservo.apps.workbench.findings import Severity
from ikservo.arm.opening import resolve_port
from ikservo.control.stop_requests import exiting_on_signals
from ikservo.errors import IkservoError
from ikservo.hardware.port_names import is_simulated, with_simulator_option
from ikservo.kinematics.arrays import Matrix
from ikservo.maintenance.dialogue import (
    ACCEPT,
    Entry,
    EntryDialogue,
    Notice,
    Progress,
    Question,
    Unasked,
)
from ikservo.model import Model, load_model
from ikservo.remedies import in_page

_NICE = 10
_WAIT_S = 300.0  # time to plug in or unplug a servo


@dataclass(frozen=True, slots=True)
class SetUpServos:
    """Give the servos of an arm their ids, one after another.

    Attributes:
        arm: The file of the arm.
        port: The port; a simulated arm has new servos, and a simulated hand plugs them in.
    """

    arm: Path
    port: str


@dataclass(frozen=True, slots=True)
class CheckServos:
    """Check adapter, bus and servos.

    Attributes:
        arm: The file of the arm.
        port: The port.
        any_servos: Whether to search for any servos at every rate, not only for servos of the arm.
    """

    arm: Path
    port: str
    any_servos: bool = False


@dataclass(frozen=True, slots=True)
class DialogueEnd:
    """The end of a dialogue: its result, and the folders that were written; or an error."""

    result: str = ""
    folders: tuple[Path, ...] = ()
    error: str = ""


@dataclass(frozen=True, slots=True)
class ArmSketch:
    """The arm in its first pose, seen from its side.

    Attributes:
        pivots_m: Horizontal distance from the base and height of each joint, in order.
        tip_m: The same of the tip.
    """

    pivots_m: Mapping[str, tuple[float, float]]
    tip_m: tuple[float, float]


Task = NewArm | SetUpServos | CheckServos


def run_dialogue(line: Connection, task: Task) -> None:
    """Run a dialogue in this process; all values pass through the pipe."""
    if hasattr(os, "nice"):
        os.nice(_NICE)
    try:
        answer = None
        with exiting_on_signals(), contextlib.closing(_dialogue_of(line, task)) as dialogue:
            while True:
                try:
                    answer = _tell(line, dialogue.send(answer))
                except StopIteration as end:
                    line.send(end.value)
                    return
    except IkservoError as error:
        line.send(DialogueEnd(error=in_page(f"{error.message} {error.command_hint}".strip())))
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


def _dialogue_of(line: Connection, task: Task) -> EntryDialogue[DialogueEnd]:
    match task:
        case NewArm():
            return _make_arm(task)
        case SetUpServos():
            return _set_up(line, task)
        case CheckServos():
            return _check(line, task)


def _make_arm(new: NewArm) -> EntryDialogue[DialogueEnd]:
    drafts: list[ArmDraft] = yield from draft_new_arm(new)
    for draft in drafts:
        for text in (*draft.decisions, *draft.dropped):
            yield Notice(f"{draft.name}: {text}")
    where = ", ".join(str(new.folder.absolute() / draft.name) for draft in drafts)
    if (yield Question(f"Write {where}?", Unasked.NO, label="write")) != ACCEPT:
        return DialogueEnd(error="Nothing was written.")
    folders = tuple(write_drafts(drafts, new.folder))
    written = f"Written to {', '.join(map(str, folders))}. Choose it above, on port sim."
    return DialogueEnd(written, folders)


def _set_up(line: Connection, task: SetUpServos) -> EntryDialogue[DialogueEnd]:
    model = load_model(task.arm)
    names = tuple(dict.fromkeys(each.servo.name for each in planned_settings(model)))
    line.send(_sketch(model))
    port = task.port
    if is_simulated(port):
        port = with_simulator_option(with_simulator_option(port, "paced=1"), "hand=setup")
        yield Notice("A simulated hand plugs in and unplugs the simulated servos.")
    else:
        yield Notice("Unplug all servos from the adapter, and switch on the power supply.")
    start = yield Entry("Begin with the servo of", "--start", names[0], names)
    todo = remaining_settings(model, start)
    with open_line(model, port) as opened:
        yield from configure_servos(
            opened, model, todo, _WAIT_S, lambda done: line.send(Notice(str(done)))
        )
    return DialogueEnd("All servos are set up. Connect them to each other, then press Check.")


def _sketch(model: Model) -> ArmSketch:
    chain, q = model.chain, model.initial_joints()
    poses, tip = chain.link_poses(q), chain.forward(q)[:2, 3]
    ahead = tip / max(float(np.linalg.norm(tip)), 1e-6)

    def seen(T: Matrix) -> tuple[float, float]:
        return float(ahead @ T[:2, 3]), float(T[2, 3])

    names = {joint.name for joint in model.joints}
    moved = {s.joint.name: link for link in poses for s in chain.joints_to(link)[-1:]}
    pivots = {name: seen(poses[link]) for name, link in moved.items() if name in names}
    return ArmSketch(pivots, seen(chain.forward(q)))


def _check(line: Connection, task: CheckServos) -> EntryDialogue[DialogueEnd]:
    shown = ""

    def show_progress(text: str, done: float, total: float) -> None:
        nonlocal shown
        now = Progress(text, done, total)
        if str(now) != shown:
            shown = str(now)
            line.send(now)

    model = load_model(task.arm)
    port = resolve_port(model, task.port)
    if is_simulated(port):
        yield Notice("Port sim: these are simulated servos, not your own.")
    found: Counter[Severity] = Counter()
    for finding in diagnose(port, None if task.any_servos else model, show_progress):
        found[finding.level] += 1
        fix = in_page(finding.fix).replace("press Calibrate", "press Open, then Calibrate")
        remedy = f" {fix}" if fix else ""
        yield Notice(f"{finding.level.mark} {finding.topic}: {finding.text}.{remedy}")
    if found[Severity.BAD] or found[Severity.ODD]:
        counts = f"Faults: {found[Severity.BAD]}, warnings: {found[Severity.ODD]}"
        return DialogueEnd(f"{counts}; the list says what to do.")
    return DialogueEnd("No faults found.")
