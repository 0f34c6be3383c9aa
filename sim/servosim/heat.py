"""How warm a servo gets: one body that the winding heats and the room cools."""

from __future__ import annotations


class Heat:
    """The temperature that a servo's own sensor sees.

    `C dT/dt = P - (T - room) / R`, with the winding's loss P. One body for winding and case: the
    sensors of these servos sit on the circuit board between the two.
    """

    __slots__ = ("_capacity_j_k", "_resistance_k_w", "room_c", "temperature_c")

    def __init__(self, capacity_j_k: float, resistance_k_w: float, room_c: float) -> None:
        self._capacity_j_k = capacity_j_k
        self._resistance_k_w = resistance_k_w
        self.room_c = room_c
        self.temperature_c = room_c

    def step(self, dt_s: float, power_w: float) -> None:
        """Let `dt_s` seconds pass under a loss of `power_w` watts."""
        flow_w = power_w - (self.temperature_c - self.room_c) / self._resistance_k_w
        self.temperature_c += flow_w * dt_s / self._capacity_j_k
