"""Closed forms for a full pose: wrist angles and reach.

That point does not move with the turns that meet in it: it tells the joints before them, and the
orientation that is left tells the turns. Arms have either two parallel links and a wrist of three
joints, or three parallel links and a wrist of two.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from ikservo.ik.closed_form_problem import AnalyticProblem, Candidate, tool_at_zero
from ikservo.ik.closed_form_structure import ArmStructure
from ikservo.ik.planar import Angles, solve_planar_2r, solve_planar_3r, within_limits
from ikservo.ik.problem import Target
from ikservo.ik.subproblems import EulerAngles, solve_yaw_roll
from ikservo.kinematics.arrays import Matrix, Vector
from ikservo.kinematics.se3 import exp_so3

__all__ = ["candidate_orientations", "solve_direction", "solve_pose", "solve_position"]


# A wanted direction leaves the turn about itself free: this many are tried, the nearest first.
_TURNS_ABOUT_AIM = 24


def solve_pose(asked: AnalyticProblem, target: Target, R: Matrix) -> Iterator[Vector]:
    """Yield the joints (dof,) that bring the point to the target with orientation R (3, 3)."""
    arm = asked.arm
    if arm.orient is None or arm.centre is None:
        return
    tool = tool_at_zero(arm, target)
    turned = R @ tool[:3, :3].T
    wanted = target.position + turned @ (arm.centre - tool[:3, 3])
    at_centre = replace(
        asked, point=arm.yaw_back.trace_point(wanted), tip=arm.roll.trace_point(arm.centre)
    )
    for yaw in at_centre.yaws(at_centre.tip.normal_part(0.0)):
        left = _inverse_yaw(arm, yaw) @ turned
        for angles, wrist in _planar_and_wrist_angles(at_centre, arm.orient, yaw, left):
            yield from _joints_within_limits(at_centre, yaw, angles, wrist)


def _planar_and_wrist_angles(
    asked: AnalyticProblem, orient: EulerAngles, yaw: float, R: Matrix
) -> Iterator[tuple[Angles, Angles]]:
    """Yield planar and wrist angles; R (3, 3) is what is left to turn after the yaw."""
    plane, m = asked.arm.plane, asked.target_in_plane(yaw)
    links = plane.links(asked.tip.in_plane_part(0.0))
    if len(links) == 3:
        l1, l2, l3 = links
        for alpha, *wrist in orient(R, sum(plane.angles(asked.start))):
            yield from ((angles, tuple(wrist)) for angles in solve_planar_3r(l1, l2, l3, m, alpha))
        return
    l1, l2 = links
    for angles in solve_planar_2r(l1, l2, m):
        left = exp_so3(-sum(angles) * plane.frame[2]) @ R
        near = float(asked.start[asked.arm.wrist[0].column])
        yield from ((angles, wrist) for wrist in orient(left, near))


def _joints_within_limits(
    asked: AnalyticProblem, yaw: float, angles: Angles, wrist: Angles
) -> Iterator[Vector]:
    plane, turns = asked.arm.plane, asked.arm.wrist
    planar = within_limits(angles, plane.limits, plane.angles(asked.start))
    limits = [(turn.lower, turn.upper) for turn in turns]
    held = within_limits(wrist, limits, tuple(float(asked.start[turn.column]) for turn in turns))
    if planar is not None and held is not None:
        yield asked.joints(yaw, planar, held)


def _inverse_yaw(arm: ArmStructure, yaw: float) -> Matrix:
    return exp_so3(-yaw * arm.yaw.axis) if arm.yaw else np.eye(3)


def candidate_orientations(target: Target, R_start: Matrix) -> Iterator[Matrix]:
    """Yield orientations (3, 3) that a target allows, those near the start's first."""
    if target.rotation is not None:
        yield target.rotation
        return
    aimed = exp_so3(target.orientation_error(R_start)) @ R_start
    if target.wanted_axis is None:
        yield aimed
        return
    for step in range(_TURNS_ABOUT_AIM):
        turns = (step + 1) // 2 * (1 if step % 2 else -1)
        angle = turns * 2.0 * math.pi / _TURNS_ABOUT_AIM
        yield exp_so3(angle * target.wanted_axis) @ aimed


# Rolls to try, as parts of the range, where the start's own does not reach.
_ROLLS = (0.5, 0.25, 0.75, 0.0, 1.0, 0.125, 0.375, 0.625, 0.875)


def solve_position(asked: AnalyticProblem) -> tuple[Candidate, ...]:
    """Return the joints that meet the point with the wrist as at the start.

    The tool is turned as near to the aims as the point allows. A roll that cannot meet the point
    is replaced by the first of a few others that can.
    """
    for roll in (asked.start_roll, *_alternative_rolls(asked)):
        if found := tuple(_candidates_with_roll(asked, roll)):
            return found
    return ()


def solve_direction(asked: AnalyticProblem) -> Iterator[Candidate]:
    """Yield the joints that meet the point across and the aims as far as they can.

    Without a roll, or with one that moves nothing, point and aims ask for more than the arm can
    give: what the candidates miss tells whether they happen to agree.
    """
    # The axis that the roll swings most tells the roll best.
    aim = max(asked.aims, key=lambda aim: aim.tool.amplitude)
    held = (asked.start_yaw, asked.start_roll)
    for phi, psi in solve_yaw_roll(asked.point, asked.tip, aim.wanted, aim.tool, held):
        yaw, roll = asked.yaw_within_limits(phi), asked.roll_within_limits(psi)
        if yaw is not None and roll is not None:
            yield from asked.planar_candidates(yaw, roll, bend=False)


def _candidates_with_roll(asked: AnalyticProblem, roll: float) -> Iterator[Candidate]:
    for yaw in asked.yaws(asked.tip.normal_part(roll)):
        yield from asked.planar_candidates(yaw, roll, bend=True)


def _alternative_rolls(asked: AnalyticProblem) -> Iterator[float]:
    if asked.arm.wrist:
        yield from asked.arm.wrist[0].sample_range(_ROLLS)
