"""The page of servos without a browser: searches, watchers, damage, a lost port."""

import itertools
import json
import threading

import numpy as np
import pytest

import servosim
from ikservo.apps.page.messages.page_messages import BadMessageError
from ikservo.apps.page.panels.servo_bench import ServoBench, read_bench_message
from ikservo.apps.page.server.auth import Permission
from ikservo.apps.page.server.downloads import DownloadOffers
from ikservo.apps.workbench import gain_search
from ikservo.arm.arm import Arm
from ikservo.clock import RealClock
from ikservo.model import load_model
from tests.hardware.factories import make_transport

NUMBERS = itertools.count(1)
WAIT_S = 120.0  # a busy machine computes for long


class Session:
    """A bench and one of its pages."""

    def __init__(self, bench):
        self.bench, self.frames = bench, {}
        self.page = bench.connect(Permission.CONTROL)

    def send(self, kind, page=None, **fields):
        words = {"kind": kind, "seq": next(NUMBERS), "seen": 0, **fields}
        self.bench.receive(page or self.page, read_bench_message(json.dumps(words)))

    def act(self, action, **fields):
        self.send("work_on_servo", action=action, **fields)

    def until(self, kind, true):
        """Wait for a frame and keep the frames that come before it."""
        for _ in range(int(WAIT_S / 0.01)):
            for frame in self.bench.frames(self.page):
                self.frames[frame["kind"]] = frame
            if kind in self.frames and true(self.frames[kind]):
                return self.frames.pop(kind)
            threading.Event().wait(0.01)
        raise AssertionError(f"no such {kind} in {WAIT_S} s: {self.frames}")

    def note(self, text):
        return self.until("note", lambda frame: text in frame["text"])


def opened(model, port):
    bench = ServoBench(port, model, DownloadOffers(RealClock()))
    return Session(bench)


@pytest.fixture(autouse=True)
def home(tmp_path, monkeypatch):
    monkeypatch.setenv("IKSERVO_HOME", str(tmp_path))


@pytest.fixture
def session():
    session = opened(load_model("so101"), "sim:?paced=0")
    yield session
    session.bench.close()


@pytest.fixture
def transport(monkeypatch):
    transport = make_transport({1: "STS3215", 7: "STS3215"})
    monkeypatch.setattr("ikservo.hardware.port.open_transport", lambda *_, **__: transport)
    monkeypatch.setattr(transport, "close", lambda: None)
    return transport


@pytest.fixture
def line(transport):
    session = opened(None, "/dev/ttyUSB7")
    yield session
    session.bench.close()


def test_servos_without_arm_file_are_found_and_get_new_id(line, transport):
    shares = []
    found = line.until("line", lambda f: shares.append(f["done"]) or len(f["servos"]) == 2)
    assert [row["name"] for row in found["servos"]] == ["1", "7"]
    line.act("move", joint="7", address=[9, 500_000])
    line.note("id 7 → 9")
    moved = line.until("line", lambda f: f["servos"] and f["servos"] != found["servos"])
    assert transport.line.servos[9].read("lock") == 1
    assert {row["id"] for row in moved["servos"]} <= {1, 9}


def test_servo_search_on_page_can_be_cancelled_at_once(monkeypatch, transport):
    transport.line.servos.clear()
    session = opened(None, "/dev/ttyUSB7")
    session.until("line", lambda frame: frame["done"] is not None)
    session.bench.close()


def test_lost_port_of_servo_page_is_reopened(line, transport):
    line.until("line", lambda frame: len(frame["servos"]) == 2)
    write = transport.write

    def gone(_data):
        raise OSError(5, "Input/output error")

    transport.write = gone
    line.send("read_servo", joint="7")
    line.until("line", lambda frame: "ttyUSB7" in frame["text"] and not frame["servos"])
    transport.write = write
    line.act("search")
    line.until("line", lambda frame: len(frame["servos"]) == 2)


def test_plot_of_servo_register_shows_its_value(session):
    session.act("plot", joint="elbow_flex", names=["present_voltage"])
    first = session.until("plots", lambda frame: True)
    assert [one["quantity"] for one in first["series"]] == ["present_voltage"]
    assert first["values"][0][0] == 7.4


def test_invalid_servo_commands_on_page_show_a_note(session):
    for fields, said in (
        ({"joint": "elbow"}, "elbow_flex"),
        ({"joint": "elbow_flex", "name": "goal_position", "value": "5"}, "cannot write"),
        ({"joint": "elbow_flex", "name": "profile_velocity", "value": "5"}, "cannot write"),
        ({"joint": "elbow_flex", "name": "id", "value": "5"}, "cannot write"),
        ({"joint": "elbow_flex", "name": "p_gain", "value": "x"}, "not a value"),
        ({"joint": "elbow_flex", "name": "p_gain", "value": "255"}, "outside"),
    ):
        kind = "write_register" if "name" in fields else "read_servo"
        session.send(kind, **fields)
        session.note(said)
    for action, more, said in (
        ("restore", {"text": "format = 1"}, "is not an EEPROM backup"),
        ("restore", {"text": "\u0000\ud7ff"}, "backup.toml"),
        ("move", {"address": [3, 12345]}, "does not support 12345 baud"),
        ("led_on", {}, "led"),
        ("reboot", {}, "does not support reboot"),
        ("plot", {"names": ["present_volts"]}, "present_voltage"),
    ):
        session.act(action, joint="elbow_flex", **more)
        session.note(said)


@pytest.mark.parametrize(
    "words",
    [
        {"kind": "stop"},
        {"kind": "work_on_servo", "action": "explode"},
        {"kind": "work_on_servo", "action": "plot", "names": ["a"] * 11},
        {"kind": "work_on_servo", "action": "restore", "text": "x" * 2001},
        {"kind": "work_on_servo", "action": "move", "address": [1]},
        {"kind": "write_register", "joint": "../x", "name": "p_gain", "value": "1"},
    ],
)
def test_foreign_or_malformed_servo_page_message_is_refused(words):
    with pytest.raises(BadMessageError):
        read_bench_message(json.dumps({"seq": 1, "seen": 0, **words}))


def test_watcher_sees_servos_but_cannot_command_them(session):
    watcher = session.bench.connect(Permission.WATCH)
    session.send("read_servo", joint="elbow_flex")
    session.until("servo", lambda frame: frame["joint"] == "elbow_flex")
    with pytest.raises(BadMessageError, match="can only watch"):
        session.send("read_servo", watcher, joint="elbow_flex")
    assert {"line", "servo", "note"} <= {frame["kind"] for frame in session.bench.frames(watcher)}
    assert session.bench.frames(watcher) == []
    session.bench.disconnect(watcher)


def test_servo_commands_beyond_queue_limit_are_refused(session):
    session.until("line", lambda frame: frame["servos"])

    def press_without_end():
        for _ in range(1000):
            session.send("read_servo", joint="elbow_flex")

    with pytest.raises(BadMessageError, match="busy"):
        press_without_end()


def test_servo_with_torque_on_at_start_is_shown_as_torque_on(monkeypatch):
    transport = make_transport({7: "XL430-W250"})
    monkeypatch.setattr("ikservo.hardware.port.open_transport", lambda *_, **__: transport)
    session = opened(None, "/dev/ttyUSB7")
    session.until("line", lambda frame: frame["servos"])
    session.act("reboot", joint="7")
    session.note("torque off")
    session.send("write_register", joint="7", name="startup_configuration", value="1")
    session.note("startup_configuration 0 → 1")
    session.act("reboot", joint="7")
    session.note("torque on")
    session.bench.close()


@pytest.fixture
def raised():
    """The page of an SO-101 in its pose home, where its joints have room."""
    session = opened(load_model("so101"), "sim:?pose=home&paced=0")
    session.send("read_servo", joint="elbow_flex")
    session.until("servo", lambda frame: frame["joint"] == "elbow_flex")
    yield session
    session.bench.close()


def gains_of(session):
    session.send("read_servo", joint="elbow_flex")
    servo = session.until("servo", lambda frame: frame["joint"] == "elbow_flex")
    return {row["name"]: row["raw"] for row in servo["registers"] if row["name"].endswith("_gain")}


def test_trial_gains_are_plotted_and_former_gains_restored(raised):
    before = gains_of(raised)
    raised.act("try", joint="elbow_flex", gains={"p_gain": 64}, step_deg=8)
    trial = raised.until("trial", lambda frame: True)
    assert trial["gains"]["p_gain"] == 64
    goal, first, second = map(np.array, trial["values"])
    assert [each["joint"] for each in trial["series"]] == ["goal", "before", "after"]
    assert abs(goal).max() == pytest.approx(8, abs=0.2)
    reached = [abs(one[len(one) // 3 :] - goal[len(goal) // 3 :]).mean() for one in (first, second)]
    assert 0.0 < reached[1] < reached[0], "a stiffer joint is nearer to its goal"
    assert "before: p_gain 32" in raised.note("former gains are restored")["text"]
    assert gains_of(raised) == before


@pytest.mark.full
def test_servo_page_suggests_better_gains(raised):
    raised.act("suggest", joint="elbow_flex")
    trial = raised.until("trial", lambda frame: True)
    assert trial["gains"]["p_gain"] >= 32
    raised.note("comes to rest")


@pytest.mark.parametrize(
    ("joint", "gains", "said"),
    [
        ("elbow_flex", {"p_gain": 32}, "present gains"),
        ("elbow_flex", {"p_gain": 999}, "a gain from 0 to 254"),
        ("elbow_flex", {"goal_position": 5}, "a gain"),
        ("elbow_flex", {"p_gian": 5}, "p_gain"),
        ("gripper", {"p_gain": 20}, "does not move the tip"),
        ("tail", {"p_gain": 20}, "tail"),
    ],
)
def test_invalid_gain_trial_moves_nothing(raised, joint, gains, said):
    raised.act("try", joint=joint, gains=gains)
    raised.note(said)
    assert "trial" not in raised.frames


def test_gain_trial_needs_servo_of_an_arm(line):
    line.until("line", lambda frame: len(frame["servos"]) == 2)
    line.act("try", joint="7", gains={"p_gain": 20})
    line.note("on a joint of an arm")


@pytest.mark.parametrize("end", ["stop", "leave", "close"])
def test_end_of_gain_trial_restores_former_gains(monkeypatch, end):
    lines, write, stop = [], gain_search.write_gains, Arm.stop
    changed, stopped = threading.Event(), threading.Event()

    def open_and_note(url, opened=servosim.open_port):
        lines.append(opened(url))
        return lines[-1]

    def write_and_wait(*words):
        write(*words)
        changed.set()
        assert stopped.wait(WAIT_S)

    def stop_and_note(*words):
        stop(*words)
        stopped.set()

    monkeypatch.setattr(Arm, "stop", stop_and_note)
    monkeypatch.setattr("servosim.open_port", open_and_note)
    monkeypatch.setattr(gain_search, "write_gains", write_and_wait)
    session = opened(load_model("so101"), "sim:?pose=home&paced=0")
    session.until("line", lambda frame: frame["servos"])
    session.act("suggest", joint="elbow_flex")
    assert changed.wait(WAIT_S), "other gains are in force"
    servo = lines[-1].line.servos[3]
    assert servo.memory.get("p_gain") != 32
    if end == "stop":
        session.act("stop")
        session.note("Stopped on the servo page")
    elif end == "leave":
        session.bench.disconnect(session.page)
    session.bench.close()
    assert servo.memory.get("p_gain") == 32


def test_servo_page_finds_joint_at_its_new_servo_id(session):
    session.act("move", joint="elbow_flex", address=(9, 1_000_000))
    session.note("Change id 3 in the arm file")
    session.send("read_servo", joint="elbow_flex")
    assert session.until("servo", lambda frame: frame["joint"] == "elbow_flex")["id"] == 9
    session.act("move", joint="elbow_flex", address=(10, 1_000_000))
    session.until("servo", lambda frame: frame["id"] == 10)
