"""Two arms on one page: one is guided by hand, the other follows; the page shows the lag."""

import pytest
from playwright.sync_api import expect

from servosim.joint import Hand, glide
from tests.arm.simulated import line_of, registers, true_joints
from tests.browser.page_operator import Operator, until, with_long_timeout
from tests.browser.test_browser_arms import opened_panel
from tests.browser.test_browser_page import CONTRAST, NAMES, SMALL

pytestmark = pytest.mark.browser

TURN_RAD = 0.4


@pytest.fixture
def two():
    with opened_panel(("planar3", "sim:?pose=home"), ("planar3", "sim:?pose=home")) as served:
        yield served


@pytest.fixture
def page(browser):
    context = browser.new_context(viewport={"width": 1100, "height": 800})
    page = with_long_timeout(context.new_page())
    yield page
    context.close()


def turn(arm, by_rad):
    here = joint3_rad(arm)
    line_of(arm).world.grasp("joint3", Hand(glide(here, here + by_rad, 0.4)))


def joint3_rad(arm):
    return true_joints(arm)["joint3"]


def test_follower_on_page_follows_leader_until_stopped(page, two):
    operator = Operator(page, two)
    leader, follower = (two.app.arms.find(name).arm_thread.arm for name in ("planar3-2", "planar3"))
    page.click("#speeds button[value=fast]")
    page.click("#arms-toggle")
    page.click("[aria-label='Follow planar3-2']")
    page.wait_for_selector("#leader-state:has-text('torque is on')")
    expect(page.locator("#follow")).to_be_disabled()
    page.click("#leader-release")
    page.click("#leader-release")
    page.wait_for_selector("#leader-state:has-text('ready to lead')")
    before = joint3_rad(follower)
    page.click("#follow")
    page.wait_for_selector("#mode:has-text('Following planar3-2')")
    turn(leader, TURN_RAD)
    until(lambda: " ms" in page.inner_text("#leader-lag"), lambda: page.inner_text("#leader"))
    until(lambda: abs(joint3_rad(follower) - before - TURN_RAD) < 0.03)
    drawn = "[...document.querySelectorAll('#drawing, #leader-drawing')].map((c) => c.width)"
    assert all(width > 200 for width in page.evaluate(drawn))
    for scheme in ("light", "dark"):
        page.emulate_media(color_scheme=scheme, reduced_motion="reduce")
        assert page.evaluate(CONTRAST) == []
    assert page.evaluate(SMALL, 24) == []
    assert all(page.evaluate(NAMES))
    page.keyboard.press("Space")
    operator.wait_for("status.mode === 'stopped'")
    held = registers(follower, "goal_position")
    turn(leader, -TURN_RAD)
    expect(page.locator("#leader-acknowledge")).to_be_hidden()  # nobody has to look at a limp arm
    page.click("#acknowledge")
    page.wait_for_selector("#leader-state:has-text('ready to lead')")
    until(lambda: abs(joint3_rad(leader) - before) < 0.05)
    assert registers(follower, "goal_position") == held
    page.click("#leader-close")
    expect(page.locator("#leader")).to_be_hidden()
