"""Plots of the simulated servos, including the ten seconds before a stop."""

import csv

import pytest
from playwright.sync_api import expect

from servosim.faults import Fault
from tests.arm.simulated import servo_id
from tests.browser.test_browser_page import CONTRAST, NAMES, SMALL
from tests.browser.test_browser_safety import OWN, under_way

pytestmark = pytest.mark.browser

# How many pixels of a chart's canvas have the colour of a series.
DRAWN = """([quantity, series]) => {
  const canvas = document.querySelector(`[data-quantity=${quantity}] canvas`);
  const pen = canvas.getContext("2d");
  const style = getComputedStyle(document.documentElement);
  const probe = Object.assign(document.createElement("canvas"), { width: 1, height: 1 }).getContext("2d");
  probe.fillStyle = style.getPropertyValue(`--plot-${series}`);
  probe.fillRect(0, 0, 1, 1);
  const [r, g, b] = probe.getImageData(0, 0, 1, 1).data;
  const data = pen.getImageData(0, 0, canvas.width, canvas.height).data;
  let count = 0;
  for (let i = 0; i < data.length; i += 4)
    count += Math.abs(data[i] - r) + Math.abs(data[i + 1] - g) + Math.abs(data[i + 2] - b) < 40 && data[i + 3] > 200;
  return count;
}"""  # noqa: E501


def label(operator, quantity):
    return operator.page.locator(f"[data-quantity={quantity}] [role=img]").get_attribute(
        "aria-label"
    )


def open_plots(operator):
    operator.page.click("#plots-toggle")
    operator.page.wait_for_selector("[data-quantity=position] canvas")
    return operator


def test_plots_show_joint_positions_and_only_chosen_quantities(operator):
    open_plots(operator)
    degrees = operator.page.inner_text("[data-joint=elbow_flex] .value").rstrip("°")
    plotted = label(operator, "position").partition("elbow_flex ")[2].partition(",")[0]
    assert abs(float(plotted) - float(degrees)) < 0.5
    drawn = f"(line) => ({DRAWN})(line) > 10"  # as soon as the line is long enough
    operator.page.wait_for_function(drawn, arg=["position", 2])
    operator.page.click("#plots-quantities [value=voltage]")
    operator.page.click("#plots-quantities [value=error]")
    operator.page.click("#plots-joints [value=shoulder_pan]")
    operator.page.wait_for_selector(
        "[data-quantity=voltage] [role=img][aria-label*='elbow_flex 7.4']"
        ":not([aria-label*=shoulder_pan])"  # each click is answered by charts of its own
    )
    assert operator.page.locator("[data-quantity=error]").count() == 0
    operator.page.click("#plots-close")
    expect(operator.page.locator("#plots")).to_be_hidden()
    assert operator.page.evaluate("document.activeElement.id") == "plots-toggle"


@pytest.mark.sample(1)
@pytest.mark.parametrize(("width", "scheme"), [(390, "dark"), (1600, "light")])
def test_plots_are_legible_labelled_and_finger_sized(visit, width, scheme):
    operator = visit(color_scheme=scheme, reduced_motion="reduce")
    operator.page.set_viewport_size({"width": width, "height": 844})
    open_plots(operator)
    assert operator.page.evaluate(CONTRAST) == []
    assert operator.page.evaluate(SMALL, 24) == []
    assert operator.page.evaluate("document.documentElement.scrollWidth") <= width
    assert all(operator.page.evaluate(NAMES))


@pytest.mark.parametrize("view", [{"port": "sim"}], indirect=True, ids=["at rest"])
def test_plots_on_phone_are_below_arm(visit):
    operator = visit()
    page = operator.page
    page.set_viewport_size({"width": 390, "height": 844})
    operator.wait_for_picture()
    height = operator.box["height"]
    open_plots(operator).wait_for_picture()
    places = ("#drawing", "#plots", "#plots-charts", "#plots-quantities", "#poses", "#stop")
    drawing, plots, charts, toggles, poses, stop = (page.locator(i).bounding_box() for i in places)
    assert drawing["height"] == pytest.approx(height, abs=2)
    assert poses["y"] + poses["height"] <= drawing["y"] + drawing["height"]
    assert drawing["y"] + drawing["height"] <= plots["y"] + 1
    assert plots["y"] + plots["height"] <= stop["y"]
    assert charts["y"] < plots["y"] + 0.4 * plots["height"] < toggles["y"]
    assert charts["height"] > 100


@OWN
def test_plots_show_last_stop_until_it_is_acknowledged(live):
    under_way(live)
    joint = servo_id("so101", "wrist_flex")
    live.served.line.faults.add(Fault("silent", id=joint, at_s=live.served.line.world.time_s))
    live.wait_for("status.mode === 'stopped'")
    expect(live.page.locator("#plots")).to_be_hidden()  # the arm is to be looked at
    live.page.click("#plots-toggle:has-text('Last stop')")
    live.page.wait_for_selector("[data-quantity=error] canvas")
    live.page.wait_for_selector("#plots-reason:has-text('wrist_flex (id 4)')")
    expect(live.page.locator("#plots-spans [value=stop]")).to_have_attribute("aria-checked", "true")
    elbow = 3  # the largest error, so the longest curve
    live.page.wait_for_function(f"(line) => ({DRAWN})(line) > 10", arg=["error", elbow])
    with live.page.expect_download() as fetched:
        live.page.click("#plots-save")
    with fetched.value.path().open(newline="") as file:
        rows = list(csv.DictReader(file))
    moved = [abs(float(row["shoulder_lift_error_deg"] or 0)) for row in rows]
    assert max(moved) > 0
    assert {row["shoulder_lift_goal_deg"] == "" for row in rows} == {True, False}
    assert float(rows[-1]["losses"]) > float(rows[0]["losses"])
    live.served.line.faults.clear()
    live.page.click("#acknowledge")
    live.page.wait_for_selector("#plots-spans [value='60'][aria-checked=true]")
