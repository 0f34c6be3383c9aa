"""A single joint with an oscillating load."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import pytest

from servosim.joint import SimulatedJoint
from servosim.motor import Motor
from servosim.parameters import PARAMETERS
from servosim.servo import HornMounting
from servosim.servo_models import make_servo
from servosim.world import World

FRICTION = (
    "friction_nm", "viscous_nm_s", "stribeck_nm", "load_friction", "load_stribeck",
    "load_square_per_nm", "backlash_rad",
)  # fmt: skip


@dataclass(frozen=True)
class Pendulum:
    """A pendulum of 1 kg at 0.1 m; at zero it hangs."""

    names: tuple[str, ...] = ("swing",)
    limits: tuple[tuple[float, float], ...] = ((-math.inf, math.inf),)

    def load_nm(self, positions: Sequence[float], velocities: Sequence[float]) -> list[float]:
        return [-9.81 * 0.1 * math.sin(positions[0])]

    def mass_matrix(self, positions: Sequence[float]) -> list[list[float]]:
        return [[0.01]]


def test_limp_pendulum_without_friction_keeps_its_amplitude() -> None:
    ideal = replace(PARAMETERS["STS3250"], **dict.fromkeys(FRICTION, 0.0))
    motor = Motor(ideal, 1.0)
    servo = make_servo("STS3250", motor, HornMounting(1, 2048, 4096), {"id": 1})
    world = World([SimulatedJoint("swing", (servo,))], Pendulum())
    heights = list[float]()
    for k in range(3000):
        world.advance_to(0.001 * k)
        heights.append(abs(motor.position_rad))
    assert max(heights) == pytest.approx(1.0, abs=0.01)
    assert max(heights[-700:]) == pytest.approx(1.0, abs=0.01)
