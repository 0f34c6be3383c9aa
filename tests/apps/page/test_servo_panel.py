"""The servo panel in virtual time: a table read, registers written, refusals that stop nothing."""

import pytest

from ikservo.apps.page.messages import page_messages
from ikservo.apps.page.messages.page_messages import BadMessageError
from ikservo.apps.page.server.auth import Permission
from servosim.faults import Fault
from tests.apps.page.view_session import ViewSession
from tests.arm.simulated import line_of, servo_id


@pytest.fixture
def session(tmp_path, monkeypatch):
    monkeypatch.setenv("IKSERVO_HOME", str(tmp_path))
    with ViewSession() as session:
        yield session


def read(session, joint="elbow_flex"):
    session.send_message(page_messages.ReadServo, joint=joint)
    session.arm_thread.step()
    return session.latest_frames()["servo"]


def write(session, register, value, joint="wrist_roll"):
    session.send_message(page_messages.WriteRegister, joint=joint, name=register, value=value)
    session.arm_thread.step()
    return session.latest_frames()["servo"]


def held(session, joint="wrist_roll"):
    return line_of(session.arm).servos[servo_id("so101", joint)]


def test_the_table_is_what_the_servo_holds(session):
    shown = read(session)
    assert (shown["joint"], shown["model"], shown["id"]) == ("elbow_flex", "STS3215", 3)
    rows = {row["name"]: row for row in shown["registers"]}
    for name in ("p_gain", "max_temperature_limit", "present_voltage"):
        assert rows[name]["raw"] == held(session, "elbow_flex").read(name)
    assert rows["present_voltage"]["value"] == "7.4 V"
    assert not rows["present_voltage"]["writable"]
    assert not rows["torque_enable"]["writable"]
    assert rows["torque_limit"]["writable"]


def test_it_is_sent_once_and_only_after_it_was_read(session):
    first = session.latest_frames()["servo"]
    assert first["registers"] == []
    read(session)
    assert "servo" not in session.latest_frames()


def test_nothing_is_written_to_a_joint_that_holds(session):
    tip_m = session.arm.where().tip_m
    for register in ("torque_limit", "p_gain", "acceleration"):
        assert "holds: with other numbers it could fall" in write(session, register, "0")["note"]
    session.clock.sleep_until(session.clock.now_s() + 2.0)
    assert abs(session.arm.where().tip_m - tip_m).max() < 0.002


def test_a_quantity_is_written_and_shown(session):
    session.arm.disable_torque()
    shown = write(session, "max_temperature_limit", "60C")
    assert held(session).read("max_temperature_limit") == 60
    assert held(session).read("lock") == 1
    assert "max_temperature_limit 70 → 60" in shown["note"]


@pytest.mark.parametrize(
    ("register", "value", "said"),
    [
        ("torque_limit", "1001", "outside"),
        ("torque_limit", "much", "is not a value"),
        ("present_load", "3", "read-only"),
        ("p_gian", "3", "p_gain"),
    ],
)
def test_what_the_table_forbids_is_a_note_and_stops_nothing(session, register, value, said):
    session.arm.disable_torque()
    before = held(session).read("p_gain")
    shown = write(session, register, value)
    assert said in shown["note"]
    assert shown["registers"]
    assert session.arm_thread.snapshot.stop_notice is None
    assert held(session).read("p_gain") == before


@pytest.mark.parametrize(
    "register",
    ["goal_position", "torque_enable", "id", "homing_offset", "lock", "response_level", "phase"],
)
def test_what_has_a_way_of_its_own_is_not_written_here(session, register):
    with pytest.raises(BadMessageError, match="page cannot write"):
        write(session, register, "1")


def test_an_alias_of_a_goal_is_not_written_either(session):
    session.arm.disable_torque()
    assert "page cannot write" in write(session, "profile_velocity", "5")["note"]


def test_a_page_without_control_reads_nothing(session):
    watcher = session.connect(Permission.WATCH)
    with pytest.raises(BadMessageError):
        session.send_message(page_messages.ReadServo, watcher, joint="elbow_flex")


def test_a_servo_that_is_silent_stops_the_arm_as_ever(session):
    line = line_of(session.arm)
    line.faults.add(Fault("silent", id=3, at_s=line.world.time_s))
    session.send_message(page_messages.ReadServo, joint="elbow_flex")
    session.arm_thread.step()
    assert "elbow_flex" in session.arm_thread.snapshot.stop_notice.message
