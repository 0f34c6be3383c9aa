"""The page shows the true state: refused goals, limp servos, supplies, ended Live."""

import numpy as np
import pytest
from playwright.sync_api import expect

from servosim.faults import Fault
from tests.arm.simulated import servo_id
from tests.browser.page_operator import Operator, attempts
from tests.browser.test_browser_safety import FAR, OWN

pytestmark = pytest.mark.browser


def below_the_table(operator):
    """Return a pixel 40 mm below the table, under the tip, which the arm could reach."""
    tip_m = operator.served.tip_m()
    return operator.tip_px() + np.array([0.0, (tip_m[2] + 0.04) * operator.pixels_per_metre])


REFUSED = "status.refused && scene.refusal"


def test_preview_shows_refusal_below_table_beside_pointer(operator):
    at = below_the_table(operator)
    drawn = " && ".join(
        f"items.some(({{ style }}) => style === '{each}')"
        for each in ("touching", "target_refused")
    )
    operator.click(at).wait_for(f"{REFUSED} && {drawn}")
    assert not operator.items("target")
    assert not operator.items("ghost")
    words = operator.page.inner_text("#refusal")
    assert "would touch the table" in words
    box = operator.page.locator("#refusal").bounding_box()
    assert abs(box["x"] - operator.over(at)[0]) < 60
    assert abs(box["y"] - operator.over(at)[1]) < 60
    assert ["target", "bad"] in [[name, level] for name, _, level in operator.status["tip"]]
    assert operator.status["messages"][-1]["message"] == words
    operator.click(operator.tip_px() + FAR / 2).wait_for(
        "!status.refused && !scene.refusal && items.some(({ style }) => style === 'ghost')"
    )
    expect(operator.page.locator("#refusal")).to_be_hidden()


SLOW_FRAMES = """(frame_ms) => {
  window.requestAnimationFrame = (draw) => setTimeout(() => draw(performance.now()), frame_ms);
}"""  # as 3D without a graphics card, in a browser that still hears from the server


def test_click_on_picture_older_than_1_s_is_ignored_with_notice(operator):
    page, before = operator.page, operator.served.goals()
    page.evaluate(SLOW_FRAMES, 1300)
    reported = page.locator("#banner-message", has_text="more than 1 s old, so nothing was done")
    for _ in attempts(lambda: page.wait_for_timeout(1300)):  # what was on its way is drawn first
        operator.click(operator.tip_px() + FAR / 2)
        if reported.is_visible():
            break
    expect(reported).to_be_visible()
    expect(page.locator("#banner-hint")).to_contain_text("Try again")
    assert operator.served.goals() == before
    assert page.locator("#log", has_text="nothing was done").count() == 1


def test_refusal_of_typed_target_is_shown_as_long_as_on_drawing(operator):
    page = operator.page
    page.evaluate(SLOW_FRAMES, 400)  # what it says is here before its picture
    page.fill("#tool-z", "-60")
    page.press("#tool-z", "Enter")
    operator.wait_for("scene.refusal")
    expect(page.locator("#target-note")).to_contain_text("would touch the table")
    page.click("#undo")
    operator.wait_for("!scene.refusal")
    expect(page.locator("#target-note")).to_have_text("")


SLOW_PROOF = """(() => {
  const send = WebSocket.prototype.send;
  let first = true;
  WebSocket.prototype.send = function (text) {
    if (!first) return send.call(this, text);
    first = false;
    setTimeout(() => this.readyState === WebSocket.OPEN && send.call(this, text), 2500);
  };
})()"""


def test_page_reconnects_if_its_key_proof_is_late(browser, view):
    context = browser.new_context()
    context.add_init_script(SLOW_PROOF)
    try:
        Operator(context.new_page(), view).wait_for("status.mode === 'preview'")
    finally:
        context.close()


@pytest.mark.campaign
def test_live_mode_refuses_target_below_table_and_keeps_goals(live):
    before = live.until_still().served.goals()
    live.click(below_the_table(live)).wait_for(REFUSED)
    assert live.items("target_refused")
    expect(live.page.locator("#refusal")).to_contain_text("would touch the table")
    live.until_still()
    assert max(abs(live.served.goals()[i] - before[i]) for i in before) <= 2


@pytest.mark.parametrize("view", [{"calibrated": False}], indirect=True, ids=["uncalibrated"])
def test_uncalibrated_arm_is_reported_beside_calibrate_button(operator):
    expect(operator.page.locator("#unit")).to_have_text("not calibrated")
    expect(operator.page.locator("#calibrate")).to_be_enabled()
    expect(operator.page.locator("#live")).to_be_disabled()
    expect(operator.page.locator("#mode")).to_contain_text("not calibrated")


def test_live_mode_ended_by_hidden_page_resumes_by_one_button(live):
    live.page.evaluate(
        "Object.defineProperty(document, 'visibilityState', { get: () => 'hidden', configurable: true });"  # noqa: E501
        "document.dispatchEvent(new Event('visibilitychange'));"
        "delete document.visibilityState;"
    )
    live.wait_for("status.mode === 'preview' && status.banner?.action === 'go_live'")
    expect(live.page.locator("#banner-message")).to_contain_text("the page was hidden")
    live.page.click("#go-live")
    live.wait_for("status.mode === 'live' && !status.banner").until_still()
    live.click(live.tip_px() + FAR / 2).until_moving()


@OWN
def test_page_reports_limp_servo_and_low_supply_voltage(operator):
    expect(operator.page.locator("#mode")).to_have_text("Preview – the arm holds")
    operator.served.line.servos[servo_id("so101", "elbow_flex")].write("torque_enable", 0)
    operator.until("document.getElementById('mode').textContent.includes('limp: elbow_flex')")
    operator.wait_for("status.tip.some(([name, text]) => name === 'limp' && text === 'elbow_flex')")
    operator.wait_for(
        "status.messages.some((m) => m.message.startsWith('elbow_flex lost torque without'))"
    )
    line = operator.served.line
    line.faults.add(Fault("voltage", volts=4.5, at_s=line.world.time_s))
    operator.wait_for("status.tip.some(([name]) => name === 'supply')")
    row = next(text for name, text, _ in operator.status["tip"] if name == "supply")
    assert row == "4.5 V, below 5.9 V"


@pytest.mark.campaign
def test_page_lists_messages_in_chronological_order(operator):
    operator.click(below_the_table(operator)).wait_for(REFUSED)
    operator.page.click("#stop")
    operator.wait_for("status.mode === 'stopped'")
    operator.page.click("#acknowledge")
    operator.wait_for("status.mode === 'preview'").wait_for_picture()
    operator.click(below_the_table(operator)).wait_for(REFUSED)
    latest = operator.status["messages"][-2:]
    assert "Stopped from the page" in latest[0]["message"]
    assert "would touch" in latest[1]["message"]
    times = [entry["time_s"] for entry in operator.status["messages"]]
    assert times == sorted(times)
    shown = operator.page.locator("#log li").all_inner_texts()
    assert latest[1]["message"] in shown[-1]
