"""Inverse kinematics inside the joint limits: pure functions on arrays."""

from ikservo.ik.batch import BatchResult, solve_batch
from ikservo.ik.other_solutions import solution_set
from ikservo.ik.problem import Options, Posture, Target, Tolerance
from ikservo.ik.result import NOT_LIMITED, ActiveLimit, Result, SolutionSet
from ikservo.ik.sight import Sight, solve_sight
from ikservo.ik.solve import METHODS, in_millimetres, solve
from ikservo.ik.solver import Solver

__all__ = [
    "METHODS",
    "NOT_LIMITED",
    "ActiveLimit",
    "BatchResult",
    "Options",
    "Posture",
    "Result",
    "Sight",
    "SolutionSet",
    "Solver",
    "Target",
    "Tolerance",
    "in_millimetres",
    "solution_set",
    "solve",
    "solve_batch",
    "solve_sight",
]
