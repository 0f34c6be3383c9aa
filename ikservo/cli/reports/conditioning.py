"""How freely the tip moves in a posture, and how far a singular one is, in words and numbers."""

from __future__ import annotations

import math

from ikservo.ik import Result
from ikservo.kinematics import Chain, Conditioning, Singularity, conditioning, nearest_singularity
from ikservo.kinematics.se3 import Vector

__all__ = ["posture_fields", "posture_lines", "result_fields", "result_lines"]


def posture_lines(chain: Chain, q: Vector) -> list[str]:
    """Return what to say of measured joints (dof,)."""
    return _lines(conditioning(chain, q), nearest_singularity(chain, q))


def posture_fields(chain: Chain, q: Vector) -> dict[str, object]:
    """Return the same for a program."""
    return _fields(conditioning(chain, q), nearest_singularity(chain, q))


def result_lines(result: Result) -> list[str]:
    """Return what to say of the joints of an answer."""
    return [] if result.conditioning is None else _lines(result.conditioning, result.singularity)


def result_fields(result: Result) -> dict[str, object]:
    """Return the same for a program."""
    return {} if result.conditioning is None else _fields(result.conditioning, result.singularity)


def _lines(found: Conditioning, singular: Singularity | None) -> list[str]:
    if not found.moves_m_rad.size:
        return []
    fastest, slowest = 1000.0 * found.moves_m_rad[0], 1000.0 * found.slowest_m_rad
    power = {1: "", 2: "²", 3: "³"}[len(found.moves_m_rad)]
    return [
        f"tip speed  {slowest:.0f} to {fastest:.0f} mm/rad by direction "
        f"(manipulability {found.manipulability:.2g} m{power})",
        f"singular posture  {_distance(singular)}",
    ]


def _distance(singular: Singularity | None) -> str:
    if singular is None:
        return "none found inside the limits"
    degrees = math.degrees(singular.distance_rad)
    return "here" if degrees < 0.05 else f"{degrees:.1f}° away ({singular.joint} turns most)"


def _fields(found: Conditioning, singular: Singularity | None) -> dict[str, object]:
    return {
        "conditioning": {
            "manipulability": found.manipulability,
            "moves_m_rad": found.moves_m_rad,
            "turns_rad_rad": found.turns_rad_rad,
        },
        "singularity": None
        if singular is None
        else {
            "distance_rad": singular.distance_rad,
            "q_rad": singular.q,
            "joint": singular.joint,
        },
    }
