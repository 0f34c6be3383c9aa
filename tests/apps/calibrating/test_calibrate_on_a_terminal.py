"""On a terminal, the calibration draws meters and accepts single keys."""

import io
import math
import os
import sys

import pytest
from rich.console import Console, ConsoleDimensions
from rich.live import Live

from ikservo.apps.calibrating.by_hand_dialogue import record_ranges
from ikservo.apps.calibrating.by_hand_procedure import (
    CalibrationStage,
    CalibrationState,
    joint_readouts,
)
from ikservo.cli import terminal_dialogue as dialogue
from ikservo.cli.terminal import read_keys
from ikservo.cli.terminal_dialogue import Operator
from tests.calibration.factories import make_swept_state
from tests.calibration.mounted_arms import load_model, make_mounted_arm
from tests.calibration.scripted_operator import schedule_operator

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="Windows has no ptys")


@pytest.fixture
def terminal(monkeypatch):
    """Yield a writer for the terminal that is stdin."""
    master, slave = os.openpty()
    stdin = os.fdopen(slave, "r")
    monkeypatch.setattr(sys, "stdin", stdin)
    yield lambda text: os.write(master, text.encode())
    stdin.close()
    os.close(master)


@pytest.fixture
def picture(monkeypatch):
    """Draw into memory; return the last drawing."""
    monkeypatch.setenv("TERM", "xterm")  # rich takes a dumb terminal for 80 columns wide
    console = Console(file=io.StringIO(), force_terminal=True, width=110, color_system=None)
    drawn = []
    update = Live.update

    def noted(live, renderable, **more):
        with console.capture() as capture:
            console.print(renderable)
        drawn.append(capture.get())
        update(live, renderable, **more)

    monkeypatch.setattr(Live, "update", noted)
    monkeypatch.setattr(dialogue, "open_console", lambda **_: console)
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    return drawn


def test_key_reader_returns_at_once_with_or_without_key(terminal):
    with read_keys() as key:
        assert key() == ""
        terminal("u")
        assert key() == "u"
        assert key() == ""


def conversation(arm, terminal, typed):
    """Run a conversation; ``typed`` returns the typed text for each request."""
    with arm.open_limp() as limp_arm:
        limp_arm.disable_torque()
        schedule_operator(arm, limp_arm.make_subjects("home"))
        state = CalibrationState(limp_arm.make_subjects("home"), math.radians(0.3))

        def watched():
            recording = record_ranges(limp_arm, state, "home")
            answer = None
            while True:
                try:
                    request = recording.send(answer)
                except StopIteration as end:
                    return end.value
                terminal(typed(request))
                answer = yield request

        return Operator(None, yes=False, interactive=True).run(watched())


def still(request):
    return request.choices[0].wait_s is not None


def test_enter_key_accepts_pose_and_ends_sweep(terminal, picture):
    def typed(request):
        return "\n" if still(request) and (request.stage == "anchor" or request.at_s > 6.5) else ""

    state = conversation(make_mounted_arm("planar2", 7), terminal, typed)
    assert state.stage is CalibrationStage.REVIEW
    swept = picture[-1]
    assert "joint1" in swept
    assert "-150° … 150°" in swept
    assert "━" in swept
    assert swept.count("✓") >= 2


def test_early_enter_key_names_unmoved_joint_and_continues(terminal, picture):
    result = []

    def typed(request):
        result.append(picture[-1] if picture else "")
        if request.stage == "anchor":
            return "\n" if still(request) else ""
        return "\n" if request.at_s < 1.0 or request.at_s > 6.5 else ""

    state = conversation(make_mounted_arm("planar2", 7), terminal, typed)
    assert state.stage is CalibrationStage.REVIEW
    assert any("joint1 has not been moved yet. Move it, or skip it." in text for text in result)


def test_calibration_key_s_skips_joint_and_key_u_undoes_it(terminal, picture):
    pressed = iter(["s", "u", "s"])

    def typed(request):
        if request.stage == "anchor":
            return "\n" if still(request) else ""
        if request.at_s < 1.0:
            return next(pressed, "")
        return "\n" if request.at_s > 6.5 else ""

    state = conversation(make_mounted_arm("planar2", 7), terminal, typed)
    assert state.skipped == {"joint1"}


@pytest.mark.parametrize("width", [60, 80, 120])
@pytest.mark.parametrize("name", ["so101", "wx250s"])
def test_calibration_joint_table_fits_terminal_width(name, width):
    arm = make_mounted_arm(name, 7, spoiled=False)
    with arm.open_limp() as limp_arm:
        state = make_swept_state(limp_arm, {i: arm.direction(i) for i in arm.line.servos})
    console = Console(file=io.StringIO(), force_terminal=True, width=width, color_system=None)
    with console.capture() as capture:
        console.print(dialogue._joint_table(tuple(joint_readouts(state)), "", width))
    lines = capture.get().splitlines()
    assert len(lines) == 1 + len(load_model(name).joints)  # no row is folded
    assert max(map(len, lines)) <= width
    assert "…\n" not in capture.get()  # nothing is cut off at the end


@pytest.mark.full
def test_resized_terminal_is_cleared_before_next_drawing(terminal, picture, monkeypatch):
    cleared = []
    monkeypatch.setattr(Console, "clear", lambda console, home=True: cleared.append(console.width))

    def typed(request):
        if request.stage == "anchor":
            return "\n" if still(request) else ""
        if request.at_s > 2.0:
            monkeypatch.setattr(Console, "size", property(lambda _: ConsoleDimensions(70, 24)))
        return "\n" if request.at_s > 6.5 else ""

    conversation(make_mounted_arm("planar2", 7), terminal, typed)
    assert len(cleared) == 1
