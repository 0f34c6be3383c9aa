"""Whole poses of six joints whose last three turns meet in a point (Pieper).

That point does not move with the turns that meet in it: it tells the joints before them, and the
orientation that is left tells the turns. Arms have either two parallel links and a wrist of three
joints, or three parallel links and a wrist of two.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from ikservo.ik.closed_form.aims import tool_at_zero
from ikservo.ik.closed_form.anatomy import Structure
from ikservo.ik.closed_form.links import Angles, inside, three_links, two_links
from ikservo.ik.closed_form.question import Question
from ikservo.ik.closed_form.three_turns import ThreeTurns
from ikservo.ik.target import Target
from ikservo.kinematics.se3 import Matrix, Vector, exp_so3

__all__ = ["by_pose", "orientations"]

# A wanted direction leaves the turn about itself free: this many are tried, the nearest first.
_TURNS_ABOUT_AIM = 24


def by_pose(asked: Question, target: Target, R: Matrix) -> Iterator[Vector]:
    """Yield the joints (dof,) that bring the point to the target with orientation R (3, 3)."""
    arm = asked.arm
    if arm.orient is None or arm.centre is None:
        return
    tool = tool_at_zero(arm, target)
    turned = R @ tool[:3, :3].T
    wanted = target.position + turned @ (arm.centre - tool[:3, 3])
    at_centre = replace(
        asked, point=arm.yaw_back.of_point(wanted), tip=arm.roll.of_point(arm.centre)
    )
    for yaw in at_centre.yaws(at_centre.tip.across(0.0)):
        left = _yaw_back(arm, yaw) @ turned
        for angles, wrist in _planar(at_centre, arm.orient, yaw, left):
            yield from _inside(at_centre, yaw, angles, wrist)


def _planar(
    asked: Question, orient: ThreeTurns, yaw: float, R: Matrix
) -> Iterator[tuple[Angles, Angles]]:
    """Yield planar and wrist angles; R (3, 3) is what is left to turn after the yaw."""
    plane, m = asked.arm.plane, asked.from_first_joint(yaw)
    links = plane.links(asked.tip.along(0.0))
    if len(links) == 3:
        l1, l2, l3 = links
        for alpha, *wrist in orient(R, sum(plane.angles(asked.start))):
            yield from ((angles, tuple(wrist)) for angles in three_links(l1, l2, l3, m, alpha))
        return
    l1, l2 = links
    for angles in two_links(l1, l2, m):
        left = exp_so3(-sum(angles) * plane.frame[2]) @ R
        near = float(asked.start[asked.arm.wrist[0].column])
        yield from ((angles, wrist) for wrist in orient(left, near))


def _inside(asked: Question, yaw: float, angles: Angles, wrist: Angles) -> Iterator[Vector]:
    plane, turns = asked.arm.plane, asked.arm.wrist
    planar = inside(angles, plane.limits, plane.angles(asked.start))
    limits = [(turn.lower, turn.upper) for turn in turns]
    held = inside(wrist, limits, tuple(float(asked.start[turn.column]) for turn in turns))
    if planar is not None and held is not None:
        yield asked.joints(yaw, planar, held)


def _yaw_back(arm: Structure, yaw: float) -> Matrix:
    return exp_so3(-yaw * arm.yaw.axis) if arm.yaw else np.eye(3)


def orientations(target: Target, R_start: Matrix) -> Iterator[Matrix]:
    """Yield orientations (3, 3) that a target allows, those near the start's first."""
    if target.rotation is not None:
        yield target.rotation
        return
    aimed = exp_so3(target.turn_left(R_start)) @ R_start
    if target.wanted_axis is None:
        yield aimed
        return
    for step in range(_TURNS_ABOUT_AIM):
        turns = (step + 1) // 2 * (1 if step % 2 else -1)
        angle = turns * 2.0 * math.pi / _TURNS_ABOUT_AIM
        yield exp_so3(angle * target.wanted_axis) @ aimed
