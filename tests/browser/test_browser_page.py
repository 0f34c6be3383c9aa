"""The page is legible in both colour schemes and works without a mouse, on desktop and phone."""

import pytest

from tests.browser.page_operator import SHOWN, Operator

pytestmark = pytest.mark.browser

# WCAG 2.2: 1.4.3 for text; large is 24 px, or 18.66 px where it is bold.
CONTRAST = """() => {
  const pen = Object.assign(document.createElement("canvas"), { width: 1, height: 1 })
    .getContext("2d", { willReadFrequently: true });
  const rgba = (colour) => {
    pen.clearRect(0, 0, 1, 1);
    pen.fillStyle = colour;
    pen.fillRect(0, 0, 1, 1);
    const [r, g, b, a] = pen.getImageData(0, 0, 1, 1).data;
    return [r, g, b, a / 255];
  };
  const over = (top, under) => top.slice(0, 3).map((c, i) => c * top[3] + under[i] * (1 - top[3]));
  const light = (colour) => {
    const [r, g, b] = colour.map((c) => c / 255)
      .map((c) => (c <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4));
    return 0.2126 * r + 0.7152 * g + 0.0722 * b;
  };
  const behind = (element) => {
    if (!element) return rgba(getComputedStyle(document.documentElement).backgroundColor);
    const own = rgba(getComputedStyle(element).backgroundColor);
    return own[3] === 1 ? own : over(own, behind(element.parentElement));
  };
  const poor = [];
  for (const element of document.querySelectorAll("body *")) {
    const words = [...element.childNodes].filter((n) => n.nodeType === 3).map((n) => n.data.trim()).join("");
    if (!words || !element.checkVisibility() || element.closest(":disabled")) continue;
    const style = getComputedStyle(element);
    const [a, b] = [over(rgba(style.color), behind(element)), behind(element)].map(light);
    const ratio = (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05);
    const size = parseFloat(style.fontSize);
    const least = size >= 24 || (size >= 18.66 && style.fontWeight >= 700) ? 3 : 4.5;
    if (ratio < least) poor.push(`${words.slice(0, 30)}: ${ratio.toFixed(2)}`);
  }
  return poor;
}"""  # noqa: E501

# What a person tabs through, in order, by the name that a screen reader says.
NAMES = """() => [...document.querySelectorAll("a[href], button, input, summary, [tabindex]")]
  .filter((e) => e.checkVisibility() && !e.disabled && e.tabIndex >= 0)
  .map((e) => e.getAttribute("aria-label") || e.textContent.trim())"""

FOCUSED = """() => document.activeElement.getAttribute("aria-label")
  || document.activeElement.textContent.trim()"""

SMALL = """(least) => [...document.querySelectorAll("button")]
  .filter((e) => e.checkVisibility())
  .filter((e) => Math.min(e.offsetWidth, e.offsetHeight) < least)
  .map((e) => `${e.textContent.trim()} ${e.offsetWidth} x ${e.offsetHeight}`)"""

BELOW = """() => [...document.querySelectorAll("button")]
  .filter((e) => e.checkVisibility())
  .filter((e) => e.getBoundingClientRect().bottom > innerHeight)
  .map((e) => e.textContent.trim())"""


@pytest.fixture(scope="module")
def reader(browser, shared):
    """Return a user who reads one page during all tests of this module."""
    context = browser.new_context(viewport={"width": 1280, "height": 800})
    yield Operator(context.new_page(), shared)
    context.close()


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_page_text_has_enough_contrast_in_both_schemes(reader, scheme):
    reader.page.emulate_media(color_scheme=scheme, reduced_motion="reduce")
    assert reader.page.evaluate(CONTRAST) == []
    reader.page.click("#stop")
    reader.page.wait_for_selector("#banner:not([hidden])")
    assert reader.page.evaluate(CONTRAST) == []
    reader.page.click("#acknowledge")
    reader.wait_for("status.mode === 'preview'")


def test_page_shows_every_button_on_desktop_screen(reader):
    reader.page.set_viewport_size({"width": 1280, "height": 800})
    reader.wait_for_picture()
    assert reader.page.evaluate(BELOW) == []


def test_page_controls_have_names_and_top_to_bottom_tab_order(reader):
    reader.page.reload()
    reader.until(SHOWN).wait_for("status.controller === 'you'")
    names, reached = reader.page.evaluate(NAMES), []
    for _ in names:
        reader.page.keyboard.press("Tab")
        reached.append(reader.page.evaluate(FOCUSED))
    assert all(names)
    assert reached == names
    assert names[:3] == ["To the arm", "Arms", "Side"]


@pytest.mark.smoke
def test_views_speeds_and_live_mode_are_chosen_by_keyboard(reader):
    reader.page.focus("#views [aria-checked=true]")
    reader.page.keyboard.press("ArrowRight")
    reader.wait_for("document.querySelector('#views [aria-checked=true]').value === 'top'")
    reader.page.focus("#speeds [aria-checked=true]")
    reader.page.keyboard.press("ArrowRight")
    reader.wait_for("status.speed === 'normal'")
    reader.page.focus("#live")
    reader.page.keyboard.press("Enter")
    reader.wait_for("status.live")


def test_page_fits_phone_and_buttons_are_finger_sized(reader):
    reader.page.set_viewport_size({"width": 390, "height": 844})
    reader.wait_for_picture()
    assert reader.page.evaluate("document.documentElement.scrollWidth") <= 390
    assert reader.page.evaluate(SMALL, 24) == []  # WCAG 2.2, 2.5.8


def test_joint_meter_shows_position_and_limits(reader):
    meter = reader.page.locator("[data-joint=elbow_flex] [role=meter]")
    assert meter.get_attribute("aria-label") == "elbow_flex"
    assert meter.get_attribute("aria-valuetext").endswith("of -96.8° to 96.8°")
