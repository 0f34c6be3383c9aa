"""Convert the tree of an imported description to one draft per arm."""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from ikservo.apps.importing.description_sources import Description
from ikservo.apps.importing.draft import (
    ArmDraft,
    DraftJoint,
    DraftServo,
    format_range,
    guessed_m_per_turn,
)
from ikservo.apps.importing.shapes import MeshStep, ShapeConversion, convert_shapes
from ikservo.apps.importing.tree import (
    Structure,
    below,
    find_structures,
    fix_joints,
    lump_base,
    rename_joints,
)
from ikservo.errors import BadValueError, InputError, UnknownNameError
from ikservo.kinematics.dynamics import Dynamics
from ikservo.kinematics.se3 import make_pose, rotation_rpy
from ikservo.model.arm_model import Model, link_masses
from ikservo.model.base_placement import parse_frame, turn_base
from ikservo.model.load_lag import can_lift, spread_postures
from ikservo.model.model_loading import build_chain
from ikservo.model.servo_torque import find_servo_torque
from ikservo.model.urdf_types import Urdf, UrdfJoint, UrdfJointType
from ikservo.registers import control_table

_LIFTERS = (("STS3215", 7.4), ("STS3215", 12.0), ("STS3250", None), ("XM540-W270", None))
"""The servo models that the import may assume, the weakest first."""
_MAX_SLIDE_M = 1.0  # assumed travel of a slide without limits, at most
_MIN_FLOOR_M = -0.003  # parts that reach less far below the base do not lower the table


@dataclass(frozen=True, slots=True)
class ImportOptions:
    """The user's decisions; the import makes and notes all other decisions itself.

    Attributes:
        base: The link at which the used part of the tree begins.
        tips: The links of the tools; one arm is made for each.
        gripper: The joint of the jaws; empty: no jaws; None: search for it.
        base_frame: The rotation and shift of the base frame, in words.
        limits: Ranges by joint, degrees or millimetres.
        servos: Servos by joint.
        servo_model: The model of the servos for which none is given.
        m_per_turn: Metres per turn of the servo, by sliding joint.
        baud: Baud rate of the bus, bit/s; 0: the usual rate of the family.
    """

    base: str | None = None
    tips: tuple[str, ...] = ()
    gripper: str | None = None
    base_frame: str | None = None
    limits: Mapping[str, tuple[float, float]] = field(
        default_factory=dict[str, tuple[float, float]]
    )
    servos: Mapping[str, tuple[DraftServo, ...]] = field(
        default_factory=dict[str, tuple[DraftServo, ...]]
    )
    servo_model: str | None = None
    m_per_turn: Mapping[str, float] = field(default_factory=dict[str, float])
    baud: int = 0


def build_drafts(
    description: Description, name: str, options: ImportOptions
) -> Generator[MeshStep, object, list[ArmDraft]]:
    """Build a draft of each arm of a description, without poses; yield before each mesh.

    If there are several arms, the names of their tips are appended to ``name``.

    Raises:
        UnknownNameError: A link, joint or servo model does not exist.
        InputError: There is no arm, or there are several and no tip was chosen.
    """
    urdf, decisions, dropped = description.urdf, list[str](), list(description.notes)
    if options.base:
        urdf, left_out = below(urdf, options.base)
        decisions.append(f"The base is the link {options.base}; left out: {_listed(left_out)}.")
    urdf, renamed = rename_joints(urdf)
    decisions += [f"Joint {old} was renamed to {new}." for old, new in renamed.items()]
    if options.base_frame:
        urdf = turn_base(urdf, parse_frame(options.base_frame))
        decisions.append(f"Placement of the base in the description: {options.base_frame}.")
    decisions += [f"Package {each} is in {folder}."
                  for each, folder in description.packages.used.items()]  # fmt: skip
    structures = find_structures(urdf, options.tips, options.gripper)
    joints = [name for each in structures for name in (*each.joints, each.gripper) if name]
    _check_names(options, urdf, joints)
    shapes = yield from convert_shapes(urdf)
    dropped += shapes.notes
    drafts: list[ArmDraft] = []
    taken_ids = {servo.id for servos in options.servos.values() for servo in servos}
    for structure in structures:
        taken = {joint.name for draft in drafts for joint in draft.joints}
        draft = ArmDraft(
            name if len(structures) == 1 else f"{name}_{structure.tip}",
            description.path.name,
            shapes.urdf,
            structure.tip,
            pictures=shapes.pictures,
            fits=shapes.fits,
            decisions=list(decisions),
            dropped=list(dropped),
        )
        own = [
            each for each in (*structure.joints, structure.gripper) if each and each not in taken
        ]
        _shape_draft(draft, structure, options, shapes, own)
        _add_servos(draft, structure.gripper, options, own, taken_ids)
        drafts.append(draft)
    return drafts


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names) or "nothing"


def _check_names(options: ImportOptions, urdf: Urdf, driven: Sequence[str]) -> None:
    for name in (*options.limits, *options.servos, *options.m_per_turn):
        if name not in driven:
            raise UnknownNameError("joint", name, driven)
    slides = {joint.name for joint in urdf.joints if joint.kind is UrdfJointType.PRISMATIC}
    for name in options.m_per_turn:
        if name not in slides:
            raise InputError(f"{name} turns.", "--m-per-turn is only for joints that slide.")
    models = [servo.model for servos in options.servos.values() for servo in servos if servo.model]
    for model in (*models, *([options.servo_model] if options.servo_model else [])):
        control_table(model)


def _shape_draft(
    draft: ArmDraft,
    structure: Structure,
    options: ImportOptions,
    shapes: ShapeConversion,
    own: Sequence[str],
) -> None:
    """Reduce a draft's tree to its own joints, limit their ranges, and find the table height."""
    note = draft.decisions.append
    shared = [name for name in structure.joints if name not in own]
    urdf, fixed = fix_joints(draft.urdf, own)
    if shared:
        note(f"Fixed here, because the first arm drives them: {_listed(shared)}.")
    others = [name for name in fixed if name not in shared]
    if others:
        note(f"Fixed, because the tip does not need them: {_listed(others)}.")
    urdf = replace(
        urdf,
        name=draft.name,
        joints=tuple(
            _limited(joint, options, note) if joint.name in own else joint for joint in urdf.joints
        ),
    )
    limited = {joint.name: joint for joint in urdf.joints}
    for joint in urdf.joints:
        mimic, is_slide = joint.mimic, joint.kind is UrdfJointType.PRISMATIC
        if mimic is not None and is_slide and not math.isfinite(joint.upper - joint.lower):
            leader = next(each for each in urdf.joints if each.name == mimic.joint)
            ends = sorted(mimic.multiplier * x + mimic.offset for x in (leader.lower, leader.upper))
            limited[joint.name] = replace(joint, lower=ends[0], upper=ends[1])
    urdf = replace(urdf, joints=tuple(limited.values()))
    low_m = _lowest_m(urdf, shapes)
    if low_m < _MIN_FLOOR_M:
        draft.floor_m = low_m
        note(f"The table is at z = {1000 * low_m:.0f} mm, below the base.")
    draft.urdf = lump_base(urdf)
    others = f"; others: {_listed(structure.other_tips)}" if structure.other_tips else ""
    note(f"The tip is the link {draft.tip}{others}.")
    note(f"The jaws are moved by {structure.gripper}." if structure.gripper else "No gripper.")


def _add_servos(
    draft: ArmDraft, gripper: str, options: ImportOptions, own: Sequence[str], taken_ids: set[int]
) -> None:
    """Add the joints with the user's servos, or with one servo each that has the next free id."""
    note = draft.decisions.append
    model, why = _servo_model(draft, options)
    if not options.servos:
        note(f"The servos are {model}{why}. Their ids count up from base to tip.")
    links = draft.urdf.links
    weightless = [
        link.name
        for link in links
        if link.name != draft.urdf.root and link.collisions and link.mass_kg <= 0.0
    ]
    if weightless and any(link.mass_kg > 0.0 for link in links):
        note(f"No mass is given for {_listed(weightless)}: servos and the rest pose are chosen "
            f"as if these links weighed nothing.")  # fmt: skip
    for name in own:
        body = draft.joint(name)
        given = options.servos.get(name)
        if given:
            servos = tuple(replace(servo, model=servo.model or model) for servo in given)
        else:
            servo_id = next(i for i in range(1, 253) if i not in taken_ids)
            taken_ids.add(servo_id)
            servos = (DraftServo(servo_id, model),)
        slide = options.m_per_turn.get(name)
        if body.kind is UrdfJointType.PRISMATIC and slide is None:
            slide = guessed_m_per_turn(body)
            note(f"{name} slides; it is assumed that a turn of its servo moves it by "
                 f"{1000 * slide:.1f} mm (--m-per-turn {name}=METRES).")  # fmt: skip
        draft.joints = (*draft.joints, DraftJoint(name, name == gripper, servos, slide))
    draft.baud = options.baud


def _limited(joint: UrdfJoint, options: ImportOptions, say: Callable[[str], None]) -> UrdfJoint:
    """Set a joint's limits as the user gave them, or else reduce them to the range of a servo."""
    slides = joint.kind is UrdfJointType.PRISMATIC
    if joint.name in options.limits:
        given, unit = options.limits[joint.name], "mm" if slides else "°"
        low, high = (value * (0.001 if slides else math.pi / 180.0) for value in given)
        if not low < high:
            found = f"{given[0]:g} to {given[1]:g} {unit}"
            raise BadValueError(f"The range of {joint.name}", found, "low < high")
    elif joint.kind is UrdfJointType.CONTINUOUS:
        low, high = -math.pi, math.pi
        say(f"{joint.name} has no limits in the description and gets ±180°, half a servo turn each "
            f"way (--limits {joint.name}=LOW:HIGH).")  # fmt: skip
    elif not slides and joint.upper - joint.lower > math.tau + 1e-3:
        low, high = max(joint.lower, -math.pi), min(joint.upper, math.pi)
        say(f"{joint.name} could make more than a turn ({format_range(joint)}): limited to ±180°.")
    elif slides and joint.upper - joint.lower > _MAX_SLIDE_M:
        low = min(max(joint.lower, 0.0), joint.upper - _MAX_SLIDE_M)
        high, bounded = low + _MAX_SLIDE_M, math.isfinite(joint.upper - joint.lower)
        how_far = format_range(joint) if bounded else "without limits"
        say(f"{joint.name} slides {how_far}: {1000 * low:.0f} to {1000 * high:.0f} mm are used "
            f"(--limits {joint.name}=LOW:HIGH).")  # fmt: skip
    else:
        return joint
    kind = joint.kind if slides else UrdfJointType.REVOLUTE
    return replace(joint, kind=kind, lower=low, upper=high)


def _lowest_m(urdf: Urdf, shapes: ShapeConversion) -> float:
    """Return the height of the lowest part fixed to the base, in its frame; 0 without parts."""
    poses, lowest_m = {urdf.root: np.eye(4)}, list[float]()
    for _ in urdf.joints:  # each pass gets at least one level deeper
        for joint in urdf.joints:
            if joint.parent in poses and joint.child not in poses and not joint.kind.is_movable:
                T = make_pose(joint.xyz_m, rotation_rpy(*joint.rpy_rad))
                poses[joint.child] = poses[joint.parent] @ T
    for link, T in poses.items():
        points = shapes.corners_m.get(link)
        if points is not None:
            lowest_m.append(float((points @ T[2, :3]).min() + T[2, 3]))
    return min(lowest_m, default=0.0)


def _servo_model(draft: ArmDraft, options: ImportOptions) -> tuple[str, str]:
    """Choose the servo model and give the reason; drop the masses if no servo could lift them."""
    loads = _loads_nm(draft, options)
    choices = [(options.servo_model, None)] if options.servo_model else [*_LIFTERS]
    for model, supply_v in choices:
        torque = find_servo_torque(model, supply_v)
        draft.supply_v = supply_v
        if torque and all(can_lift(torque, load) for load in loads.values()):
            lifting = (
                "the weakest that can lift the arm"
                if loads
                else "assumed because the arm has no masses"
            )
            volts = f" at {supply_v:g} V" if supply_v else ""
            return model, f"{volts}, {'as chosen' if options.servo_model else lifting}"
    if options.servo_model or options.servos:
        return choices[0][0], (
            ", as chosen; with the masses in the description it cannot lift the arm"
        )
    name, load = max(loads.items(), key=lambda each: each[1])
    draft.urdf = replace(
        draft.urdf, links=tuple(replace(link, mass_kg=0.0) for link in draft.urdf.links)
    )
    draft.dropped.append(
        f"The masses, because {name} would need {load:.0f} N m, which no servo in the catalogue "
        f"has. The simulated arm weighs nothing; real servos could not carry it."
    )
    return _LIFTERS[-1][0], ", the strongest, because none could lift the arm"


def _loads_nm(draft: ArmDraft, options: ImportOptions) -> dict[str, float]:
    """Return the largest gravity torque at each servo, N m; empty if masses are unknown."""
    chain = build_chain(draft.urdf, draft.tip)
    model = Model.from_geometry(draft.name, draft.name, chain, draft.urdf, Path())
    masses = link_masses(model, chain)
    if not masses:
        return {}
    body = Dynamics.from_masses(chain, masses)
    heaviest = np.abs(body.gravity_torques(spread_postures(chain))).max(axis=0)
    per_horn_rad = {
        joint.name: (options.m_per_turn.get(joint.name) or guessed_m_per_turn(joint)) / math.tau
        for joint in draft.urdf.joints
        if joint.kind is UrdfJointType.PRISMATIC
    }
    return {
        name: float(load) * per_horn_rad.get(name, 1.0)
        for name, load in zip(chain.names, heaviest, strict=True)
    }
