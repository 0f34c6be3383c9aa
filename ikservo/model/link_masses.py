"""Masses and inertia of an arm's links."""

from __future__ import annotations

import numpy as np

from ikservo.kinematics import Chain
from ikservo.kinematics.inertia import LinkMass
from ikservo.kinematics.se3 import rotation_rpy
from ikservo.model.arm_model import Model


def link_masses(model: Model, chain: Chain) -> list[LinkMass]:
    """Return the masses and inertia of a chain's links; links without a mass are omitted."""
    masses: list[LinkMass] = []
    for link in model.urdf.links:
        if link.mass_kg > 0 and link.name in chain.frames:
            ixx, ixy, ixz, iyy, iyz, izz = link.inertia_kg_m2
            inertia = np.array([[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]])
            R = rotation_rpy(*link.inertia_rpy_rad)  # inertia frame to link frame
            masses.append(
                LinkMass(link.name, link.mass_kg, np.array(link.com_m), R @ inertia @ R.T)
            )
    return masses
