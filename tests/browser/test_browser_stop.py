"""Stop is visible wherever the page is scrolled, and old data is marked if the server is gone."""

import pytest
from playwright.sync_api import expect

from tests.arm.simulated import servo_id
from tests.browser.test_browser_safety import OWN, stops_there, under_way

pytestmark = pytest.mark.browser

WIDTHS = (390, 701, 820, 1020, 1100, 1600)

# Where in the page's height it is scrolled to, and whether a finger there would touch the button.
TOUCHED = """(part) => {
  scrollTo(0, part * document.documentElement.scrollHeight);
  const box = document.getElementById("stop").getBoundingClientRect();
  const at = document.elementFromPoint(box.x + box.width / 2, box.y + box.height / 2);
  return Boolean(at?.closest("#stop")) && box.top >= 0 && box.bottom <= innerHeight
    && box.left >= 0 && box.right <= innerWidth && box.height >= 40;
}"""


@pytest.mark.sample(1)
@pytest.mark.parametrize(
    ("width", "scheme"),
    [
        (390, "dark"),
        (820, "light"),
        *(
            pytest.param(width, scheme, marks=pytest.mark.campaign)
            for width in WIDTHS
            for scheme in ("light", "dark")
        ),
    ],
)
def test_stop_button_is_visible_at_every_scroll_position(visit, width, scheme):
    operator = visit(color_scheme=scheme)
    operator.page.set_viewport_size({"width": width, "height": 844})
    operator.wait_for_picture()
    assert [operator.page.evaluate(TOUCHED, part) for part in (0, 0.5, 1)] == [True] * 3
    operator.page.click("#stop")
    operator.page.wait_for_selector("#banner:not([hidden])")
    assert [operator.page.evaluate(TOUCHED, part) for part in (0, 0.5, 1)] == [True] * 3
    assert operator.page.locator("#acknowledge").bounding_box()["y"] < 844


@pytest.mark.smoke
@pytest.mark.parametrize(
    "width", [820, pytest.param(390, marks=pytest.mark.campaign)], ids="{} px".format
)
def test_stop_button_at_page_bottom_works_with_one_touch(visit, width):
    operator = visit(has_touch=True)
    operator.page.set_viewport_size({"width": width, "height": 900})
    operator.wait_for_picture()
    under_way(operator.enable_live().until_still())
    operator.page.evaluate("scrollTo(0, 1e6)")
    operator.page.touchscreen.tap(*middle_of(operator, "#stop"))
    assert stops_there(operator)


def middle_of(operator, selector):
    box = operator.page.locator(selector).bounding_box()
    return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2


@OWN
def test_page_without_server_disables_stop_and_marks_data_old(operator):
    operator.served.server.close()
    operator.until("document.body.dataset.mode === 'lost'")
    expect(operator.page.locator("#stop")).to_be_disabled()
    expect(operator.page.locator("#stop")).to_have_text("Cannot stop")
    banner = operator.page.inner_text("#banner")
    assert "Stop cannot reach the arm" in banner
    assert "torque of the arm was on" in banner
    expect(operator.page.locator("#acknowledge")).to_be_hidden()
    operator.until("/ is [1-9] s old/.test(document.getElementById('age').textContent)")
    for control in ("#live", "#speeds", "#views", ".stage"):
        expect(operator.page.locator(control)).to_have_attribute("inert", "")


@OWN
def test_unresponsive_server_is_reported_until_it_answers(operator):
    controller = operator.served.view.controller
    controller.frames = lambda _: []
    operator.until("document.body.dataset.mode === 'silent'")
    expect(operator.page.locator("#banner")).to_contain_text("does not answer")
    expect(operator.page.locator("#stop")).to_be_enabled()
    del controller.frames
    operator.until("document.body.dataset.mode === 'preview'")
    expect(operator.page.locator("#banner")).to_be_hidden()
    operator.until("!document.getElementById('age').textContent")
    assert operator.page.get_attribute(".stage", "inert") is None


@OWN
def test_pulled_cable_marks_data_on_page_as_old(operator):
    operator.served.line.plugged = False
    operator.wait_for("status.mode === 'stopped' && status.age_s >= 1")
    operator.until("document.body.hasAttribute('data-old')")
    expect(operator.page.locator("#banner-message")).to_contain_text("Lost connection")


@OWN
def test_stop_of_arm_with_limp_servo_does_not_claim_to_hold(operator):
    operator.served.line.servos[servo_id("so101", "elbow_flex")].write("torque_enable", 0)
    operator.wait_for("status.health.joints.some((joint) => joint.torque === 'off')")
    operator.page.click("#stop")
    operator.wait_for("status.mode === 'stopped'")
    expect(operator.page.locator("#banner-message")).to_contain_text("torque of elbow_flex is off")


def release(operator):
    operator.page.click("#release")
    operator.page.click("#release")  # it falls: sure
    operator.wait_for("status.health.joints.every((joint) => joint.torque === 'off')")
    operator.wait_for("status.mode === 'preview'")


@OWN
def test_escape_closes_help_and_leaves_limp_arm_in_preview(operator):
    release(operator)
    for opener, opened in (("#help-button", "#help"), ("#arms-toggle", "#arms")):
        operator.page.click(opener)
        count = operator.status["stop_count"]
        operator.page.keyboard.press("Escape")
        operator.wait_for(f"status.stop_count === {count + 1}")
        expect(operator.page.locator(opened)).to_be_hidden()
        assert operator.status["mode"] == "preview"
    expect(operator.page.locator("#banner")).to_be_hidden()
    expect(operator.page.locator("#plots")).to_be_hidden()
    operator.until("document.getElementById('stop-word').textContent === 'Stop'")


def test_escape_closes_help_and_stops_a_moving_arm(live):
    live.page.click("#help-button")
    live.page.evaluate("document.getElementById('help').style.pointerEvents = 'none'")
    under_way(live)
    live.page.keyboard.press("Escape")
    assert stops_there(live)
    expect(live.page.locator("#help")).to_be_hidden()
    expect(live.page.locator("#plots")).to_be_hidden()
