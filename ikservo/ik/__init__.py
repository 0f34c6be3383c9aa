"""From a point in the world to joints inside the limits: pure functions on arrays."""

from ikservo.ik.batch import BatchResult, solve_batch
from ikservo.ik.methods import METHODS
from ikservo.ik.millimetres import in_millimetres
from ikservo.ik.options import Options, Posture, Tolerance
from ikservo.ik.result import BUILD, Binding, Result
from ikservo.ik.solution_set import SolutionSet, solution_set
from ikservo.ik.solver import solve
from ikservo.ik.streaming import Solver
from ikservo.ik.target import Target

__all__ = [
    "BUILD",
    "METHODS",
    "BatchResult",
    "Binding",
    "Options",
    "Posture",
    "Result",
    "SolutionSet",
    "Solver",
    "Target",
    "Tolerance",
    "in_millimetres",
    "solution_set",
    "solve",
    "solve_batch",
]
