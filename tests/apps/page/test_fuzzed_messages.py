"""Each of a million nearly valid messages is refused, or does what it says and no more."""

import gc
import json
import random
import tracemalloc

import pytest

from ikservo.apps.page.messages.page_messages import BadMessageError, read_message
from ikservo.apps.page.server.auth import Permission
from ikservo.apps.page.server.message_age_and_rate import MessageFilter
from tests.apps.page.view_session import ViewSession
from tests.arm.simulated import registers

WORDS = [
    {"kind": "pointer", "phase": "down", "x": 480, "y": 300, "button": 0, "pointer": 1},
    {"kind": "pointer", "phase": "move", "x": 410.5, "y": 260, "button": 0, "pointer": 1,
     "touch": True, "shift": False, "alt": False},
    {"kind": "set_live", "on": True}, {"kind": "take_control", "on": True}, {"kind": "stop"},
    {"kind": "acknowledge"}, {"kind": "heartbeat", "visible": True},
    {"kind": "go_to_pose", "name": "rest"}, {"kind": "set_solver", "name": "ccd"},
    {"kind": "gamepad", "axes": [0, 1, -1, 0], "grip": 0.5},
    {"kind": "viewport", "w": 900, "h": 700, "dpr": 2, "view": "side"},
    {"kind": "wheel", "x": 480, "y": 300, "notches": 2, "alt": False},
    {"kind": "key", "key": "ArrowUp", "alt": False, "shift": False},
    {"kind": "orbit_camera", "dx": 10, "dy": -4, "zoom": 1.5, "at": [40, 50]},
    {"kind": "track_hand", "position": [0, 0.1, 0], "rotation": [1, 0, 0, 0], "held": True,
     "clutch": 3, "scale": 1, "stamp": 5},
    {"kind": "fit_view"}, {"kind": "undo", "redo": False},
    {"kind": "arm_action", "action": "execute"}, {"kind": "mark_tip", "x": 480, "y": 300},
    {"kind": "choose_camera", "camera": "left"},
    {"kind": "set_speed", "name": "fast"},
    {"kind": "behind", "step": -1},
    {"kind": "prefer", "pose": "rest", "weights": {"elbow_flex": 0.5}},
    {"kind": "set_joint", "joint": "elbow_flex", "value": 12.5},
    {"kind": "jog_joint", "joint": "wrist_roll", "step": -5},
    {"kind": "set_tool", "what": "x", "value": 200}, {"kind": "jog_tool", "what": "z", "step": 5},
    {"kind": "point_tool", "direction": [0, 0, -1]},
    {"kind": "set_torque", "joint": "elbow_flex", "on": False},
    {"kind": "calibration", "action": "start", "joint": None},
    {"kind": "add_step", "what": "target", "path": "line", "pose": None, "after": None},
    {"kind": "change_step", "step": 1, "speed": "fast", "wait_s": 0.5, "corner": "row_m",
     "grid": {"rows": 2, "columns": 3}},
    {"kind": "move_step", "step": 2, "to": 0}, {"kind": "delete_step", "step": 1},
    {"kind": "set_program", "speed": "slow", "repeat": 2},
    {"kind": "program_file", "action": "new", "name": "tea"},
    {"kind": "run_program", "action": "play", "step": None},
    {"kind": "follow_arm", "leader": "koch"},
    {"kind": "run_panel_motion", "heading": "Nod", "button": "Nod"},
]  # fmt: skip
VALUES = [None, True, -1, 0, 1e308, -1e308, 2**63, "", "x" * 70, "../rest", [], {}, [[]], 1e-320,
          "NaN", "\u0000", "ArrowLeft", "side", 0.5]  # fmt: skip


def with_another_value(rng, words):
    """Return a message with one changed value or key."""
    words = dict(words)
    name = rng.choice(list(words))
    value = words.pop(name) if rng.random() < 0.2 else rng.choice(VALUES)
    words[name if rng.random() < 0.8 else rng.choice(list(WORDS[1]))] = value
    return json.dumps(words)


def with_other_letters(rng, words):
    """Return a message with a few characters changed, removed or doubled."""
    letters = list(json.dumps(words))
    for _ in range(rng.randint(1, 4)):
        at = rng.randrange(len(letters))
        letters[at : at + 1] = rng.choice([[], [letters[at]] * 2, [chr(rng.randrange(1, 300))]])
    return "".join(letters)


def spliced(rng, words):
    """Return the beginning of one message and the end of another."""
    first, second = json.dumps(words), json.dumps(rng.choice(WORDS))
    return first[: rng.randrange(len(first))] + second[rng.randrange(len(second)) :]


def fuzz(count, seed, receive):
    """Let ``hear`` receive many messages; return how many were accepted."""
    rng, received = random.Random(seed), 0
    for number in range(count):
        words = {**rng.choice(WORDS), "seq": number % 1000 + 1, "seen": 0}
        change = rng.choice([with_another_value, with_other_letters, spliced])
        try:
            message = MessageFilter(0.0, read_message).accept(change(rng, words), 0.0)
        except BadMessageError:
            continue
        received += 1
        receive(message)
    return received


@pytest.fixture
def session():
    with ViewSession() as session:
        yield session


COUNTS = pytest.mark.parametrize(
    "count",
    [1_000, pytest.param(1_000_000, marks=[pytest.mark.campaign, pytest.mark.timeout(1800)])],
)


@COUNTS
def test_fuzzed_watcher_messages_change_nothing(session, count):
    watcher, command = session.connect(Permission.WATCH), session.arm_thread.command

    def receive(message):
        if message.kind == "stop":  # which everybody may
            return
        try:
            session.controller.receive(watcher, message)
        except BadMessageError:
            return

    assert fuzz(count, seed=1, receive=receive) > count / 50
    assert session.arm_thread.command is command


@COUNTS
def test_fuzzed_preview_messages_do_not_move_servos(session, count):
    before, others = registers(session.arm, "goal_position"), []

    def receive(message):
        if message.kind in (
            "set_live",
            "calibration",
            "arm_action",
        ):  # these may move it, and are right as they are
            others.append(message)
            return
        try:
            session.controller.receive(session.client, message)
        except BadMessageError:
            return

    assert fuzz(count, seed=2, receive=receive) > count / 50
    assert {message.kind for message in others} == {"set_live", "calibration", "arm_action"}
    session.arm_thread.step()
    assert registers(session.arm, "goal_position") == before


@pytest.mark.parametrize("count", [1_000, pytest.param(100_000, marks=pytest.mark.campaign)])
def test_fuzzed_page_messages_do_not_leak_memory(count):
    fuzz(500, seed=3, receive=lambda _: None)
    tracemalloc.start()
    fuzz(count, seed=4, receive=lambda _: None)
    gc.collect()  # errors and their tracebacks refer to each other
    kept, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert kept < 500_000
