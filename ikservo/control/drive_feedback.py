"""Read duty, current, supply voltage and position of the joints' servos during motion."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ikservo.guard import DrivenJoint
from ikservo.hardware.bus import ServoBus
from ikservo.kinematics.arrays import Matrix
from ikservo.registers import Register, RegisterName


class DriveReader:
    """Reader of duty, current and supply of the servos of some joints.

    Args:
        bus: The servo bus.
        joints: The command limits of each joint's first servo, and the ids of its other servos.
    """

    def __init__(self, bus: ServoBus, joints: Sequence[tuple[DrivenJoint, Sequence[int]]]) -> None:
        self._bus = bus
        self._ids = [(driven.servo_id, *others) for driven, others in joints]
        self._maps = [driven.joint_map for driven, _ in joints]
        self._most = max(len(ids) for ids in self._ids)
        self._keys: dict[int, dict[str, Register]] = {}
        for servo_id in (i for ids in self._ids for i in ids):
            table = bus.servos[servo_id].table
            self._keys[servo_id] = {
                "duty": table.registers.get("present_pwm", table.present_load),
                "voltage": table.find(RegisterName.PRESENT_VOLTAGE),
                "position": table.find(RegisterName.PRESENT_POSITION),
            }
            if "present_current" in table.registers:
                self._keys[servo_id]["current"] = table.registers["present_current"]

    def p_gains(self) -> list[int | None]:
        """Read the P gain of each joint's first servo; None if the servo has no such register.

        Raises:
            BusError: A servo does not answer.
        """
        found: list[int | None] = []
        for servo_id, *_ in self._ids:
            registers = self._bus.servos[servo_id].table.registers
            gain = registers.get("position_p_gain") or registers.get("p_gain")
            found.append(None if gain is None else self._bus.read(servo_id, gain, raw=True))
        return found

    def read(self) -> Matrix | None:
        """Return duty, current [A], supply [V] and position of the servos (joints, servos, 4).

        Duty and current are positive towards increasing positions; a current without a measured
        direction is a magnitude. Values that are not measured are NaN, like the unused rows of
        joints with fewer servos. Other servos of a joint get the signs of its first servo.
        Positions are those of the joint, rad or m, from its first servo. Returns None if a reply is
        missing.
        """
        readings = self._bus.bulk_read(
            {servo_id: list(keys.values()) for servo_id, keys in self._keys.items()}, raw=True
        )
        if readings.errors:
            return None
        table = np.full((len(self._ids), self._most, 4), math.nan)
        for j, ids in enumerate(self._ids):
            sign = self._maps[j].sign
            for k, servo_id in enumerate(ids):
                keys, found = self._keys[servo_id], readings.values[servo_id]
                value = {name: key.to_value(found[key]) for name, key in keys.items()}
                current_a = value.get("current", math.nan)
                if "current" in keys and keys["current"].range[0] < 0:
                    current_a *= sign
                table[j, k, :3] = sign * value["duty"], current_a, value["voltage"]
            own = readings.values[ids[0]]
            table[j, :, 3] = self._maps[j].position(own[self._keys[ids[0]]["position"]])
            table[j, 1 : len(ids), :2] = np.copysign(table[j, 1 : len(ids), :2], table[j, 0, :2])
        return table
