"""Panels of other apps on the page: rows, buttons that move the arm, and panels that fail."""

import pytest

from ikservo.app import App, Panel
from ikservo.apps.page.messages.page_messages import BadMessageError, Heartbeat, RunPanelMotion
from ikservo.apps.page.panels import app_panels
from ikservo.apps.page.server.auth import Permission
from ikservo.planning.motions import MoveJoints
from tests.apps.page.test_served_arms import served
from tests.arm.simulated import true_joints
from tests.browser.page_operator import until

STEP_RAD = 0.2


def show_first_joint(model, positions):
    name = model.chain.names[0]
    step = MoveJoints({name: positions[name] + STEP_RAD})
    return Panel([(name, f"{positions[name]:.1f} rad")], {"Step": step})


def fail(model, positions):
    raise KeyError("elbow")


class Page:
    def __init__(self, arms):
        self.session, self.seq, self.panels = arms.find("planar3"), 0, []
        self.client = self.session.connect(Permission.CONTROL)

    def say(self, kind, word, **fields):
        self.seq += 1
        self.session.receive(self.client, kind(kind=word, seq=self.seq, seen=0, **fields))

    def shown(self):
        """Return the panels that the page shows now."""
        self.say(Heartbeat, "heartbeat", visible=True)
        for frame in self.session.frames(self.client):
            if frame["kind"] == "app_panels":
                self.panels = frame["panels"]
        return self.panels

    def press(self, heading, button):
        self.say(RunPanelMotion, "run_panel_motion", heading=heading, button=button)


@pytest.fixture
def page(monkeypatch):
    here = __name__
    app = App(name="nod", panels={"First": f"{here}:show_first_joint", "Broken": f"{here}:fail"})
    monkeypatch.setattr(app_panels, "all_apps", lambda: (app,))
    with served(("planar3", "sim:?pose=home")) as (arms, _):
        yield Page(arms)


def test_app_panel_shows_rows_and_buttons(page):
    first, _ = page.shown()
    assert (first["heading"], first["buttons"]) == ("First", ["Step"])
    assert first["rows"][0][1].endswith(" rad")


def test_app_panel_that_raises_shows_its_error(page):
    _, broken = page.shown()
    assert broken["rows"] == [("error", "KeyError: 'elbow'")]


def test_app_panel_button_moves_arm(page):
    arm = page.session.arm_thread.arm
    name, before = arm.joint_names[0], true_joints(arm)[arm.joint_names[0]]
    page.shown()
    page.press("First", "Step")
    until(lambda: page.shown() and abs(true_joints(arm)[name] - before - STEP_RAD) < 0.02)


def test_refused_motion_of_app_panel_does_not_latch_stop(page, monkeypatch):
    thread = page.session.arm_thread
    monkeypatch.setattr(f"{__name__}.STEP_RAD", 9.0)
    page.shown()
    page.press("First", "Step")
    until(lambda: page.shown() and thread.job is None)
    assert thread.snapshot.stop_notice is None


def test_unknown_button_of_app_panel_is_refused(page):
    page.shown()
    with pytest.raises(BadMessageError, match="no button"):
        page.press("First", "Jump")


def test_app_panel_button_needs_control_permission(page):
    page.shown()
    watcher = page.session.connect(Permission.WATCH)
    message = RunPanelMotion(kind="run_panel_motion", seq=1, seen=0, heading="First", button="Step")
    with pytest.raises(BadMessageError):
        page.session.receive(watcher, message)
