"""A person's hands that move every limp joint slowly back and forth through its travel."""

from __future__ import annotations

import math

from servosim.hand import Hand, sweep
from servosim.world import World

__all__ = ["SweepingHands"]

LOOK_S = 0.05  # between two looks which joints are limp
ONE_WAY_S = 4.0  # from one end of the travel to the other
OPEN_TRAVEL_RAD = math.radians(300.0)  # of a joint without limits
OVERREACH = 0.02  # share of the travel by which the hand presses on into the stops


class SweepingHands:
    """Grasps joints whose torque goes off and lets go of those whose torque comes on."""

    def __init__(self, world: World) -> None:
        self._world = world
        self._look()

    def _look(self) -> None:
        world = self._world
        for joint in world.joints:
            held = joint.name in world.hands
            if joint.free and not held:
                world.grasp(joint.name, self._hand(joint.name, joint.position))
            elif held and not joint.free:
                world.release(joint.name)
        world.at(world.time_s + LOOK_S, self._look)

    def _hand(self, name: str, start: float) -> Hand:
        lower, upper = self._world.limits[name]
        if not math.isfinite(upper - lower):
            lower, upper = -OPEN_TRAVEL_RAD / 2, OPEN_TRAVEL_RAD / 2
        more = OVERREACH * (upper - lower)
        start = max(lower, min(upper, start))
        path = sweep(start, lower - more, upper + more, (upper - lower) / ONE_WAY_S)
        return Hand(path, limit=10.0)
