"""Arms with perturbed link lengths and zeros, by Pinocchio."""

import math
import xml.etree.ElementTree as ET

import numpy as np
import pinocchio

from tests.oracle import CONFIGS, arm_file

ZERO_RAD, LINK_M, TOUCH_M = math.radians(2.0), 0.001, 0.0005


class PerturbedGeometry:
    """An arm by name and seed: zeros off by 2°, every joint's origin by 1 mm on each axis.

    ``urdf`` is its true description.
    """

    def __init__(self, name, seed, chain):
        self.name, self.chain = name, chain
        self.chance = np.random.default_rng([seed, *name.encode()])
        self.zeros = self.chance.normal(0, ZERO_RAD, chain.dof)
        self.urdf = self._perturbed()
        self._model = pinocchio.buildModelFromXML(self.urdf)
        self._data = self._model.createData()
        self._tip = self._model.getFrameId(arm_file(name)["tip"])

    def _perturbed(self):
        root = ET.parse(CONFIGS / self.name / "arm.urdf").getroot()
        for joint in root.iter("joint"):
            origin = joint.find("origin")
            if origin is None:
                origin = ET.SubElement(joint, "origin")
            xyz = np.array([float(x) for x in origin.get("xyz", "0 0 0").split()])
            origin.set(
                "xyz", " ".join(repr(float(x)) for x in xyz + self.chance.normal(0, LINK_M, 3))
            )
        return ET.tostring(root, encoding="unicode")

    def tip(self, q):
        """Return the true tip (3,) [m] at true joints (dof,)."""
        full = pinocchio.neutral(self._model)
        for name, value in zip(self.chain.names, q, strict=True):
            full[self._model.joints[self._model.getJointId(name)].idx_q] = value
        pinocchio.framesForwardKinematics(self._model, self._data, full)
        return np.array(self._data.oMf[self._tip].translation)

    def reported(self, q):
        """Return the reported joints at true joints (dof,): zeros off, rounded to ticks."""
        tick = math.tau / 4096
        return np.round((np.asarray(q) - self.zeros) / tick) * tick

    def posture(self):
        """Return random true joints, well inside the ranges and above the table."""
        low = np.maximum(self.chain.lower_rad, -2.0) + 0.1
        high = np.minimum(self.chain.upper_rad, 2.0) - 0.1
        for _ in range(200):
            q = self.chance.uniform(low, high)
            if self.chain.forward(q)[2, 3] >= 0.0:
                return q
        raise AssertionError("no posture is above the table")

    def noise(self):
        return self.chance.normal(0, TOUCH_M, 3)
