"""A fault in the middle of a program of twenty steps: stopped, held, acknowledged, resumed."""

from dataclasses import replace

import pytest

from ikservo.apps.page.messages import page_messages
from ikservo.apps.page.messages import program_messages as msg
from ikservo.apps.page.messages.page_messages import BadMessageError
from servosim.faults import Fault
from tests.apps.page.test_program_panel import add, degrees, panel, run, teach_target
from tests.apps.page.view_session import ViewSession
from tests.arm.simulated import line_of, servo_id

JOINT, NEIGHBOUR = "wrist_roll", "wrist_flex"

FAULTS = {
    "silent": Fault("silent", id=servo_id("so101", NEIGHBOUR)),
    "reset": Fault("reset", id=servo_id("so101", JOINT)),
    "brownout": Fault("brownout", for_s=0.4),
    "unplug": Fault("unplug"),
}
RESUMED = ("stop", "silent", "reset")  # where the arm has not fallen, on the same port


@pytest.fixture(autouse=True)
def own_folder(tmp_path, monkeypatch):
    monkeypatch.setenv("IKSERVO_HOME", str(tmp_path))


@pytest.fixture
def session():
    with ViewSession() as session:
        yield session


def teach_twenty(session):
    """Teach twenty steps, of which the tenth turns the wrist by 50°; return their numbers."""
    numbers = [teach_target(session, JOINT, -4.0), add(session, "close")]
    numbers += [add(session, "wait", wait_s=0.02) for _ in range(6)]
    numbers += [teach_target(session, JOINT, value) for value in (0.0, 50.0)]
    numbers += [add(session, "wait", wait_s=0.02) for _ in range(9)]
    numbers.append(teach_target(session, JOINT, 30.0))
    session.send_message(msg.SetProgram, speed="fast", repeat=1)
    assert len(numbers) == 20
    return numbers


def in_the_middle(session, number, happen):
    """Return a callback that acts once while the step turns the wrist."""
    happened = []

    def on_cycle(_count):
        at_it = panel(session).state_fields()["step"] == number
        if not happened and at_it and degrees(session, JOINT) > 12:
            happened.append(True)
            happen()

    return on_cycle


def try_everything(session):
    """Request each kind of motion; all are refused while the arm is stopped."""
    for kind, fields in [
        (msg.RunProgram, {"action": "play"}),
        (msg.RunProgram, {"action": "step"}),
        (page_messages.SetLive, {"on": True}),
        (page_messages.ArmAction, {"action": "execute"}),
        (page_messages.ArmAction, {"action": "relax"}),
        (page_messages.GoToPose, {"name": "home"}),
        (page_messages.JogJoint, {"joint": JOINT, "step": 5.0}),
        (page_messages.SetTorque, {"joint": JOINT, "on": True}),
    ]:
        with pytest.raises(BadMessageError, match=r"stopped|disconnect|Lost"):
            session.send_message(kind, **fields)
    with pytest.raises(BadMessageError, match="stopped"):
        session.click(450, 300)


@pytest.mark.full
@pytest.mark.sample(1)
@pytest.mark.parametrize("kind", ["stop", *FAULTS])
def test_servo_fault_stops_program_until_acknowledged(session, kind):
    numbers = teach_twenty(session)
    line = line_of(session.arm)

    def fail():
        if kind == "stop":
            session.send_message(page_messages.Stop)
        else:
            line.faults.add(replace(FAULTS[kind], at_s=line.world.time_s))

    state = run(session, on_cycle=in_the_middle(session, numbers[9], fail))
    assert state["phase"] == "stopped"
    assert state["step"] == numbers[9]
    assert "cannot be written" not in session.arm_thread.snapshot.stop_notice.message
    sent = session.record_goals()
    for _ in range(5):
        session.arm_thread.step()
        try_everything(session)
    assert sent == []
    if kind not in RESUMED:
        return
    line.faults.clear()
    session.send_message(page_messages.Acknowledge)
    for _ in range(5):
        session.arm_thread.step()
    assert session.arm_thread.snapshot.stop_notice is None
    assert sent == []
    state = run(session, "step", step=numbers[9])
    assert (state["phase"], state["reason"]) == ("paused", "")
    assert degrees(session, JOINT) == pytest.approx(50.0, abs=1.0)
    assert sent
