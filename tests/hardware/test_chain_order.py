"""Advice on where to look, from which servos along the cable answer."""

from __future__ import annotations

import pytest

from ikservo.errors import ServoSilentError
from ikservo.hardware import ServoSpec
from ikservo.hardware.requester import silence_hint
from ikservo.registers import STS3215, RegisterName

from .factories import add_faults, make_bus

NAMES = ["pan", "lift", "elbow", "flex", "roll", "gripper"]
CHAIN = [ServoSpec(i, STS3215, name) for i, name in enumerate(NAMES, 1)]


@pytest.mark.parametrize(
    ("silent", "order"),
    [
        (
            [3, 4, 5, 6],
            "Servos 3 to 6 do not answer; 1 and 2 answer. Check the cable from lift to elbow.",
        ),
        ([6], "Servo 6 does not answer; 1 to 5 answer. Check the cable from roll to gripper."),
        (
            [2, 3, 4, 5, 6],
            "Servos 2 to 6 do not answer; 1 answers. Check the cable from pan to lift.",
        ),
        (
            [3],
            "Servo 3 does not answer; the others do. Check its connector, id and baud rate.",
        ),
        (
            [1, 2, 3, 4, 5, 6],
            "No servo answers. Check the power supply and the first cable; "
            "to try all baud rates: ikservo doctor",
        ),
    ],
)
def test_silent_servo_hint_names_cable_before_silent_servos(silent, order):
    answering = [servo.id for servo in CHAIN if servo.id not in silent]
    assert silence_hint(CHAIN, answering, silent) == order


def test_silent_servo_hint_follows_cable_order_not_ids():
    chain = [CHAIN[5], CHAIN[0]]
    assert "from gripper to pan" in silence_hint(chain, [6], [1])


def test_silent_servo_hint_uses_earlier_replies_of_others():
    bus = make_bus(dict.fromkeys(range(1, 4), "STS3215"))
    bus.sync_read([1, 2, 3], RegisterName.PRESENT_POSITION)
    add_faults(bus, ("silent", {"id": 3}))
    with pytest.raises(ServoSilentError, match="cable from joint_2 to joint_3"):
        bus.read(3, RegisterName.PRESENT_POSITION)


def test_silent_servo_hint_without_history_names_only_servo():
    bus = make_bus({1: "STS3215", 2: "STS3215"})
    add_faults(bus, ("silent", {}))
    with pytest.raises(ServoSilentError, match="Check its power, the cable that leads to it"):
        bus.read(1, RegisterName.PRESENT_POSITION)
