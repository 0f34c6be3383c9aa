"""Inverse kinematics inside the joint limits: pure functions on arrays."""

from ikservo.ik.branch_tracking import Solver
from ikservo.ik.problem import Options, Posture, Target, Tolerance
from ikservo.ik.result import NOT_LIMITED, ActiveLimit, Result, SolutionSet
from ikservo.ik.solve import METHODS, in_millimetres, solve

__all__ = [
    "METHODS",
    "NOT_LIMITED",
    "ActiveLimit",
    "Options",
    "Posture",
    "Result",
    "SolutionSet",
    "Solver",
    "Target",
    "Tolerance",
    "in_millimetres",
    "solve",
]
