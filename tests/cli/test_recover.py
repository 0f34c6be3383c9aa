"""``ikservo recover`` clears alarms in the way of each family, and no joint jumps afterwards."""

import pytest

from tests.cli.fixtures_ports import change_bus

OVERLOAD = 0x20


def overloaded(*numbers, torque=1):
    def change(line):
        for servo in line.world.servos:
            servo.write("torque_enable", torque)
        for number in numbers:
            overload(line.servos[number])

    return change


def overload(servo):
    """Latch an overload like the firmware: a Feetech limits torque, a Dynamixel switches it off."""
    if servo.table.by_name.get("hardware_error_status"):
        servo.inject_alarm(OVERLOAD)
        servo.memory.put("torque_enable", 0)
        servo.apply_write_effects(servo.table.by_name["torque_enable"].address, 1)
    else:
        servo.watch.bits |= OVERLOAD


def test_recover_switches_overloaded_feetech_torque_off_and_on(run_cli, monkeypatch):
    ports = change_bus(monkeypatch, overloaded(3))
    result = run_cli("recover --arm so101 --port sim --json")
    assert result.code == 0
    assert result.json["servos"][2] == {
        "joint": "elbow_flex", "id": 3, "before": ["overload"], "after": [],
        "action": "torque off and on again", "torque": True,
    }  # fmt: skip
    assert ports[0].line.servos[3].read("torque_enable") == 1


def test_recover_does_not_switch_limp_feetech_servo_on(run_cli, monkeypatch):
    ports = change_bus(monkeypatch, overloaded(3, torque=0))
    row = run_cli("recover --arm so101 --port sim --json").json["servos"][2]
    assert (row["after"], row["torque"]) == ([], False)
    assert ports[0].line.servos[3].read("torque_enable") == 0


def test_recover_keeps_torque_of_servos_without_alarm(run_cli, monkeypatch):
    ports = change_bus(monkeypatch, overloaded(3))
    rows = run_cli("recover --arm so101 --port sim --json").json["servos"]
    assert [row["action"] for row in rows].count("had no alarm") == 5
    assert [s.read("torque_enable") for s in ports[0].line.world.servos] == [1] * 6


def test_recover_sets_goals_to_present_positions(run_cli, monkeypatch):
    def change(line):
        overloaded(3)(line)
        for servo in line.world.servos:
            servo.write("goal_position", servo.read("present_position") + 100)

    ports = change_bus(monkeypatch, change)
    assert run_cli("recover --arm so101 --port sim").code == 0
    for servo in ports[0].line.world.servos:
        assert abs(servo.read("goal_position") - servo.read("present_position")) <= 2


def test_recover_of_limp_arm_does_not_write_goals(run_cli, monkeypatch):
    def change(line):
        overloaded(3, torque=0)(line)
        for servo in line.world.servos:
            servo.memory.put("goal_position", 1000)

    ports = change_bus(monkeypatch, change)
    assert run_cli("recover --arm so101 --port sim").code == 0
    assert [s.read("goal_position") for s in ports[0].line.world.servos] == [1000] * 6
    assert not any(s.drive.torque_on for s in ports[0].line.world.servos)


def test_recover_keeps_dynamixel_alarm_without_reboot(run_cli, monkeypatch):
    ports = change_bus(monkeypatch, overloaded(2))
    result = run_cli("recover --arm koch --port sim")
    assert result.code == 5
    assert "support the arm, then ikservo recover --reboot" in result.out
    assert result.err == "Still faulty: shoulder_lift (id 2).\n"
    assert ports[0].line.servos[2].boot_s == 0.0


def test_recover_reboot_restarts_the_dynamixel(run_cli, monkeypatch):
    ports = change_bus(monkeypatch, overloaded(2))
    result = run_cli("recover --arm koch --port sim --reboot --json")
    assert result.code == 0
    assert result.json["servos"][1] == {
        "joint": "shoulder_lift", "id": 2, "before": ["overload"], "after": [],
        "action": "restarted; torque off", "torque": False,
    }  # fmt: skip
    servo = ports[0].line.servos[2]
    assert (servo.boot_s > 0.0, servo.read("torque_enable")) == (True, 0)


def test_recover_reboot_restarts_only_servos_with_alarm(run_cli, monkeypatch):
    ports = change_bus(monkeypatch, overloaded(2))
    run_cli("recover --arm koch --port sim --reboot")
    assert [servo.boot_s > 0.0 for servo in ports[0].line.world.servos].count(True) == 1


def test_recover_at_wrong_supply_voltage_leaves_torque_off(run_cli, monkeypatch):
    def change(line):
        overloaded(3)(line)
        line.servos[3].memory.put("max_voltage_limit", 60)

    ports = change_bus(monkeypatch, change)
    result = run_cli("recover --arm so101 --port sim --json")
    assert result.code == 5
    assert result.json["servos"][2]["action"].startswith(
        "torque stays off: elbow_flex (id 3) has a supply"
    )
    assert ports[0].line.servos[3].read("torque_enable") == 0


def test_recover_continues_if_one_servo_is_silent(run_cli, monkeypatch):
    def change(line):
        overloaded(3)(line)
        line.servos[2].powered = False

    change_bus(monkeypatch, change)
    result = run_cli("recover --arm so101 --port sim --json")
    assert result.code == 4
    assert [row["torque"] for row in result.json["servos"]] == [True, None, True, True, True, True]


def test_recover_does_not_change_healthy_arm(run_cli):
    result = run_cli("recover --arm so101 --port sim")
    assert result.code == 0
    assert result.err == (
        "No servo reports an alarm.\n"
        "Torque is off: the arm is limp. The next motion switches it on.\n"
    )


@pytest.mark.parametrize(
    ("torques", "said"),
    [
        ((1, 1, 1, 1, 1, 1), "Torque is on: every joint holds"),
        ((1, 0, 1, 1, 1, 1), "Torque is off at shoulder_lift. The other joints hold."),
    ],
)
def test_recover_prints_which_joints_are_limp(run_cli, monkeypatch, torques, said):
    def change(line):
        for servo, torque in zip(line.world.servos, torques, strict=True):
            servo.write("torque_enable", torque)

    change_bus(monkeypatch, change)
    assert said in run_cli("recover --arm so101 --port sim").err


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        ("recover --port sim", 2, "No arm given."),
        ("recover --arm so1o1 --port sim", 2, "Did you mean so101?"),
        ("recover --arm so101 --port /dev/ttyNONE7", 3, "/dev/ttyNONE7"),
    ],
)
def test_recover_with_invalid_input_gives_one_error(run_cli, words, code, message):
    result = run_cli(words)
    assert result.code == code
    assert message in result.err
    assert result.out == ""
