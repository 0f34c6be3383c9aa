"""Raise servo gains in RAM if the factory values are too low, and read them for the model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType

from ikservo.control.joint_reading import read_registers
from ikservo.guard import DrivenJoint
from ikservo.hardware.bus import ServoBus
from ikservo.model.servo_torque import GRIPPER_P_GAINS, find_servo_torque
from ikservo.registers import Register

# The XL330's P gain is used for the elbows of Koch and OMX arms, and needs a D gain. The XL430 has
# a D gain by default; its P gain is the value that ROBOTIS sets in the OMX-F.
_XL330_GAINS: Mapping[str, int] = MappingProxyType(
    {"position_d_gain": 600, "position_p_gain": 1500}
)
_XL430_GAINS: Mapping[str, int] = MappingProxyType({"position_p_gain": 1000})
_ARM_GAINS: Mapping[str, Mapping[str, int]] = MappingProxyType(
    {"XL330-M288": _XL330_GAINS, "XL330-M077": _XL330_GAINS, "XL430-W250": _XL430_GAINS}
)
# A gripper is slightly softer.
_GRIPPER_GAINS: Mapping[str, Mapping[str, int]] = MappingProxyType(
    {name: {"position_p_gain": gain} for name, gain in GRIPPER_P_GAINS.items()}
)
_NO_GAINS: Mapping[str, int] = MappingProxyType({})


def raise_gains(bus: ServoBus, servo_id: int, *, gripper: bool) -> None:
    """Raise the gains of a servo in RAM if its defaults are too low.

    Raises:
        BusError: The servo does not answer.
    """
    table = bus.servos[servo_id].table
    gains = (_GRIPPER_GAINS if gripper else _ARM_GAINS).get(table.model_name, _NO_GAINS)
    for name, gain in gains.items():
        if bus.read(servo_id, table.registers[name], raw=True) < gain:
            bus.write(servo_id, table.registers[name], gain, raw=True)


_GAIN_NAMES = ("position_p_gain", "p_gain")


def read_gain_shares(bus: ServoBus, driven_joints: Sequence[DrivenJoint]) -> list[float]:
    """Read each joint's P gain as a fraction of the gain for which the motor table is valid.

    The fraction is 1 if the gain or the register is not known.

    Raises:
        BusError: A servo does not answer.
    """
    keys: dict[int, list[Register]] = {}
    for driven in driven_joints:
        registers = bus.servos[driven.servo_id].table.registers
        keys[driven.servo_id] = [registers[name] for name in _GAIN_NAMES if name in registers]
    read = read_registers(bus, {i: found for i, found in keys.items() if found})
    shares: list[float] = []
    for driven in driven_joints:
        torque = find_servo_torque(bus.servos[driven.servo_id].table.model_name, None)
        gain = next(iter(read.get(driven.servo_id, {}).values()), 0)
        shares.append(gain / torque.p_gain if torque and gain else 1.0)
    return shares
