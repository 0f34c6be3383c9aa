"""From a point in the world to joints inside the limits: pure functions on arrays."""

from ikservo.ik.result import Binding, Result, Tolerance
from ikservo.ik.solver import METHODS, Solver, solve
from ikservo.ik.target import Target

__all__ = ["METHODS", "Binding", "Result", "Solver", "Target", "Tolerance", "solve"]
