"""A fault in Live is reported with its cause and a matching remedy."""

import pytest

from ikservo.apps.page.messages import page_messages
from ikservo.arm import open_arm
from ikservo.errors import NoPortError
from servosim.faults import Fault
from tests.apps.page.view_session import ViewSession
from tests.arm.simulated import line_of, servo_id

UNDER_WAY = 24  # cycles


def reported_of(arm, kind, **fields):
    """Return the notice of a page whose arm has a fault in motion."""
    return snapshot_after(arm, kind, **fields).stop_notice


def snapshot_after(arm, kind, **fields):
    with ViewSession(open_arm(arm, "sim:?pose=home")) as session:
        line = line_of(session.arm)

        def on_cycle(count):
            if count == UNDER_WAY:
                line.faults.add(Fault(kind, at_s=line.world.time_s, **fields))

        session.enable_live()
        joint = session.arm.chain.names[0]
        session.send_message(page_messages.SetJoint, joint=joint, value=25.0)
        session.run(200, on_cycle)
        session.arm_thread.step()
        return session.arm_thread.snapshot


@pytest.mark.parametrize("arm", ["koch", "wx250s"])
def test_brief_brown_out_is_reported_as_lost_power(arm):
    notice = reported_of(arm, "brownout", for_s=0.15)
    assert "has lost its power" in notice.message
    assert notice.hint.startswith("Its supply voltage may have dropped.")


@pytest.mark.parametrize("arm", ["so101", "koch"])
def test_low_supply_is_reported_with_power_supply_hint(arm):
    notice = reported_of(arm, "voltage", volts=3.0)
    assert "supply" in notice.message
    assert notice.hint.startswith("Check the power supply")


def test_blocked_joint_is_reported_as_not_following():
    notice = reported_of("koch", "stuck")
    assert "does not follow" in notice.message


def test_page_stop_during_motion_is_reported_with_page_hint():
    with ViewSession() as session:
        session.enable_live()
        session.send_message(page_messages.SetJoint, joint="wrist_roll", value=25.0)

        def on_cycle(count):
            if count == UNDER_WAY:
                session.send_message(page_messages.Stop, by="Space")

        session.run(200, on_cycle)
        session.arm_thread.step()
        notice = session.arm_thread.snapshot.stop_notice
    assert notice.message == "Stopped by the Space key on the page; torque stays on."
    assert "ikservo" not in notice.hint


@pytest.mark.full
@pytest.mark.parametrize(
    ("arm", "celsius"), [("so101", 68), ("so101", 90), ("koch", 72), ("koch", 90)]
)
def test_hot_servo_is_reported_with_page_hint(arm, celsius):
    joint = servo_id(arm, "shoulder_lift")
    snapshot = snapshot_after(arm, "hot", id=joint, celsius=celsius)
    reported = [entry.message for entry in snapshot.messages]
    assert not [message for message in reported if "without a command" in message]
    assert reported[0].startswith("shoulder_lift ")
    assert "ikservo relax" not in snapshot.stop_notice.hint


@pytest.mark.full
def test_hot_arm_that_lowers_itself_is_reported_limp():
    notice = reported_of("koch", "hot", id=servo_id("koch", "shoulder_lift"), celsius=72)
    assert notice.message.endswith("torque is off; the arm is limp.")


def test_pulled_cable_is_reported_until_port_returns(monkeypatch):
    with ViewSession() as session:
        line_of(session.arm).plugged = False
        session.arm_thread.step()

        def fail():
            raise NoPortError("/dev/ttyACM0", ["/dev/ttyUSB7"])

        monkeypatch.setattr(session.arm_thread, "_open", fail)
        session.send_message(page_messages.Acknowledge)
        session.arm_thread.step()
        notice = session.arm_thread.snapshot.stop_notice
    assert notice.message.startswith("Cannot open port /dev/ttyACM0")
    assert notice.hint.startswith("Check the cable and the power of the adapter")
