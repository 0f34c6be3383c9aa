"""The page measures its frame time, and draws less if that is too long."""

import pytest
from playwright.sync_api import expect

from tests.browser.page_operator import Operator

pytestmark = pytest.mark.browser

SLOW_FRAMES = """(() => {
  const burn = () => {
    const start = performance.now();
    while (performance.now() - start < window.burnMs);
    requestAnimationFrame(burn);
  };
  window.burnMs = 120;
  burn();
})()"""
WIDTH = "document.getElementById('drawing').width"


def test_slow_page_reduces_drawing_detail_and_says_why(browser, view):
    context = browser.new_context(viewport={"width": 700, "height": 600}, device_scale_factor=2)
    operator = Operator(context.new_page(), view)
    level = "window.ikservo.frameTime.level"
    fine = operator.page.evaluate(WIDTH)
    operator.page.evaluate(SLOW_FRAMES)
    operator.until(f"{level} === 3 && {WIDTH} === {fine / 4}")
    expect(operator.page.locator("#log")).to_contain_text("The drawing takes")
    assert "ms per frame" in operator.page.text_content("#slow")
    drawn = operator.page.evaluate("window.ikservo.drawn")
    operator.until(f"window.ikservo.drawn > {drawn + 2}")  # it still draws
    operator.page.evaluate("window.burnMs = 0; window.ikservo.frameTime.retryMs = 100")
    operator.until(f"{level} < 3")
    context.close()
