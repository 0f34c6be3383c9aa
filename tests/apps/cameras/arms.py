"""Arms with unknown zeros, compliance and backlash in front of a camera."""

import math
from dataclasses import dataclass, replace

import numpy as np

from ikservo.apps.cameras.camera_and_arm_fit import BoardSample
from ikservo.kinematics.bending_and_backlash import Bending
from ikservo.kinematics.se3 import exp_so3, make_pose, rotation_rpy

TICK_RAD = math.tau / 4096


@dataclass
class SimulatedArm:
    bending: Bending
    zeros: np.ndarray
    chance: np.random.Generator

    def __post_init__(self):
        turn, off = self.chance.uniform(-0.4, 0.4, 3), self.chance.uniform(-0.1, 0.1, 3)
        looks = rotation_rpy(math.pi / 2 + 0.5, math.pi, 0.0).T
        self.T_camera_base = make_pose(np.array([0.0, 0.15, 0.6]) + off, exp_so3(turn) @ looks)
        self.T_tip_board = make_pose([0.0, 0.03, -0.02], exp_so3(self.chance.uniform(-0.3, 0.3, 3)))

    @property
    def known(self):
        """Return the arm as it is described, which is rigid."""
        nothing = np.zeros(self.bending.dynamics.chain.dof)
        return replace(self.bending, compliance=nothing, half_play=nothing)

    def tips(self, q):
        return self.bending.dynamics.chain.forward(self.bending.link_joints(q + self.zeros))

    def postures(self, count):
        low = np.radians([-60, -70, -20, -60, -80])
        return self.chance.uniform(low, np.radians([60, 30, 80, 60, 80]), (count, 5))

    def samples(self, count=25, across_m=0.0002, depth_m=0.001, turned_rad=0.003):
        q = self.postures(count)
        seen = self.T_camera_base @ self.tips(q) @ self.T_tip_board
        return [self.sample(q[i], T, across_m, depth_m, turned_rad, i) for i, T in enumerate(seen)]

    def sample(self, q, T, across_m, depth_m, turned_rad, number):
        """Measure joints in ticks, and a pose with the noise of a camera."""
        ray = T[:3, 3] / np.linalg.norm(T[:3, 3])
        noise = self.chance.normal(size=3) * across_m
        at = T[:3, 3] + noise + ray * self.chance.normal() * depth_m
        seen = make_pose(at, exp_so3(self.chance.normal(size=3) * turned_rad) @ T[:3, :3])
        return BoardSample(np.round(q / TICK_RAD) * TICK_RAD, seen, f"picture {number + 1}")

    def tip_errors_m(self, fit, q):
        """Return the distance between the true and the fitted tip in the camera frame, m."""
        truth = (self.T_camera_base @ self.tips(q))[:, :3, 3]
        return np.linalg.norm((fit.T_camera_base @ fit.tip_poses(q))[:, :3, 3] - truth, axis=1)
