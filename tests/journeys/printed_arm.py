"""A 3D-printed arm whose links are off by an unmeasured millimetre."""

import math
import shutil

import numpy as np

from ikservo.model import load_model
from tests.model.touch.perturbed_geometry import PerturbedGeometry
from tests.oracle import CONFIGS, tip_from_joints

NAME = "so101"
SEED = 3
SHOWN_DEG, STOP_DEG = 25.0, 2.0  # STOP_DEG: from the limits to the simulator's end stops


class PrintedArm:
    """The true geometry of an arm that is nearly an so101.

    Attributes:
        path: Its arm file, for `ikservo sim`.
        truth: Its true geometry in Pinocchio.
        held_deg: The rest pose as set by eye, two degrees off, by name.
    """

    def __init__(self, folder):
        shutil.copytree(CONFIGS / NAME, folder)
        self._model = load_model(NAME)
        self.path, self.truth = (
            folder / "arm.toml",
            PerturbedGeometry(NAME, SEED, self._model.chain),
        )
        (folder / "arm.urdf").write_text(self.truth.urdf)
        rest = self._model.pose("rest").items()
        self.held_deg = {name: float(np.degrees(place)) for name, place in rest}
        for name, off_rad in zip(self.names, self.truth.zeros, strict=True):
            self.held_deg[name] += float(np.degrees(off_rad))

    @property
    def names(self):
        return self.truth.chain.names

    def shown_deg(self):
        """Return each joint's position that shows its direction, on its longer side."""
        shown_deg = {}
        for joint in self._model.joints:
            rest_deg = math.degrees(self._model.pose("rest")[joint.name])
            low_deg, high_deg = _limits_deg(joint)
            offset_deg = SHOWN_DEG if high_deg - rest_deg >= rest_deg - low_deg else -SHOWN_DEG
            shown_deg[joint.name] = self.held_deg[joint.name] + offset_deg
        return shown_deg

    def ends_deg(self):
        """Return the joints on their lower and then on their upper end stops, by name."""
        limits_deg = {joint.name: _limits_deg(joint) for joint in self._model.joints}
        lower_deg = {name: low - STOP_DEG for name, (low, _) in limits_deg.items()}
        return lower_deg, {name: high + STOP_DEG for name, (_, high) in limits_deg.items()}

    def tip_m(self, joints_deg):
        """Return the true tip (3,) [m] at the true joints, by name."""
        return self.truth.tip(self._rad(joints_deg))

    def believed_tip_m(self, joints_deg):
        """Return the tip (3,) [m] by a calibration of the zeros in the pose `held_deg`."""
        joints_rad = self.truth.reported(self._rad(joints_deg))
        return tip_from_joints(NAME, dict(zip(self.names, joints_rad, strict=True)))

    def postures_deg(self, count):
        """Return the true joints of random postures, by name."""
        return [
            dict(zip(self.names, np.degrees(self.truth.posture()).tolist(), strict=True))
            for _ in range(count)
        ]

    def touch_error_m(self):
        """Return the error of a touched point (3,) [m]."""
        return self.truth.noise()

    def _rad(self, joints_deg):
        return np.radians([joints_deg[name] for name in self.names])


def _limits_deg(joint):
    return math.degrees(joint.limits.lower.value), math.degrees(joint.limits.upper.value)
