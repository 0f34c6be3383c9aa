"""Print joint positions, joint torques and the conditioning of a posture."""

from __future__ import annotations

import math
from collections.abc import Mapping

from ikservo.calibration import JointUnit, format_position
from ikservo.ik import Result
from ikservo.kinematics import (
    Chain,
    Conditioning,
    JointType,
    Singularity,
    conditioning,
    nearest_singularity,
)
from ikservo.kinematics.arrays import Vector


def joint_lines(positions: Mapping[str, tuple[float, JointUnit]]) -> list[str]:
    """Return one line per joint, given position [rad or m] and unit by name."""
    texts = {name: format_position(position, unit) for name, (position, unit) in positions.items()}
    name_width = max(map(len, texts), default=0)
    width = max(map(len, texts.values()), default=0)
    return [f"{name:{name_width}}  {text:>{width}}" for name, text in texts.items()]


def torque_lines(chain: Chain, torques: Vector) -> list[str]:
    """Return one line per joint with its torque or force (dof,) from a force at the tip."""
    width = max(len(name) for name in chain.names)
    rows = zip(chain.names, chain.kinds, torques.tolist(), strict=True)
    return [
        "joint torques from the force, without the arm's own weight:",
        *(
            f"{name:<{width}}  {value:+.3f} {'N' if kind is JointType.PRISMATIC else 'N m'}"
            for name, kind, value in rows
        ),
    ]


def posture_lines(chain: Chain, q: Vector) -> list[str]:
    """Return lines about the conditioning of measured joints (dof,)."""
    return _conditioning_lines(conditioning(chain, q), nearest_singularity(chain, q))


def posture_fields(chain: Chain, q: Vector) -> dict[str, object]:
    """Return the conditioning of measured joints (dof,) for ``--json``."""
    return _conditioning_fields(conditioning(chain, q), nearest_singularity(chain, q))


def result_lines(result: Result) -> list[str]:
    """Return lines about the conditioning of a solution."""
    return _conditioning_lines(result.conditioning, result.singularity)


def result_fields(result: Result) -> dict[str, object]:
    """Return the conditioning of a solution for ``--json``."""
    return _conditioning_fields(result.conditioning, result.singularity)


def _conditioning_lines(found: Conditioning | None, singular: Singularity | None) -> list[str]:
    if found is None or not found.moves_m_rad.size:
        return []
    fastest, slowest = 1000.0 * found.moves_m_rad[0], 1000.0 * found.slowest_m_rad
    power = {1: "", 2: "²", 3: "³"}[len(found.moves_m_rad)]
    place = "none found inside the limits"
    if singular is not None:
        away = f"{math.degrees(singular.distance_rad):.1f}° away ({singular.joint} turns most)"
        place = "here" if math.degrees(singular.distance_rad) < 0.05 else away
    return [
        f"tip speed  {slowest:.0f} to {fastest:.0f} mm/rad by direction "
        f"(manipulability {found.manipulability:.2g} m{power})",
        f"singular posture  {place}",
    ]


def _conditioning_fields(
    found: Conditioning | None, singular: Singularity | None
) -> dict[str, object]:
    if found is None:
        return {}
    return {
        "conditioning": {
            "manipulability": found.manipulability,
            "moves_m_rad": found.moves_m_rad,
            "turns_rad_rad": found.turns_rad_rad,
        },
        "singularity": None
        if singular is None
        else {"distance_rad": singular.distance_rad, "q_rad": singular.q, "joint": singular.joint},
    }
