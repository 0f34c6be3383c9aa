"""Safety of the page: what stops the arm, and who may move it."""

import hashlib
import hmac

import numpy as np
import pytest
from playwright.sync_api import expect

from servosim.faults import Fault
from tests.browser.page_operator import SHOWN, with_long_timeout

pytestmark = pytest.mark.browser

OWN = pytest.mark.parametrize("view", [{}], indirect=True, ids=["own"])
KEYS = ("Space", "Escape", "Space on Live")
HANG = "(() => { const t = performance.now(); while (performance.now() < t + 900); })()"
FAR = np.array([60.0, -100.0])  # over nothing, within reach


def under_way(operator):
    """Send the arm far at a moderate speed; return once it moves."""
    operator.page.click("#speeds button[value=normal]")
    operator.wait_for("status.speed === 'normal'")
    return operator.click(operator.tip_px() + FAR).until_moving()


def stops_there(operator):
    operator.wait_for("status.mode === 'stopped'").until_still()
    served = operator.served
    short = max(abs(served.goals()[i] - served.ticks()[i]) for i in served.goals())
    return short < 60 and not operator.status["live"]


@pytest.mark.parametrize(
    "way",
    ["#stop", *(pytest.param(key, marks=pytest.mark.campaign) for key in KEYS)],
)
def test_stop_on_page_holds_the_moving_arm(live, way):
    under_way(live)
    if way == "Space on Live":
        live.page.focus("#live")
    live.page.click(way) if way == "#stop" else live.page.keyboard.press(way.split()[0])
    assert stops_there(live)


@pytest.mark.campaign
def test_stop_on_page_stays_until_acknowledged(live):
    live.page.click("#stop")
    live.wait_for("status.mode === 'stopped'").until_still()
    before = live.served.ticks()
    live.click(live.tip_px() + FAR)
    live.until_still()
    assert live.served.ticks() == before
    live.page.click("#acknowledge")
    live.wait_for("status.mode === 'preview'").enable_live()
    live.click(live.tip_px() + FAR).until_moving()


@OWN
def test_page_reports_unplugged_servo_as_command_line_does(live):
    under_way(live)
    live.served.line.faults.add(Fault("silent", id=4, at_s=live.served.line.world.time_s))
    live.page.wait_for_selector("#banner:not([hidden])")
    banner = live.page.inner_text("#banner")
    assert "wrist_flex (id 4)" in banner
    assert "Check its connector" in banner
    live.wait_for("status.mode === 'stopped'")


@OWN
@pytest.mark.campaign
def test_page_reports_unplugged_adapter(live):
    live.served.line.plugged = False
    live.page.wait_for_selector("#banner:not([hidden])")
    expect(live.page.locator("#banner-message")).to_contain_text("Lost connection")


@pytest.mark.campaign  # on a busy machine every page hangs a little
@pytest.mark.parametrize("view", [{"dead_man_s": 0.3}], indirect=True)
def test_unresponsive_page_ends_live_mode_and_arm_holds(visit):
    operator = visit()
    under_way(operator.enable_live())
    operator.page.evaluate(HANG)
    operator.wait_for("!status.live").until_still()
    assert "does not answer" in operator.status["messages"][-1]["message"]


@pytest.mark.parametrize("view", [{"dead_man_s": 0.3}], indirect=True)
def test_planned_motion_continues_if_page_is_unresponsive(operator):
    operator.page.fill("[data-joint=shoulder_pan] input[type=text]", "60")
    operator.page.keyboard.press("Enter")
    operator.page.click("#execute:enabled")
    operator.until_moving()
    operator.page.evaluate(HANG)
    operator.wait_for("status.mode === 'preview'")
    assert operator.served.joints()["shoulder_pan"] == pytest.approx(np.radians(60), abs=0.03)


@pytest.mark.campaign
def test_hidden_page_ends_live_mode_and_arm_holds(live):
    under_way(live)
    live.page.evaluate(
        "Object.defineProperty(document, 'visibilityState', { get: () => 'hidden' });"
        "document.dispatchEvent(new Event('visibilitychange'));"
    )
    live.wait_for("!status.live && status.mode === 'preview'").until_still()


def test_reloaded_page_starts_in_slow_preview_and_arm_holds(live):
    under_way(live)
    live.page.reload()
    live.until(SHOWN).wait_for(
        "status.mode === 'preview' && status.controller === 'you'"
    ).until_still()
    assert live.status["speed"] == "slow"
    assert not live.served.view.arm_thread.command.live


def test_second_page_watches_and_moves_nothing(live, visit):
    other = visit()
    assert other.status["controller"] == "other"
    before = live.served.ticks()
    other.click(other.tip_px() + FAR)
    other.until_still()
    assert max(abs(live.served.ticks()[i] - before[i]) for i in before) <= 2


@pytest.mark.campaign
def test_refused_action_is_shown_on_banner_that_disappears(operator, visit):
    other = visit()
    other.click(other.tip_px())
    other.page.wait_for_selector("#banner:not([hidden])")
    expect(other.page.locator("#banner-message")).to_contain_text("Another page")
    expect(other.page.locator("#acknowledge")).to_be_hidden()
    other.page.wait_for_selector("#banner", state="hidden")


@pytest.mark.campaign
def test_taking_control_from_another_page_makes_arm_hold(live, visit):
    other = visit()
    other.page.click("#take")
    other.wait_for("status.controller === 'you' && status.mode === 'preview'")
    live.wait_for("status.controller === 'other' && !status.live")


@pytest.mark.campaign
def test_watching_page_has_live_and_stop_buttons_disabled(visit, operator):
    watcher = visit(watch=True)
    expect(watcher.page.locator("#live")).to_be_disabled()
    expect(watcher.page.locator("#stop")).to_be_disabled()
    expect(watcher.page.locator("#take")).to_be_hidden()


CONNECT = """(address) => new Promise((say) => {
  const socket = new WebSocket(address);
  socket.onopen = () => say("open");
  socket.onerror = () => say("refused");
})"""


def test_page_of_another_origin_is_refused(operator, browser):
    address = operator.served.urls.control.partition("/#")[0].replace("http", "ws") + "/live"
    context = browser.new_context()
    page = with_long_timeout(context.new_page())
    page.route("http://evil.example/", lambda route: route.fulfill(body="<p>harmless</p>"))
    page.goto("http://evil.example/")
    assert page.evaluate(CONNECT, address) == "refused"
    context.close()


@pytest.mark.campaign
def test_wrong_access_key_is_reported_on_page(operator):
    page = with_long_timeout(operator.page.context.new_page())
    page.goto(operator.served.urls.control.partition("#")[0] + "#token=wrong")
    page.wait_for_selector("#banner:not([hidden])")
    expect(page.locator("#banner-message")).to_contain_text("key")


@pytest.mark.campaign
def test_access_key_of_page_is_never_sent_in_clear_text(browser, view):
    context = browser.new_context()
    page, seen = with_long_timeout(context.new_page()), []

    def record_frame(frame):
        seen.append(frame)

    page.on("request", lambda request: seen.append((request.url, str(request.headers))))
    page.on("websocket", lambda socket: socket.on("framesent", record_frame))
    page.goto(view.urls.control)
    page.wait_for_selector("#views button")
    assert len(seen) > 5
    assert not [words for words in seen if view.app.keys.control in str(words)[:4000]]
    context.close()


def test_page_computes_the_same_hmac_as_the_server(operator):
    texts = ["", "abc", "ü" * 40, "x" * 200]
    script = "async (texts) => { const { hmac } = await import('/page/sha256.js');"
    found = operator.page.evaluate(
        f"{script} return texts.map((t) => hmac('k\\u00e9y', t)); }}", texts
    )
    assert found == [
        hmac.new("kéy".encode(), t.encode(), hashlib.sha256).hexdigest() for t in texts
    ]
