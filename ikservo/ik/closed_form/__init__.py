"""Joints from equations: every solution of the arms whose structure allows it (lecture L3, L4)."""

from ikservo.ik.closed_form.anatomy import Plane, Structure, Turn
from ikservo.ik.closed_form.closest import Directions, closed_form_seeds, closest, intervals
from ikservo.ik.closed_form.solutions import solutions
from ikservo.ik.closed_form.structure import structure

__all__ = [
    "Directions",
    "Plane",
    "Structure",
    "Turn",
    "closed_form_seeds",
    "closest",
    "intervals",
    "solutions",
    "structure",
]
