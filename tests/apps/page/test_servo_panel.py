"""The servo panel in virtual time: tables read, registers written, refusals that stop nothing."""

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


def test_servo_table_shows_register_values_of_servo(session):
    shown = read(session)
    assert (shown["joint"], shown["model"], shown["id"]) == ("elbow_flex", "STS3215", 3)
    rows = {row["name"]: row for row in shown["registers"]}
    for name in ("p_gain", "max_temperature_limit", "present_voltage"):
        assert rows[name]["raw"] == held(session, "elbow_flex").read(name)
    assert rows["present_voltage"]["value"] == "7.4 V"
    assert not rows["present_voltage"]["writable"]
    assert not rows["torque_enable"]["writable"]
    assert rows["torque_limit"]["writable"]


def test_servo_table_is_sent_once_after_reading(session):
    first = session.latest_frames()["servo"]
    assert first["registers"] == []
    read(session)
    assert "servo" not in session.latest_frames()


def test_register_is_not_written_while_torque_is_on(session):
    tip_m = session.arm.where().tip_m
    for register in ("torque_limit", "p_gain", "acceleration"):
        assert (
            "holds a joint, which could fall if values change"
            in write(session, register, "0")["note"]
        )
    session.clock.sleep_until(session.clock.now_s() + 2.0)
    assert abs(session.arm.where().tip_m - tip_m).max() < 0.002


def test_register_is_written_with_unit_and_shown(session):
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
def test_refused_register_write_shows_note_without_stop(session, register, value, said):
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
def test_protected_register_cannot_be_written_on_page(session, register):
    with pytest.raises(BadMessageError, match="cannot write"):
        write(session, register, "1")


def test_register_shared_with_goal_cannot_be_written_on_page(session):
    session.arm.disable_torque()
    assert "cannot write" in write(session, "profile_velocity", "5")["note"]


def test_watcher_cannot_read_servo(session):
    watcher = session.connect(Permission.WATCH)
    with pytest.raises(BadMessageError):
        session.send_message(page_messages.ReadServo, watcher, joint="elbow_flex")


def test_silent_servo_found_by_servo_panel_stops_arm(session):
    line = line_of(session.arm)
    line.faults.add(Fault("silent", id=3, at_s=line.world.time_s))
    session.send_message(page_messages.ReadServo, joint="elbow_flex")
    session.arm_thread.step()
    assert "elbow_flex" in session.arm_thread.snapshot.stop_notice.message
