"""``ikservo recover``: alarms go away by each family's own way, and nothing snaps afterwards."""

import pytest

from tests.cli.fixtures_ports import change_bus

OVERLOAD = 0x20


def overloaded(*numbers, torque=1):
    def change(line):
        for servo in line.world.servos:
            servo.write("torque_enable", torque)
        for number in numbers:
            _overload(line.servos[number])

    return change


def _overload(servo):
    """Latch an overload as the firmware does: a Feetech limits, a Dynamixel lets go."""
    if servo.table.by_name.get("hardware_error_status"):
        servo.inject_alarm(OVERLOAD)
        servo.memory.put("torque_enable", 0)
        servo.apply_write_effects(servo.table.by_name["torque_enable"].address, 1)
    else:
        servo.watch.bits |= OVERLOAD


def test_a_feetech_servo_is_switched_off_and_on(say, monkeypatch):
    ports = change_bus(monkeypatch, overloaded(3))
    said = say("recover --arm so101 --port sim --json")
    assert said.code == 0
    assert said.json["servos"][2] == {
        "joint": "elbow_flex", "id": 3, "before": ["overload"], "after": [],
        "action": "torque off and on again", "torque": True,
    }  # fmt: skip
    assert ports[0].line.servos[3].read("torque_enable") == 1


def test_a_limp_feetech_servo_stays_limp(say, monkeypatch):
    ports = change_bus(monkeypatch, overloaded(3, torque=0))
    row = say("recover --arm so101 --port sim --json").json["servos"][2]
    assert (row["after"], row["torque"]) == ([], False)
    assert ports[0].line.servos[3].read("torque_enable") == 0


def test_servos_without_an_alarm_keep_their_torque(say, monkeypatch):
    ports = change_bus(monkeypatch, overloaded(3))
    rows = say("recover --arm so101 --port sim --json").json["servos"]
    assert [row["action"] for row in rows].count("had no alarm") == 5
    assert [s.read("torque_enable") for s in ports[0].line.world.servos] == [1] * 6


def test_every_goal_is_where_its_joint_is(say, monkeypatch):
    def change(line):
        overloaded(3, torque=0)(line)
        for servo in line.world.servos:
            servo.memory.put("goal_position", 1000)

    ports = change_bus(monkeypatch, change)
    assert say("recover --arm so101 --port sim").code == 0
    for servo in ports[0].line.world.servos:
        assert abs(servo.read("goal_position") - servo.read("present_position")) <= 1


def test_a_dynamixel_keeps_its_alarm_until_it_may_restart(say, monkeypatch):
    ports = change_bus(monkeypatch, overloaded(2))
    said = say("recover --arm koch --port sim")
    assert said.code == 5
    assert "support the arm, then ikservo recover --reboot" in said.out
    assert said.err == "Still faulty: shoulder_lift (id 2).\n"
    assert ports[0].line.servos[2].boot_s == 0.0


def test_a_dynamixel_is_restarted_on_request(say, monkeypatch):
    ports = change_bus(monkeypatch, overloaded(2))
    said = say("recover --arm koch --port sim --reboot --json")
    assert said.code == 0
    assert said.json["servos"][1] == {
        "joint": "shoulder_lift", "id": 2, "before": ["overload"], "after": [],
        "action": "restarted; torque off", "torque": False,
    }  # fmt: skip
    servo = ports[0].line.servos[2]
    assert servo.boot_s > 0.0
    assert abs(servo.read("goal_position") - servo.read("present_position")) <= 1


def test_only_servos_with_an_alarm_restart(say, monkeypatch):
    ports = change_bus(monkeypatch, overloaded(2))
    say("recover --arm koch --port sim --reboot")
    assert [servo.boot_s > 0.0 for servo in ports[0].line.world.servos].count(True) == 1


def test_at_a_wrong_voltage_torque_stays_off(say, monkeypatch):
    def change(line):
        overloaded(3)(line)
        line.servos[3].memory.put("max_voltage_limit", 60)

    ports = change_bus(monkeypatch, change)
    said = say("recover --arm so101 --port sim --json")
    assert said.code == 5
    assert said.json["servos"][2]["action"].startswith(
        "torque stays off: elbow_flex (id 3) has a supply"
    )
    assert ports[0].line.servos[3].read("torque_enable") == 0


def test_a_silent_servo_does_not_keep_the_others_from_recovering(say, monkeypatch):
    def change(line):
        overloaded(3)(line)
        line.servos[2].powered = False

    change_bus(monkeypatch, change)
    said = say("recover --arm so101 --port sim --json")
    assert said.code == 4
    assert [row["torque"] for row in said.json["servos"]] == [True, None, True, True, True, True]


def test_a_healthy_arm_is_left_alone(say):
    said = say("recover --arm so101 --port sim")
    assert said.code == 0
    assert said.err == "All servos are fine; each goal is its position.\n"


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        ("recover --port sim", 2, "No arm given."),
        ("recover --arm so1o1 --port sim", 2, "Did you mean so101?"),
        ("recover --arm so101 --port /dev/ttyNONE7", 3, "/dev/ttyNONE7"),
    ],
)
def test_bad_input_is_one_clear_error(say, words, code, message):
    said = say(words)
    assert said.code == code
    assert message in said.err
    assert said.out == ""
