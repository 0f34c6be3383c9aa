"""Find the arm in the kinematic tree of an imported robot, and reduce the tree to that arm."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ikservo.errors import InputError, UnknownNameError
from ikservo.kinematics.se3 import exp_so3, make_pose, rotation_rpy
from ikservo.model.base_placement import moved_shape, pose_origin, pose_rpy
from ikservo.model.urdf_types import Triple, Urdf, UrdfJoint, UrdfJointType, UrdfLink

_TIP_WORDS = ("gripper_frame", "tcp", "ee_gripper", "grasp", "end_effector", "tool", "tip", "_ee",
              "ee_", "flange", "hand", "camera_lens")  # fmt: skip
_GRIPPER_WORDS = re.compile(r"grip|finger|jaw|claw|hand|pinc|carriage", re.IGNORECASE)
_MIN_OWN_JOINTS = 3  # a branch is a further arm if it has at least this many joints of its own


@dataclass(frozen=True, slots=True)
class Structure:
    """The links and joints of one arm in a tree.

    Attributes:
        tip: The link of the tool.
        joints: The joints that move the tip and do not mimic other joints, base to tip.
        gripper: The joint of the jaws; empty if there is none.
        other_tips: Other links that could be the tip.
    """

    tip: str
    joints: tuple[str, ...]
    gripper: str
    other_tips: tuple[str, ...] = ()


def moving_joints(urdf: Urdf) -> dict[str, tuple[str, ...]]:
    """Return the joints that move each link, by link in file order; mimics count as their leader.

    Each link's joints are listed from base to tip.
    """
    found = {urdf.root: tuple[str, ...]()}
    for joint in _joints_below(urdf, urdf.root):
        leader = joint.mimic.joint if joint.mimic else joint.name
        above = found[joint.parent]
        is_new = joint.kind.is_movable and leader not in above
        found[joint.child] = (*above, leader) if is_new else above
    return {link.name: found[link.name] for link in urdf.links if link.name in found}


def _joints_below(urdf: Urdf, base: str) -> Iterator[UrdfJoint]:
    """Yield all joints below a link, from base to tip."""
    carried: dict[str, list[UrdfJoint]] = {}
    for joint in urdf.joints:
        carried.setdefault(joint.parent, []).append(joint)
    waiting = [base]
    while waiting:
        joints = carried.get(waiting.pop(), ())
        yield from joints
        waiting += [joint.child for joint in joints]


def find_structures(
    urdf: Urdf, tips: Sequence[str] = (), gripper: str | None = None
) -> list[Structure]:
    """Find the arms of a tree: one arm for each tip, or the only arm.

    An empty ``gripper`` means no jaws. If it is None, jaws are searched for; if there are no
    ``tips``, the tip is searched for.

    Raises:
        UnknownNameError: There is no such link or joint.
        InputError: Nothing moves, or there are several arms; the message names them.
    """
    if gripper and gripper not in {joint.name for joint in urdf.joints if joint.kind.is_movable}:
        raise UnknownNameError(
            "joint", gripper, [joint.name for joint in urdf.joints if joint.kind.is_movable]
        )
    if tips:
        return [_structure(urdf, urdf.link(tip).name, gripper) for tip in tips]
    found = _possible_arms(urdf, gripper)
    if not found:
        raise InputError("The description has no movable joint.", "An arm needs at least one.")
    if len(found) > 1:
        named = " ".join(f"--tip {each.tip}" for each in found)
        raise InputError(
            f"The description has {len(found)} arms, with the tips "
            f"{', '.join(each.tip for each in found)}.",
            f"Choose one, or make one arm from each: {named}",
        )
    return found


def _possible_arms(urdf: Urdf, gripper: str | None) -> list[Structure]:
    """Return one arm per branch with enough joints of its own, the longest first."""
    jaws = _jaws(urdf) if gripper is None else [gripper] if gripper else []
    joints_to = moving_joints(urdf)
    inner = {joint.parent for joint in urdf.joints}
    free = [name for name, moving in joints_to.items() if moving and not set(moving) & set(jaws)]
    # If all leaves are behind the jaws, the palm is the tip.
    leaves = [name for name in free if name not in inner]
    palms = [joint.parent for joint in urdf.joints if joint.name in jaws and joint.parent in free]
    candidates = sorted(
        dict.fromkeys([*leaves, *palms]),
        key=lambda name: (-len(joints_to[name]), _word_rank(name), name in palms),
    )
    if not candidates:
        return [_structure(urdf, name, gripper) for name in free[-1:]]
    arms: list[str] = []
    for name in candidates:
        taken = {joint for arm in arms for joint in joints_to[arm]}
        own = [joint for joint in joints_to[name] if joint not in taken]
        if not arms or len(own) >= _MIN_OWN_JOINTS:
            arms.append(name)
    return [_structure(urdf, name, gripper, candidates) for name in arms]


def _structure(
    urdf: Urdf, tip: str, gripper: str | None, candidates: Sequence[str] = ()
) -> Structure:
    joints_to = moving_joints(urdf)
    joints = joints_to[tip]
    if not joints:
        raise InputError(f"No joint moves the link {tip}.", "Give another --tip.")
    if gripper is None:
        gripper = _own_jaws(urdf, joints)
    if gripper in joints:
        hint = "Give the palm as --tip, or --gripper none."
        raise InputError(f"The jaw joint {gripper} moves the tip {tip}.", hint)
    others = [name for name in candidates if name != tip and joints_to[name] == joints]
    return Structure(tip, joints, gripper, tuple(others))


def _word_rank(name: str) -> int:
    """Rank a link by its name: the lower the rank, the more likely the link is the tool."""
    lowered = name.lower()
    return next((i for i, word in enumerate(_TIP_WORDS) if word in lowered), len(_TIP_WORDS))


def _jaws(urdf: Urdf) -> list[str]:
    """Return the joints that seem to be jaws: named like jaws, at the end of their branch."""
    movable = {joint.name: joint for joint in urdf.joints if joint.kind.is_movable}
    leaders = {joint.mimic.joint for joint in movable.values() if joint.mimic}
    above = moving_joints(urdf)
    last = {moving[-1] for moving in above.values() if moving} - {
        name for moving in above.values() for name in moving[:-1]
    }
    return [
        name
        for name, joint in movable.items()
        if joint.mimic is None
        and (name in last or name in leaders)
        and (_GRIPPER_WORDS.search(name) or _GRIPPER_WORDS.search(joint.child))
        and len(above[joint.child]) > 1
        and not _is_wrist(urdf, joint)
    ]


def _is_wrist(urdf: Urdf, joint: UrdfJoint) -> bool:
    """Check whether a joint is a wrist: it carries a tool, or is a "hand" that turns too far.

    The range is ignored for other names of jaws, because some programs export ±180° for all joints.
    """
    behind = [joint.child, *(each.child for each in _joints_below(urdf, joint.child))]
    tools = [name for name in behind if not _GRIPPER_WORDS.search(name)]
    words = {word.lower() for word in _GRIPPER_WORDS.findall(f"{joint.name} {joint.child}")}
    turns_hand = words == {"hand"} and joint.kind is UrdfJointType.REVOLUTE
    too_far = turns_hand and math.pi < joint.upper - joint.lower < math.inf
    return too_far or any(_word_rank(name) < len(_TIP_WORDS) for name in tools)


def _own_jaws(urdf: Urdf, joints: Sequence[str]) -> str:
    """Return the likeliest jaw joint that the last joint of an arm carries; empty without jaws."""
    movable = {joint.name: joint for joint in urdf.joints}
    leaders = [joint.mimic.joint for joint in movable.values() if joint.mimic]
    above = moving_joints(urdf)
    found = [
        name
        for name in _jaws(urdf)
        if name not in joints and above[movable[name].parent][-1:] == joints[-1:]
    ]

    def merit(name: str) -> tuple[bool, int]:
        return math.isfinite(movable[name].upper), leaders.count(name)

    return max(found, key=merit, default="")


def below(urdf: Urdf, base: str) -> tuple[Urdf, list[str]]:
    """Return the tree below a link, and the names of the joints that were left out.

    Raises:
        UnknownNameError: There is no such link.
    """
    root = urdf.link(base).name
    kept = {root, *(joint.child for joint in _joints_below(urdf, root))}
    joints = tuple(joint for joint in urdf.joints if joint.parent in kept)
    names = {joint.name for joint in joints}
    joints = tuple(
        replace(joint, mimic=None) if joint.mimic and joint.mimic.joint not in names else joint
        for joint in joints
    )
    links = tuple(link for link in urdf.links if link.name in kept)
    left_out = [joint.name for joint in urdf.joints if joint.name not in names]
    return replace(urdf, links=links, joints=joints, root=base), left_out


def fix_joints(urdf: Urdf, kept: Collection[str]) -> tuple[Urdf, dict[str, float]]:
    """Fix all joints except the given joints and their mimics, at zero or the nearest limit.

    Returns:
        The tree, and the positions [rad or m] of the fixed joints that mimic no other joint.
    """
    positions = {
        joint.name: min(max(0.0, joint.lower), joint.upper)
        for joint in urdf.joints
        if joint.kind.is_movable and joint.mimic is None and joint.name not in kept
    }
    joints: list[UrdfJoint] = []
    for joint in urdf.joints:
        leader = joint.mimic.joint if joint.mimic else joint.name
        if leader in positions:
            at = positions[leader]
            at = joint.mimic.multiplier * at + joint.mimic.offset if joint.mimic else at
            motion = at * np.array(joint.axis)
            slides = joint.kind is UrdfJointType.PRISMATIC
            moved = make_pose(motion) if slides else make_pose(np.zeros(3), exp_so3(motion))
            T = make_pose(joint.xyz_m, rotation_rpy(*joint.rpy_rad)) @ moved
            joints.append(replace(
                joint, kind=UrdfJointType.FIXED, xyz_m=pose_origin(T), rpy_rad=pose_rpy(T),
                lower=0.0, upper=0.0, mimic=None,
            ))  # fmt: skip
        else:
            joints.append(joint)
    return replace(urdf, joints=tuple(joints)), positions


def lump_base(urdf: Urdf) -> Urdf:
    """Move the shapes of all links that are fixed to the root to the root; keep their frames.

    Only the root may touch the table, so the root must have all parts that stand on it.
    """
    poses, links = {urdf.root: np.eye(4)}, {link.name: link for link in urdf.links}
    grew = True
    while grew:
        grew = False
        for joint in urdf.joints:
            fixed = not joint.kind.is_movable and joint.parent in poses
            if fixed and joint.child not in poses:
                T = make_pose(joint.xyz_m, rotation_rpy(*joint.rpy_rad))
                poses[joint.child], grew = poses[joint.parent] @ T, True
    root = links[urdf.root]
    collisions, visuals, colours = [*root.collisions], [*root.visuals], [*_colours(root)]
    for name, T in poses.items():
        if name != urdf.root:
            collisions += [moved_shape(shape, T) for shape in links[name].collisions]
            visuals += [moved_shape(shape, T) for shape in links[name].visuals]
            colours += _colours(links[name])
            links[name] = replace(links[name], collisions=(), visuals=(), colours=())
    links[urdf.root] = replace(
        root, collisions=tuple(collisions), visuals=tuple(visuals), colours=tuple(colours)
    )
    return replace(urdf, links=tuple(links.values()))


def _colours(link: UrdfLink) -> tuple[Triple | None, ...]:
    return link.colours or (None,) * len(link.visuals)


_UNUSUAL = re.compile(r"[^A-Za-z0-9_-]")
_MAX_NAME_CHARS = 64


def rename_joints(urdf: Urdf) -> tuple[Urdf, dict[str, str]]:
    """Give the joints names that an arm file allows; return the new names by old name."""
    names: dict[str, str] = {}
    for joint in urdf.joints:
        name = _UNUSUAL.sub("_", joint.name)[: _MAX_NAME_CHARS - 4]
        count = 2
        while name in names.values():
            name, count = f"{name}_{count}", count + 1
        names[joint.name] = name
    joints = tuple(
        replace(
            joint,
            name=names[joint.name],
            mimic=joint.mimic and replace(joint.mimic, joint=names[joint.mimic.joint]),
        )
        for joint in urdf.joints
    )
    return replace(urdf, joints=joints), {old: new for old, new in names.items() if old != new}
