"""In Live the arm settles on a target that stays put, as at the end of a motion."""

import math

import pytest

from ikservo.apps.page.messages import page_messages
from ikservo.arm import following, open_arm
from tests.apps.page.view_session import ViewSession
from tests.arm.simulated import true_tip_m

CLICKS = {"koch": (450, 250), "wx250s": (600, 300), "so101": (480, 300)}


class LiveArm(ViewSession):
    """A session in Live that has followed one click, and knows when the arm settles."""

    def __init__(self, arm, monkeypatch):
        super().__init__(open_arm(arm, "sim:?pose=home"))
        self.settling = 0
        self.settled = 0
        original = following.settle_at

        def settle_at(*arguments, **options):
            self.settling += 1
            measured = original(*arguments, **options)
            self.settled += 1
            return measured

        monkeypatch.setattr(following, "settle_at", settle_at)
        self.enable_live().click(*CLICKS[arm])
        self.target_m = self.interaction.marker.target_m

    @property
    def is_settling(self):
        return self.settling > self.settled

    def run_until(self, ended, cycles=4000):
        """Run Live until a condition holds, or for the given number of cycles."""
        live_off = page_messages.SetLive
        self.run(cycles, lambda _: ended() and self.send_message(live_off, on=False))


@pytest.fixture
def koch(monkeypatch):
    with LiveArm("koch", monkeypatch) as live:
        yield live


@pytest.mark.parametrize(
    ("arm", "near_m"),
    [("koch", 1e-3), pytest.param("wx250s", 1e-3, marks=pytest.mark.campaign),
     pytest.param("so101", 1.2e-3, marks=pytest.mark.campaign)],
)  # fmt: skip
def test_tip_settles_on_clicked_point(arm, near_m, monkeypatch):
    with LiveArm(arm, monkeypatch) as live:
        live.run_until(lambda: live.settled)
        assert live.settled == 1
        assert math.dist(true_tip_m(live.arm), live.target_m) < near_m


@pytest.mark.full
def test_settled_arm_stays_in_place_in_live_mode(koch):
    tips_m = []

    def note(_):
        if koch.settled:
            tips_m.append(true_tip_m(koch.arm))

    koch.run_until(lambda: note(0) or len(tips_m) > 400)
    assert max(math.dist(tips_m[0], tip_m) for tip_m in tips_m) < 0.5e-3
    assert koch.settled == 1


@pytest.mark.full
def test_click_during_settling_is_followed_at_once(koch):
    times_s = []

    def click(_):
        if koch.is_settling and not times_s:
            koch.click(CLICKS["koch"][0] + 60, CLICKS["koch"][1])
            koch.target_m = koch.interaction.marker.target_m
            times_s.append(koch.clock.now_s())
        if times_s and len(times_s) == 1 and not koch.is_settling:
            times_s.append(koch.clock.now_s())

    koch.run_until(lambda: koch.settled == 2 or click(0))
    assert times_s[1] - times_s[0] < 0.2
    assert math.dist(true_tip_m(koch.arm), koch.target_m) < 1e-3


@pytest.mark.full
def test_silent_page_during_settling_ends_live_mode(koch):
    def on_cycle(_):
        if not koch.settling:
            koch.send_message(page_messages.Heartbeat, visible=True)

    koch.run(4000, on_cycle, heartbeats=False)
    assert not koch.latest_frames()["status"]["live"]


@pytest.mark.full
def test_stop_during_settling_is_obeyed(koch):
    koch.run_until(lambda: koch.is_settling and koch.send_message(page_messages.Stop))
    koch.arm_thread.step()
    assert koch.latest_frames()["status"]["mode"] == "stopped"


@pytest.mark.full
def test_refused_target_after_settling_is_reported_once(koch):
    koch.run_until(lambda: koch.settled)
    koch.enable_live().send_message(page_messages.SetTool, what="z", value=-40.0)
    koch.run(300)
    assert len(koch.arm_thread.snapshot.messages) == 1


@pytest.mark.full
def test_page_in_live_mode_shows_remaining_error_in_mm(koch):
    koch.run_until(lambda: koch.settled)
    koch.send_message(page_messages.SetLive, on=True)
    koch.click(*CLICKS["koch"])
    rows = {name: text for name, text, _ in koch.latest_frames()["status"]["tip"]}
    assert rows["off"].endswith(" mm")
