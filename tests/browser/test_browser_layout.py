"""Layout of the page: a notice covers nothing that the user looks at."""

import itertools

import pytest
from playwright.sync_api import expect

from tests.browser.page_operator import Operator, with_long_timeout

pytestmark = pytest.mark.browser

SIZES = {"desktop": (1280, 800), "laptop": (1100, 720), "phone": (390, 844)}


@pytest.fixture(params=SIZES)
def reader(browser, shared, request):
    width, height = SIZES[request.param]
    options = {"viewport": {"width": width, "height": height}, "has_touch": width < 500}
    context = browser.new_context(**options)
    yield Operator(context.new_page(), shared.brought_home())
    context.close()


def boxes(operator, *selectors):
    """Return the boxes of elements in one step: a list may be redrawn between two of them."""
    box = "document.querySelector(each).getBoundingClientRect().toJSON()"
    return operator.page.evaluate(f"(selectors) => selectors.map((each) => {box})", selectors)


def overlap(one, other):
    """Return whether two boxes share more than a pixel in both directions."""
    return all(
        min(one[at] + one[size], other[at] + other[size]) - max(one[at], other[at]) > 1
        for at, size in (("x", "width"), ("y", "height"))
    )


def test_stop_banner_and_plots_cover_neither_arm_nor_panel(reader):
    reader.page.click("#stop")
    reader.wait_for("status.mode === 'stopped'")
    reader.page.click("#plots-toggle:has-text('Last stop')")
    reader.page.wait_for_selector("#plots-charts canvas")
    reader.wait_for_picture()
    banner, plots, drawing, panel, mode, tip = boxes(
        reader, "#banner", "#plots", "#drawing", ".panel", ".mode", ".readout"
    )
    assert not any(overlap(banner, each) for each in (plots, panel, mode, tip))
    assert not any(overlap(plots, each) for each in (drawing, panel))
    assert drawing["height"] > 0.5 * (drawing["height"] + plots["height"])
    assert reader.items("measured")


def test_first_hint_is_shown_beside_tip_until_first_drag(reader):
    mission = reader.page.locator("#mission")
    reader.until("!document.getElementById('mission').hidden")
    (box,) = boxes(reader, "#mission")
    x, y = reader.over(reader.tip_px())
    assert abs(box["y"] - y) < 60
    assert box["x"] - 40 < x < box["x"] + box["width"] + 40
    reader.drag(reader.tip_px(), (30.0, -30.0)).release()
    mission.wait_for(state="hidden")
    reader.page.click("#undo")
    reader.wait_for("!status.target")
    assert mission.is_hidden()


def test_hints_do_not_cover_drawing_of_stopped_arm(reader):
    reader.page.click("#stop")
    reader.wait_for("status.mode === 'stopped'")
    for selector in ("#hint", "#mission"):
        reader.page.locator(selector).wait_for(state="hidden")


def test_go_there_button_is_at_target_or_in_bar_on_narrow_page(reader):
    reader.drag(reader.tip_px(), (40.0, -60.0)).release()
    reader.wait_for("status.target && !status.refused")
    reader.until("!document.getElementById('execute').disabled")
    if reader.page.viewport_size["width"] < 1020:
        assert reader.page.locator(".bar-end #execute").is_visible()
        return
    reader.until("document.getElementById('execute').classList.contains('at-target')")
    (box,) = boxes(reader, "#execute")
    (target,) = reader.items("target")
    x, y = reader.over(target["at"])
    assert 0 < box["x"] - x < 40
    assert 0 < box["y"] - y < 40


def test_go_there_button_does_not_cover_the_corner_readout(browser, shared):
    context = browser.new_context(viewport={"width": 1100, "height": 720})
    reader = Operator(context.new_page(), shared.brought_home())
    reader.click((170.0, 140.0))
    reader.wait_for("status.target && !status.refused")
    reader.until("document.getElementById('execute').classList.contains('at-target')")
    execute, corner = boxes(reader, "#execute", ".corner")
    assert not overlap(execute, corner)
    context.close()


def test_readout_shows_tip_and_solver_panel_shows_posture(reader):
    assert [each.inner_text() for each in reader.page.locator(".readout dt").all()] == ["tip"]
    assert reader.page.locator("#posture").is_hidden()
    reader.open_solver()
    expect(reader.page.locator("#posture")).to_contain_text("manipulability")


def test_page_reports_full_server_until_it_is_accepted(browser, shared, monkeypatch):
    monkeypatch.setattr("ikservo.apps.page.server.server._MAX_CLIENTS", 0)
    context = browser.new_context()
    page = with_long_timeout(context.new_page())
    page.goto(shared.urls.watch)
    page.wait_for_selector("#banner-message:has-text('16 pages are already watching this arm')")
    monkeypatch.undo()
    page.wait_for_selector("#banner", state="hidden")
    context.close()


def test_long_message_is_shown_from_its_first_line(reader):
    reader.page.get_by_label("Tool x, mm", exact=True).fill("2000")
    reader.page.keyboard.press("Enter")
    reader.until(
        "document.querySelector('#log li:last-child')?.innerText.includes('cannot be reached')"
    )
    log, message = boxes(reader, "#log", "#log li:last-child")
    assert message["y"] >= log["y"] - 1


def test_last_panel_on_phone_is_not_covered_by_fixed_bar(visit):
    operator = visit()
    operator.page.set_viewport_size({"width": 390, "height": 844})
    operator.wait_for_picture()
    operator.page.evaluate("scrollTo(0, document.documentElement.scrollHeight)")
    card, bar = boxes(operator, "#servos", ".bar-end")
    assert card["y"] + card["height"] <= bar["y"]


@pytest.mark.parametrize(("width", "height"), [(390, 844), (820, 900), (1100, 720)])
def test_page_mode_text_tools_and_readout_do_not_overlap(visit, width, height):
    operator = visit()
    page = operator.page
    page.set_viewport_size({"width": width, "height": height})
    operator.wait_for_picture()
    operator.click((180.0, 260.0)).wait_for("status.tip.some(([name]) => name === 'target')")
    long_text = "Preview – limp: shoulder_pan, shoulder_lift, elbow_flex, wrist_flex, wrist_roll"
    page.evaluate(
        "(text) => { Object.defineProperty(document.getElementById('mode'), 'textContent',"
        "  { get: () => text }); document.getElementById('mode').innerText = text;"
        "  for (const id of ['rendering', 'mark-tip', 'height-field', 'handles'])"
        "    document.getElementById(id).hidden = false; }",
        long_text,
    )
    page.evaluate("() => new Promise((done) => requestAnimationFrame(() => setTimeout(done, 50)))")
    found = boxes(
        operator, ".mode", ".stage-tools", ".view-tools", ".readout", "#gripper", "#poses"
    )
    assert not any(overlap(*pair) for pair in itertools.combinations(found, 2))
    page.click("#help-button")
    page.click("#arms-toggle")
    expect(page.locator("#arms")).to_be_visible()
    expect(page.locator("#help")).to_be_hidden()
