"""Closed forms for a full pose: wrist angles and reach.

Rotations about axes through the wrist's centre do not move the centre, whose position therefore
determines the joints before the wrist; the remaining orientation determines these rotations. Arms
have either two parallel links and a wrist of three joints, or three parallel links and a wrist of
two.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

from ikservo.ik.closed_form_problem import AnalyticProblem, Candidate, tool_at_zero
from ikservo.ik.planar import Angles, solve_planar_2r, solve_planar_3r, within_limits
from ikservo.ik.problem import Target
from ikservo.ik.subproblems import EulerAngles, solve_yaw_roll
from ikservo.kinematics.arrays import Matrix, Vector
from ikservo.kinematics.se3 import exp_so3

# A target direction leaves the rotation about it free; this many are tried, the nearest first.
_ROTATIONS_ABOUT_AXIS = 24


def solve_pose(problem: AnalyticProblem, target: Target, R: Matrix) -> Iterator[Vector]:
    """Yield the joints (dof,) that bring the point to the target with orientation R (3, 3)."""
    arm = problem.arm
    if arm.orient is None or arm.centre is None:
        return
    tool = tool_at_zero(arm, target)
    rotation = R @ tool[:3, :3].T
    centre_target = target.position + rotation @ (arm.centre - tool[:3, 3])
    at_centre = replace(
        problem, point=arm.yaw_back.trace_point(centre_target), tip=arm.roll.trace_point(arm.centre)
    )
    limits = [(joint.lower, joint.upper) for joint in arm.wrist]
    wrist_start = tuple(float(problem.start[joint.column]) for joint in arm.wrist)
    planar_start = arm.plane.angles(problem.start)
    for yaw in at_centre.yaws(at_centre.tip.normal_part(0.0)):
        remaining = exp_so3(-yaw * arm.yaw.axis) @ rotation if arm.yaw else rotation
        for angles, wrist in _planar_and_wrist_angles(at_centre, arm.orient, yaw, remaining):
            planar = within_limits(angles, arm.plane.limits, planar_start)
            held = within_limits(wrist, limits, wrist_start)
            if planar is not None and held is not None:
                yield at_centre.joints(yaw, planar, held)


def _planar_and_wrist_angles(
    problem: AnalyticProblem, orient: EulerAngles, yaw: float, R: Matrix
) -> Iterator[tuple[Angles, Angles]]:
    """Yield planar and wrist angles; R (3, 3) is the rotation that remains after the yaw."""
    plane, m = problem.arm.plane, problem.target_in_plane(yaw)
    links = plane.links(problem.tip.in_plane_part(0.0))
    if len(links) == 3:
        l1, l2, l3 = links
        for alpha, *wrist in orient(R, sum(plane.angles(problem.start))):
            yield from ((angles, tuple(wrist)) for angles in solve_planar_3r(l1, l2, l3, m, alpha))
        return
    l1, l2 = links
    for angles in solve_planar_2r(l1, l2, m):
        remaining = exp_so3(-sum(angles) * plane.frame[2]) @ R
        near = float(problem.start[problem.arm.wrist[0].column])
        yield from ((angles, wrist) for wrist in orient(remaining, near))


def candidate_orientations(target: Target, R_start: Matrix) -> Iterator[Matrix]:
    """Yield orientations (3, 3) that a target allows, beginning with those near the start."""
    if target.rotation is not None:
        yield target.rotation
        return
    aimed = exp_so3(target.orientation_error(R_start)) @ R_start
    if target.target_axis is None:
        yield aimed
        return
    for step in range(_ROTATIONS_ABOUT_AXIS):
        steps = (step + 1) // 2 * (1 if step % 2 else -1)
        angle = steps * 2.0 * math.pi / _ROTATIONS_ABOUT_AXIS
        yield exp_so3(angle * target.target_axis) @ aimed


# Rolls to try, as fractions of the range, if the point is not reached with the roll of the start.
_ROLLS = (0.5, 0.25, 0.75, 0.0, 1.0, 0.125, 0.375, 0.625, 0.875)


def solve_position(problem: AnalyticProblem) -> tuple[Candidate, ...]:
    """Return the joint positions that reach the point, with the wrist in its start position.

    The tool is rotated as near to the aims as the point allows. If the point cannot be reached with
    the roll of the start, the first of a few other rolls with which it can be reached is used.
    """
    others = problem.arm.wrist[0].sample_range(_ROLLS) if problem.arm.wrist else ()
    for roll in (problem.start_roll, *others):
        yaws = problem.yaws(problem.tip.normal_part(roll))
        found = [c for yaw in yaws for c in problem.planar_candidates(yaw, roll, bend=True)]
        if found:
            return tuple(found)
    return ()


def solve_direction(problem: AnalyticProblem) -> Iterator[Candidate]:
    """Yield the joint positions that reach the point, and that meet the aims as well as possible.

    Without a roll, or with a roll that does not move the point, point and aims are over-determined:
    the error of the candidates shows whether the two happen to agree.
    """
    # The axis with the largest amplitude determines the roll best.
    aim = max(problem.aims, key=lambda aim: aim.tool.amplitude)
    held = (problem.start_yaw, problem.start_roll)
    for phi, psi in solve_yaw_roll(problem.point, problem.tip, aim.target, aim.tool, held):
        yaw, roll = problem.yaw_within_limits(phi), problem.roll_within_limits(psi)
        if yaw is not None and roll is not None:
            yield from problem.planar_candidates(yaw, roll, bend=False)
