"""Servos of a bus are assigned to the joints that the user saw move."""

import copy
import re
import signal
import tomllib
from contextlib import closing, nullcontext

import pytest

import ikservo
import ikservo.hardware.torque
import servosim.port
from ikservo.apps.importing.building import ImportOptions, build_drafts
from ikservo.apps.importing.description_sources import read_foreign
from ikservo.apps.importing.draft import DraftServo
from ikservo.apps.importing.servo_assignment import assign_servos
from ikservo.control.stop_requests import exiting_on_signals
from ikservo.errors import InputError, ServoSilentError
from ikservo.maintenance.dialogue import ACCEPT, Entry, Progress, Question
from tests.apps.importing.hidden_arm import IDS, SIGNS, hide_arm
from tests.oracle import CONFIGS

ARM = CONFIGS / "so101"


@pytest.fixture
def port(tmp_path, monkeypatch):
    """Return a simulated bus of an arm with unknown ids, signs and zeros."""
    hide_arm(tmp_path)
    monkeypatch.setenv("IKSERVO_HOME", str(tmp_path / "home"))
    return f"sim:{tmp_path}/arm.toml?pose=home"


@pytest.fixture(scope="module")
def geometry():
    """Return the draft of that arm with assumed servos, and the poses of its own file."""
    description = read_foreign(ARM / "arm.urdf", {}, {}, allow_xacro=False)
    (draft,) = run(build_drafts(description, "mine", ImportOptions()), None)
    draft.poses = dict(ikservo.load_model("so101").poses)
    return draft


@pytest.fixture
def draft(geometry):
    return copy.copy(geometry)


def run(dialogue, answer):
    """Run a dialogue with a function that answers its questions; return its result."""
    given = None
    while True:
        try:
            item = dialogue.send(given)
        except StopIteration as end:
            return end.value
        given = answer(item) if isinstance(item, Entry | Question) else None


class Onlooker:
    """Answers as a person who watches the arm; ``asked`` are the servos that moved."""

    def __init__(self):
        self.asked, self.joint = [], ""

    def __call__(self, item):
        if isinstance(item, Question):
            self.asked.append(int(re.search(r"Servo (\d+)", item.text)[1]))
            return ACCEPT
        if item.text == "Which joint moved?":
            (self.joint,) = [name for name, each in IDS.items() if each == self.asked[-1]]
            return self.joint
        if "Did it first move" in item.text:
            return "yes" if SIGNS[self.joint] > 0 else "no"
        return item.default


def servos_of(draft):
    return {joint.name: (joint.servos[0].id, joint.servos[0].sign) for joint in draft.joints}


@pytest.mark.full
def test_servo_assignment_uses_servo_that_user_saw_move(draft, port):
    onlooker = Onlooker()
    run(assign_servos([draft], port, {}), onlooker)
    assert servos_of(draft) == {name: (IDS[name], SIGNS[name]) for name in IDS}
    assert sorted(onlooker.asked) == sorted(IDS.values())
    written = tomllib.loads(draft.toml())
    assert {joint["servo"]["model"] for joint in written["joints"]} == {"STS3215"}


@pytest.mark.full
def test_servos_to_assign_move_one_by_one_then_go_limp(draft, port, monkeypatch):
    worlds, moved = [], []
    make = servosim.port.make_arm_world
    monkeypatch.setattr(
        "servosim.port.make_arm_world", lambda *a, **o: worlds.append(make(*a, **o)) or worlds[-1]
    )
    enable = ikservo.hardware.torque.torque_on
    monkeypatch.setattr(
        "ikservo.apps.importing.servo_assignment.torque_on",
        lambda bus, servo_id: moved.append(servo_id) or enable(bus, servo_id),
    )

    class Watcher(Onlooker):
        def __call__(self, item):
            assert not any(servo.read("torque_enable") for servo in worlds[0].servos)
            assert moved == self.asked
            return super().__call__(item)

    run(assign_servos([draft], port, {}), Watcher())
    assert sorted(moved) == sorted(IDS.values())


@pytest.mark.parametrize("number", [None, signal.SIGTERM, signal.SIGHUP])
def test_servo_assignment_ended_in_motion_switches_torque_off(draft, port, monkeypatch, number):
    worlds = []
    make = servosim.port.make_arm_world
    monkeypatch.setattr(
        "servosim.port.make_arm_world", lambda *a, **o: worlds.append(make(*a, **o)) or worlds[-1]
    )
    dialogue = assign_servos([draft], port, {})
    item = next(dialogue)
    while not (isinstance(item, Progress) and "moving" in item.text):
        item = dialogue.send(ACCEPT if isinstance(item, Question) else None)
    assert any(servo.read("torque_enable") for servo in worlds[0].servos)
    with (
        nullcontext() if number is None else pytest.raises(SystemExit),
        exiting_on_signals(),
        closing(dialogue),
    ):
        if number is not None:
            signal.raise_signal(number)
    assert not any(servo.read("torque_enable") for servo in worlds[0].servos)


def test_servo_assignment_moves_nothing_without_consent(draft, port, monkeypatch):
    monkeypatch.setattr("ikservo.apps.importing.servo_assignment.torque_on", None)
    with pytest.raises(InputError, match="was not moved") as caught:
        run(assign_servos([draft], port, {}), lambda item: None)
    assert "--servo JOINT=ID" in caught.value.hint


def test_servo_assignment_does_not_move_servos_given_by_user(draft, port, monkeypatch):
    monkeypatch.setattr("ikservo.apps.importing.servo_assignment.torque_on", None)
    servos = {name: (DraftServo(IDS[name], "", SIGNS[name]),) for name in IDS}
    run(assign_servos([draft], port, servos), None)
    assert servos_of(draft) == {name: (IDS[name], SIGNS[name]) for name in IDS}


def test_servo_assignment_reports_given_servo_that_is_silent(draft, port):
    with pytest.raises(ServoSilentError, match=r"Servo 99 of gripper does not reply\.\n"):
        run(assign_servos([draft], port, {"gripper": (DraftServo(99, ""),)}), None)


def test_servo_assignment_reports_too_few_replying_servos(draft, port, tmp_path):
    text = (tmp_path / "arm.toml").read_text()
    head, gripper = text.split('[[joints]]\nname      = "gripper"')
    (tmp_path / "arm.toml").write_text(head + gripper[gripper.index("# Upper arm") :])
    with pytest.raises(InputError, match="5 servos reply, but the arm has 6 joints"):
        run(assign_servos([draft], port, {}), None)
