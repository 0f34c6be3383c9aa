"""The dialogue of ``ikservo arms new``: make an arm's folder from a description and a bus."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from ikservo.apps.importing.building import ImportOptions, build_drafts
from ikservo.apps.importing.description_sources import (
    Description,
    choose_description,
    read_foreign,
    runs_code,
)
from ikservo.apps.importing.draft import ArmDraft
from ikservo.apps.importing.draft_poses import propose_home, table_height_m
from ikservo.apps.importing.folder import check_name, check_new, load_draft
from ikservo.apps.importing.resting import find_resting_place
from ikservo.apps.importing.ruler import AXES, RulerJoint, describe_measured, parse_measured
from ikservo.apps.importing.servo_assignment import assign_servos
from ikservo.apps.importing.tree import find_structures
from ikservo.clock import RealClock
from ikservo.errors import FileFormatError, IkservoError, InputError
from ikservo.maintenance.dialogue import (
    ACCEPT,
    Entry,
    EntryDialogue,
    Notice,
    Progress,
    Question,
    Unasked,
)

_MAX_JOINTS = 12


@dataclass(frozen=True, slots=True)
class NewArm:
    """The user's options for a new arm.

    Attributes:
        name: The name of the arm.
        folder: The folder in which the arm's folder is created.
        source: A description, or a folder with one; None: the arm is measured.
        file: The description file in the folder ``source``.
        joints: Measured joints, base to tip, if there is no description.
        packages: Folders of packages, by name.
        arguments: Arguments of a xacro, by name.
        allow_xacro: Whether the expressions in a xacro may be run.
        overwrite: Whether files of an existing folder may be replaced.
        options: The choices about the arm.
        port: The port of the arm's servos; None if they are not connected.
    """

    name: str
    folder: Path
    source: Path | None = None
    file: str | None = None
    joints: tuple[RulerJoint, ...] = ()
    packages: Mapping[str, Path] = field(default_factory=dict[str, Path])
    arguments: Mapping[str, str] = field(default_factory=dict[str, str])
    allow_xacro: bool = False
    overwrite: bool = False
    options: ImportOptions = field(default_factory=ImportOptions)
    port: str | None = None


def draft_new_arm(new: NewArm) -> EntryDialogue[list[ArmDraft]]:
    """Draft the files of one or more arms; write nothing.

    Raises:
        InputError: Options contradict each other, or the folder exists; the message names them.
        FileFormatError: The description cannot be used; the message names the place.
        UnknownNameError: The description has no such link or joint.
    """
    check_name(new.name)
    check_new([new.name], new.folder, overwrite=new.overwrite)
    description = yield from _read(new)
    options = yield from _choose_tips(description, new.options)
    building = build_drafts(description, new.name, options)
    clock = RealClock()
    started_s = clock.now_s()
    while True:
        try:
            step = next(building)
        except StopIteration as end:
            drafts: list[ArmDraft] = end.value
            break
        if not step.done:
            yield Notice(f"Fitting capsules to {step.count} meshes: a few seconds for each.")
        what = f"mesh {step.done + 1} of {step.count}: {step.name}"
        yield Progress(what, step.done, step.count, clock.now_s() - started_s)
    check_new([draft.name for draft in drafts], new.folder, overwrite=new.overwrite)
    for draft in drafts:
        yield from _propose_home(draft)
    if new.port:
        yield from assign_servos(drafts, new.port, options.servos)
    for draft in drafts:
        yield from _find_rest(draft)
    return drafts


def _read(new: NewArm) -> EntryDialogue[Description]:
    if new.source is None:
        joints = new.joints or (yield from _ask_joints())
        return describe_measured(new.name, joints)
    if new.joints:
        raise InputError("--joint is for an arm without a description.", "Leave out --from.")
    if not new.source.exists():
        raise FileFormatError(new.source, "", "it does not exist", "a file or folder")
    path = choose_description(new.source, new.file)
    allowed = new.allow_xacro
    if not allowed and runs_code(path):
        question = (f"{path.name} is a xacro file. Expanding it runs the Python expressions in it "
                    "and in the files that it includes. Run them?")  # fmt: skip
        allowed = (yield Question(question, Unasked.NO)) == ACCEPT
    yield Progress(f"reading {path.name}")
    folder = new.source if new.source.is_dir() else None
    return read_foreign(path, new.packages, new.arguments, allow_xacro=allowed, folder=folder)


def _ask_joints() -> EntryDialogue[tuple[RulerJoint, ...]]:
    """Ask for the joints of an arm that stands upright, base to tip."""
    yield Notice("Imagine the arm standing upright. Axes: z turns it, y bends it forwards, "
                 "x to the side.")  # fmt: skip
    option = "--from FILE, or --joint NAME=AXIS:METRES for each joint"
    count = yield Entry("How many joints, without the gripper?", option,
                        choices=tuple(str(i) for i in range(1, _MAX_JOINTS + 1)))  # fmt: skip
    joints: list[RulerJoint] = []
    for i in range(1, int(count or "1") + 1):
        axis = yield Entry(f"Joint {i}: axis", option, "z" if i == 1 else "y", tuple(AXES))
        while True:
            length = yield Entry(f"Joint {i}: distance to the next, in metres", option)
            try:
                joints.append(parse_measured(f"joint_{i}={axis}:{length}"))
                break
            except InputError as error:
                yield Notice(error.command_message)
    return tuple(joints)


def _choose_tips(description: Description, options: ImportOptions) -> EntryDialogue[ImportOptions]:
    """Ask which link is the tip, if there are several candidates."""
    if options.tips or options.base:
        return options
    try:
        structures = find_structures(description.urdf, (), options.gripper)
    except InputError as error:
        if "arms, with the tips" not in error.command_message:
            raise
        asked = f"{error.command_message} Which tips, separated by spaces? Each becomes one arm."
        answer = yield Entry(asked, error.command_hint.partition(": ")[2])
        return replace(options, tips=tuple((answer or "").split()))
    only = structures[0]
    if only.other_tips:
        choices = (only.tip, *only.other_tips)
        answer = yield Entry("Which link is the tip?", "--tip LINK", only.tip, choices)
        return replace(options, tips=(answer or only.tip,))
    return options


def _propose_home(draft: ArmDraft) -> EntryDialogue[None]:
    """Search for a pose ``home``, and use it as ``rest`` until a rest pose is found."""
    start = {
        joint.name: min(max(0.0, draft.joint(joint.name).lower), draft.joint(joint.name).upper)
        for joint in draft.joints
    }
    draft.poses = {"rest": start, "home": start}
    yield Progress(f"searching for a start pose of {draft.name}")
    table_m = table_height_m(load_draft(draft))
    if table_m < draft.floor_m:
        draft.decisions.append(
            f"The table was set {1000 * (draft.floor_m - table_m):.0f} mm lower, because shapes "
            "that turn just above it are thicker than the parts."
        )
        draft.floor_m = table_m
    home = {**start, **propose_home(load_draft(draft))}
    slides = [joint.name for joint in draft.joints if joint.m_per_turn and not joint.is_gripper]
    draft.poses = {"rest": home, "home": home}
    if len(slides) > 1:
        retracted = {name: draft.joint(name).lower for name in slides}
        draft.poses["retracted"] = {**home, **retracted}
        draft.decisions.append("In the pose retracted all slides are at their lower limits; parts "
                               "of a telescope may overlap as much as in this pose.")  # fmt: skip
    draft.decisions.append(
        "The pose home is free of collisions, with the tool in front. You can change it."
    )


def _find_rest(draft: ArmDraft) -> EntryDialogue[None]:
    """Find a draft's pose ``rest``: the posture in which the limp simulated arm comes to rest."""
    yield Progress(f"letting the limp simulated {draft.name} come to rest")
    try:
        with tempfile.TemporaryDirectory() as name:
            load_draft(draft, Path(name))
            place = find_resting_place(Path(name))
    except FileFormatError:
        raise
    except IkservoError as error:
        draft.decisions.append(
            f"The pose rest equals home, because its simulation failed ({error.command_message})"
        )
        return
    draft.poses = {**draft.poses, "rest": place.positions}
    draft.decisions.append(
        f"The pose rest is where the simulated arm lay {place.sank_s:.0f} s after torque went "
        f"off in the pose home. A real arm must stay there when it is limp; check this."
    )
    if not place.still:
        draft.decisions.append(
            "The simulated arm was still moving then. Put the real arm there and check."
        )
    if math.isfinite(place.gap_m) and place.gap_m < 0.0:
        draft.decisions.append(
            f"In the pose 'rest', {' and '.join(place.pair)} overlap by "
            f"{-1000 * place.gap_m:.0f} mm: the collision capsules are thicker than the parts, or "
            "these parts touch when the arm is limp."
        )
