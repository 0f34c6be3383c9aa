"""Panel of the page's program: capture, edit, save, check and play steps."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ikservo.apps.page.dragging.interaction import Interaction
from ikservo.apps.page.messages import program_messages as msg
from ikservo.apps.page.panels.program_draft import ProgramDraft, ProgramFolder
from ikservo.apps.page.running.arm_thread import ArmThread
from ikservo.apps.page.running.program_play import PlayState, ProgramPlay
from ikservo.apps.page.running.record_job import RecordArm
from ikservo.apps.page.server.message_age_and_rate import Client
from ikservo.apps.page.server.server import Frame
from ikservo.apps.teaching.program import Grid, Point, ProgramStep
from ikservo.apps.teaching.replaying import Replay
from ikservo.arm import Arm
from ikservo.arm.own_motion import OwnMotion
from ikservo.errors import InputError, UnknownNameError
from ikservo.kinematics.arrays import Vector
from ikservo.planning.motions import MotionValue

_DEG_PLACES, _M_PLACES, _TIP_PLACES = 2, 5, 4
_NEW_GRID = Grid(rows=2, columns=3, row_m=(0.0, 0.04, 0.0), column_m=(0.04, 0.0, 0.0))


class ProgramPanel:
    """Editor of the program; asks the arm thread to play it."""

    def __init__(self, arm_thread: ArmThread, folder: ProgramFolder | None = None) -> None:
        self._arm_thread = arm_thread
        self.draft = ProgramDraft(arm_thread.arm.model.name, folder or ProgramFolder())
        self._play: ProgramPlay | None = None
        self._recording: RecordArm | None = None
        self._state = PlayState()

    def handle(self, message: msg.ProgramMessage, interaction: Interaction) -> None:
        """Handle a message; ``interaction`` provides the target that is shown.

        Raises:
            IkservoError: The request is not possible; nothing has changed.
        """
        if isinstance(message, msg.RunProgram):
            self._run(message)
            return
        if isinstance(message, msg.RecordStep):
            if message.on:
                recording = RecordArm(self.draft.folder.path)
                self._arm_thread.request_job(recording)
                self._recording = recording
            elif self._recording is not None:
                self._recording.finish()
            return
        if self._is_busy:
            raise InputError("The program is being played.", "Pause or stop it first.")
        self._edit(message, interaction)
        self._play, self._state = None, PlayState()  # an edit makes a check invalid

    def motion_of(self, number: int) -> MotionValue[Any] | None:
        """Return the motion of a step; None if it has no speed, a condition, or cannot be shown.

        Raises:
            InputError: The step no longer exists, or this arm cannot perform it.
        """
        step = self.draft.steps[self.draft.place_of(number)].step
        if not step.has_speed or step.only_if is not None:
            return None
        state = self._state if self._play is None else self._play.state
        continues = number == state.step and state.phase != "bad"
        at = step.at_repetition(state.repetition if continues else 1)
        motion = at.to_motion(self._arm_thread.arm.model, step.speed or self.draft.speed)
        if isinstance(motion, Replay):
            return replace(motion, path=self.draft.folder.path / motion.path)
        return None if isinstance(motion, OwnMotion) else motion

    def frames(self, client: Client) -> list[Frame]:
        """Return the program and its state, if they have changed since the last call."""
        recording = self._recording
        if recording is not None and not self._is_recording:  # it has ended
            self._recording = None
            if recording.path is not None:
                self.draft.add(ProgramStep(recording=recording.path.name))
                self._play, self._state = None, PlayState()  # it has other steps
        frames: list[Frame] = []
        if client.sent.get("program") != self.draft.revision:
            client.sent["program"] = self.draft.revision
            frames.append(self.fields())
        return frames + client.unsent(self.state_fields())

    def state_fields(self) -> dict[str, object]:
        """Return the progress of the program for a page."""
        state = self._state if self._play is None else self._play.state
        now_s = self._arm_thread.arm.context.now_s()
        return {
            "kind": "program_state",
            "phase": state.phase,
            "step": state.step,
            "repetition": state.repetition,
            "reason": state.reason,
            "problems": [
                {"step": step, "reason": reason} for step, reason in state.problems.items()
            ],
            "left": "" if self._play is None else self._play.left(now_s),
            "recording": self._is_recording,
            "pausing": self._play is not None and self._play.is_pausing and self._is_busy,
        }

    def fields(self) -> dict[str, object]:
        """Return the steps and files of the program for a page."""
        draft = self.draft
        return {
            "kind": "program",
            "steps": [
                {
                    "number": each.number,
                    "text": self._describe_shortly(each.step),
                    "title": each.step.description,
                    "action": each.step.action,
                    "has_speed": each.step.has_speed,
                    "speed": each.step.speed,
                    "wait_s": each.step.wait_s,
                    "pause": each.step.pause,
                    "only_if": each.step.only_if,
                    "grid": each.step.grid and each.step.grid.model_dump(),
                }
                for each in draft.steps
            ],
            "speed": draft.speed,
            "repeat": draft.repeat,
            "name": draft.name,
            "changed": draft.changed,
            "names": draft.names,
            "recordings": draft.recordings,
            "folder": str(draft.folder.path),
        }

    def _describe_shortly(self, step: ProgramStep) -> str:
        """Describe a step by its name, its action, or the position of its tip."""
        chain = self._arm_thread.arm.chain
        condition = f"if {step.only_if}, " if step.only_if else ""
        if step.name is not None:
            return f"{condition}{step.name}"
        if step.tip_m is not None:
            path = "" if step.path in (None, "joints") else f"{step.path} "
            grid = f", {step.grid.rows * step.grid.columns} places" if step.grid else ""
            return f"{condition}{path}to {_format_mm(step.tip_m)}{grid}"
        if not set(chain.names) <= {*step.deg, *step.m}:
            return step.description
        radians = {name: math.radians(value) for name, value in step.deg.items()}
        positions = radians | dict(step.m)
        tip_m = chain.forward(np.array([positions[name] for name in chain.names]))[:3, 3]
        return f"to {_format_mm(tip_m.tolist())}"

    @property
    def _is_busy(self) -> bool:
        return self._play is not None and self._arm_thread.job is self._play

    def _edit(self, message: Any, interaction: Interaction) -> None:  # noqa: ANN401
        draft = self.draft
        match message:
            case msg.AddStep():
                draft.add(self._make_step(message, interaction.goal), message.after)
            case msg.ChangeStep():
                keys = {"speed", "wait_s", "pause", "only_if", "grid"}
                values = message.model_dump(include=keys) | self._grid_fields(message)
                draft.change(message.step, **values)
            case msg.MoveStep():
                draft.move(message.step, message.to)
            case msg.DeleteStep():
                draft.delete(message.step)
            case msg.SetProgram():
                draft.set_options(message.speed, message.repeat)
            case msg.ProgramFile(action="new"):
                draft.clear()
            case msg.ProgramFile(action="load"):
                draft.load(message.name)
            case _:
                path = draft.save(message.name, overwrite=message.overwrite)
                interaction.log(f"Saved: {path}")

    def _run(self, message: msg.RunProgram) -> None:
        if message.action == "pause":
            if self._play is None or not self._is_busy:
                raise InputError("No program is being played.", "Nothing has changed.")
            self._play.pause()
            return
        if (
            self._play is not None
            and self._is_busy
            and self._play.state.phase == "waiting"
            and message.action == "play"
        ):
            self._play.resume()
            return
        program = self.draft.program()
        first = 0 if message.step is None else self.draft.place_of(message.step)
        numbers = tuple(each.number for each in self.draft.steps)
        before = self._play
        play = ProgramPlay(program, numbers, self.draft.folder.path, first, message.action)
        if before is not None:
            play.continue_from(before, message.step)
        self._arm_thread.request_job(play)
        self._play = play

    @property
    def _is_recording(self) -> bool:
        return self._recording is not None and self._arm_thread.job is self._recording

    def _grid_fields(self, message: msg.ChangeStep) -> dict[str, Any]:
        """Return the fields of a grid step, with what was typed or the present tip gives."""
        step = self.draft.steps[self.draft.place_of(message.step)].step
        if message.grid is None or step.grid is None or step.tip_m is None:
            return {}
        if message.corner is None:
            return {"grid": step.grid.model_dump() | message.grid}
        tip_m = _tip_m(self._arm_thread.arm, self._arm_thread.snapshot.measured)
        if message.corner == "tip_m":
            return {"tip_m": tip_m, "grid": step.grid.model_dump()}
        distance_m = step.grid.distance_m(message.corner, step.tip_m, tip_m)
        return {"grid": step.grid.model_dump() | {message.corner: distance_m}}

    def _make_step(self, message: msg.AddStep, goal: Vector | None) -> ProgramStep:
        arm = self._arm_thread.arm
        match message.what:
            case "wait":
                return ProgramStep(wait_s=message.wait_s)
            case "pause":
                return ProgramStep(pause="Continue when you are ready.")
            case "program":
                names = self.draft.folder.names()
                if message.program not in names:
                    raise UnknownNameError("program", message.program or "", names)
                return ProgramStep(program=f"{message.program}.toml")
            case "open" | "close":
                if arm.model.gripper is None:
                    raise InputError("This arm has no gripper.", "Nothing was added.")
                return ProgramStep(gripper=message.what)
            case "pose":
                arm.poses.get_pose(message.pose or "")
                return ProgramStep(pose=message.pose)
            case "recording":
                name = self.draft.folder.recording_file(message.recording or "")
                return ProgramStep(recording=name)
            case "grid":
                tip_m = _tip_m(arm, self._arm_thread.snapshot.measured)
                return ProgramStep(tip_m=tip_m, path=message.path, grid=_NEW_GRID)
            case "target" if goal is None:
                raise InputError("No target is shown.", "Drag the arm or click a point first.")
            case _:
                measured = self._arm_thread.snapshot.measured
                joints = goal if message.what == "target" and goal is not None else measured
                return _capture_step(arm, joints, message.path)


def _capture_step(arm: Arm, joints: Vector, path: str) -> ProgramStep:
    """Make the step that moves the arm to joints (n,) and leaves the gripper unchanged."""
    if path == "line":
        return ProgramStep(tip_m=_tip_m(arm, joints), path="line")
    arm.context.require_zeros()
    lower, upper = arm.limits()
    inside = np.clip(joints, lower, upper)  # a limp arm may sink a little past a limit
    deg: dict[str, float] = {}
    m: dict[str, float] = {}
    for name in arm.chain.names:
        column = arm.joint_index.column(name)
        numbers = [float(row[column]) for row in (inside, lower, upper)]
        slides = arm.model.joint(name).joint_map.unit == "m"
        places = _M_PLACES if slides else _DEG_PLACES
        value, low, high = numbers if slides else map(math.degrees, numbers)
        unit = 10.0**-places  # rounded, but not past a limit
        lowest, highest = math.ceil(low / unit) * unit, math.floor(high / unit) * unit
        at = round(min(max(value, lowest), highest), places) + 0.0  # not -0.0
        (m if slides else deg)[name] = at
    return ProgramStep(deg=deg, m=m)


def _tip_m(arm: Arm, joints: Vector) -> Point:
    """Return the tip (3,), metres, base frame, at joints (n,) moved inside their limits."""
    arm.context.require_zeros()
    inside = np.clip(joints, *arm.limits())
    tip_m = arm.chain.forward(arm.joint_index.chain_joints(inside))[:3, 3]
    x, y, z = (round(value, _TIP_PLACES) + 0.0 for value in tip_m.tolist())  # not -0.0
    return x, y, z


def _format_mm(point_m: Sequence[float]) -> str:
    return f"{', '.join(f'{1000.0 * each:z.0f}' for each in point_m)} mm"
