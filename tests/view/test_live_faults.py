"""A fault while the arm follows the page: told by its cause, with a remedy that fits it."""

import pytest

from ikservo.arm import open_arm
from ikservo.view import messages as page_messages
from servosim.faults import Fault
from tests.arm.simulated import line_of
from tests.view.view_session import ViewSession

UNDER_WAY = 24  # cycles


def told_of(arm, kind, **fields):
    """Return the notice of a page whose arm has a fault on its way."""
    with ViewSession(open_arm(arm, "sim:?pose=home")) as session:
        line = line_of(session.arm)

        def on_cycle(count):
            if count == UNDER_WAY:
                line.faults.add(Fault(kind, at_s=line.world.time_s, **fields))

        session.enable_live()
        joint = session.arm.chain.names[0]
        session.send_message(page_messages.SetJoint, joint=joint, value=25.0)
        session.run(200, on_cycle)
        return session.arm_thread.snapshot.stop_notice


@pytest.mark.parametrize("arm", ["koch", "wx250s"])
def test_a_brown_out_that_ends_before_servos_count_as_silent_is_told_as_one(arm):
    notice = told_of(arm, "brownout", for_s=0.15)
    assert "reset: torque is off" in notice.message
    assert notice.hint.startswith("Its supply voltage may have dropped.")


@pytest.mark.parametrize("arm", ["so101", "koch"])
def test_a_low_supply_is_told_with_what_to_do_about_a_supply(arm):
    notice = told_of(arm, "voltage", volts=3.0)
    assert "supply" in notice.message
    assert notice.hint.startswith("Check the power supply")


def test_a_blocked_joint_is_still_told_as_one_that_does_not_follow():
    notice = told_of("koch", "stuck")
    assert "does not follow" in notice.message


def test_a_stop_on_its_way_is_told_with_what_to_do_on_the_page():
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
