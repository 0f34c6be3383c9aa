"""Opening an arm with unexpected servos names the difference and writes nothing."""

from __future__ import annotations

import pytest

import ikservo
from ikservo.errors import BadReplyError, CalibrationError, ServoSilentError
from ikservo.registers import Access, control_table
from tests.hardware.factories import make_transport

STS, XL330 = "STS3215", "XL330-M288"
SO101 = dict.fromkeys(range(1, 7), STS)
KOCH = {**dict.fromkeys((1, 2), "XL430-W250"), **dict.fromkeys(range(3, 7), XL330)}


@pytest.fixture
def open_with_servos(monkeypatch):
    """Return a function that connects servos, all at one baud rate, and opens an arm on them."""

    def attempt(arm, servos, baud=1_000_000):
        transport = make_transport(servos, baud)
        monkeypatch.setattr("servosim.open_port", lambda _: transport)
        before = memories(transport)
        with pytest.raises((ServoSilentError, CalibrationError, BadReplyError)) as caught:
            ikservo.open_arm(arm, port="sim")
        assert memories(transport) == before  # nothing was written
        return caught.value

    return attempt


def memories(transport):
    return [
        {r: servo.memory.get(r.name) for r in _written_only_by_people(servo.table.model)}
        for servo in transport.line.world.servos
    ]


def _written_only_by_people(model):
    registers = control_table(model).registers.values()
    return [r for r in registers if r.access is Access.RW and r.name != "goal_position"]


@pytest.mark.parametrize("baud", [500_000, 250_000, 115_200, 57_600, 38_400])
def test_error_names_other_baud_rate_of_feetech_servos(open_with_servos, baud):
    error = open_with_servos("so101", SO101, baud)
    assert isinstance(error, ServoSilentError)
    assert "do not answer at 1000000 baud" in error.message
    assert f"STS3215 at id 1, {baud} baud" in error.message
    assert "ikservo setup" in error.hint


@pytest.mark.parametrize("baud", [57_600, 115_200, 2_000_000, 4_000_000])
def test_error_names_other_baud_rate_of_dynamixel_servos(open_with_servos, baud):
    error = open_with_servos("koch", KOCH, baud)
    assert f"XL430-W250 at id 1, {baud} baud" in error.message


@pytest.mark.parametrize("baud", [1_000_000, 57_600])
@pytest.mark.parametrize(
    ("arm", "servos"), [("so101", KOCH), ("koch", SO101)], ids=["so101", "koch"]
)
def test_error_names_servos_of_another_protocol(open_with_servos, arm, servos, baud):
    error = open_with_servos(arm, servos, baud)
    assert f"{servos[1]} at id 1, {baud} baud" in error.message
    assert "another arm" in error.hint


@pytest.mark.parametrize(
    ("arm", "servos", "found"),
    [
        ("so101", SO101 | {3: "STS3250"}, "elbow_flex (id 3) is a STS3250"),
        ("koch", KOCH | {6: "XL330-M077"}, "gripper (id 6) is a XL330-M077"),
        ("koch", KOCH | {2: XL330, 3: "XL430-W250"}, "(id 2) is a XL330-M288"),
    ],
    ids=["so101", "koch", "koch, two ids swapped"],
)
def test_error_names_servo_of_another_model(open_with_servos, arm, servos, found):
    error = open_with_servos(arm, servos)
    assert isinstance(error, CalibrationError)
    assert found in error.message


@pytest.mark.parametrize(
    ("arm", "servos"), [("so101", SO101), ("koch", KOCH)], ids=["so101", "koch"]
)
def test_error_names_servo_with_another_id(open_with_servos, arm, servos):
    error = open_with_servos(
        arm, {**{i: model for i, model in servos.items() if i != 4}, 44: servos[4]}
    )
    assert "(id 4)" in error.message
    assert f"{servos[4]} at id 44, 1000000 baud" in error.message
    assert "own id" in error.hint


def test_error_names_new_servo_at_its_factory_baud_rate(open_with_servos, monkeypatch):
    servos = {i: model for i, model in KOCH.items() if i != 4}
    transport = make_transport([*servos.items(), (1, XL330)], 1_000_000)
    new = transport.line.world.servos[-1]
    new.memory.put("baud_rate", 1)  # 57,600, as delivered
    monkeypatch.setattr("servosim.open_port", lambda _: transport)
    with pytest.raises(ServoSilentError, match="XL330-M288 at id 1, 57600 baud"):
        ikservo.open_arm("koch", port="sim")


def test_error_for_empty_bus_does_not_name_other_servos(open_with_servos):
    error = open_with_servos("so101", {99: XL330}, 9_600)
    assert isinstance(error, ServoSilentError)
    assert "there is" not in error.message
