"""Every fault on every arm, width and colour scheme: both tabs show it, and nothing moves."""

import itertools
import random

import pytest
from playwright.sync_api import expect

from servosim.faults import Fault
from tests.arm.simulated import servo_id
from tests.browser.page_operator import Operator, serve_view
from tests.browser.test_browser_page import CONTRAST
from tests.browser.test_browser_stop import TOUCHED

pytestmark = [pytest.mark.browser, pytest.mark.timeout(300)]

ARMS = ("so101", "koch", "wx250s", "planar3")
WIDTHS = (390, 820, 1100, 1600)
SCHEMES = ("light", "dark")
SEED = 19
HIDE = """(hidden) => {
  Object.defineProperty(document, "visibilityState", { get: () => hidden ? "hidden" : "visible", configurable: true });
  document.dispatchEvent(new Event("visibilitychange"));
}"""  # noqa: E501


class Pages:
    """A page in control of an arm, a second one that watches, and the arm's simulated line."""

    def __init__(self, browser, served, arm, width, scheme):
        self.served, self.arm = served, arm
        self.joint = served.arm.chain.names[0]
        options = {"viewport": {"width": width, "height": 844}, "color_scheme": scheme}
        self.contexts = [browser.new_context(**options) for _ in range(2)]
        self.operator, self.watcher = (
            Operator(context.new_page(), served) for context in self.contexts
        )
        self.page = self.operator.page

    @property
    def line(self):
        """Return the present line: an arm that was opened again has another one."""
        return self.served.line

    def close(self):
        for context in self.contexts:
            context.close()

    def under_way(self):
        """Switch Live on, and send a joint away; return once it moves."""
        if not self.operator.status["live"]:
            self.operator.wait_for("status.mode === 'preview'")
            self.operator.enable_live()
        self.operator.before = self.served.ticks()
        here = self.served.joints()[self.joint]
        self.type_joint(-25 if here > 0 else 25)
        self.operator.until_moving()

    def type_joint(self, degrees):
        field = self.page.locator(f"[data-joint={self.joint}] input[type=text]")
        field.fill(str(degrees))
        field.press("Enter")

    def add(self, kind, **fields):
        self.line.faults.add(Fault(kind, at_s=self.line.world.time_s, **fields))

    def expect_stop(self, *words):
        """Expect a stop in both tabs, Stop in reach, and no motion until it is acknowledged."""
        for tab in (self.operator, self.watcher):
            tab.wait_for("status.mode === 'stopped'")
            banner = tab.page.inner_text("#banner")
            assert any(word in banner for word in words), banner
        assert self.page.evaluate(TOUCHED, 0)
        assert self.page.evaluate("document.documentElement.scrollWidth <= innerWidth")
        assert self.page.evaluate(CONTRAST) == []
        self.expect_no_goals_until_acknowledged()

    def expect_no_goals_until_acknowledged(self):
        held = self.operator.until_still().served.goals() if self.line.plugged else None
        self.line.faults.clear()
        self.line.plugged = True
        self.page.click("#acknowledge")
        for tab in (self.operator, self.watcher):
            tab.wait_for("status.mode === 'preview'")
        if held is not None:
            after = self.served.goals()
            assert max(abs(after[i] - held[i]) for i in held) <= 4


def stop(pages):
    pages.under_way()
    pages.page.click("#stop")
    pages.expect_stop("Stopped from the page")


def silent_servo(pages):
    pages.under_way()
    pages.add("silent", id=servo_id(pages.arm, pages.joint))
    pages.expect_stop(pages.joint)


def reset(pages):
    pages.under_way()
    pages.add("reset", id=servo_id(pages.arm, pages.joint))
    pages.expect_stop("was reset", "does not answer")  # it is silent while it starts


def brown_out(pages):
    pages.under_way()
    pages.add("brownout", for_s=0.4)
    pages.expect_stop("lost its power", "was reset", "does not answer", "supply")


def low_supply(pages):
    pages.under_way()
    pages.add("voltage", volts=3.0, for_s=3.0)
    pages.expect_stop("supply", "voltage")
    pages.operator.wait_for("!status.health.supply.startsWith('3.0')")


def pulled_cable(pages):
    pages.under_way()
    pages.line.plugged = False
    pages.expect_stop("Lost connection")


def limp_servo(pages):
    pages.operator.wait_for("status.mode === 'preview'")
    pages.line.servos[servo_id(pages.arm, pages.joint)].write("torque_enable", 0)
    for tab in (pages.operator, pages.watcher):
        tab.until(f"document.getElementById('mode').textContent.includes('limp: {pages.joint}')")
    pages.page.locator(f"[data-joint={pages.joint}] .torque").click()
    for tab in (pages.operator, pages.watcher):
        tab.until("!document.getElementById('mode').textContent.includes('limp')")


def refused_goal(pages):
    pages.operator.wait_for("status.mode === 'preview'")
    before = pages.served.goals()
    pages.type_joint(1e4)
    pages.page.wait_for_selector("#banner:not([hidden])")
    assert pages.joint in pages.page.inner_text("#banner")
    assert pages.served.goals() == before


def hidden_page(pages):
    pages.under_way()
    pages.page.evaluate(HIDE, True)
    pages.operator.wait_for("status.mode === 'preview' && status.banner?.action === 'go_live'")
    pages.page.evaluate(HIDE, False)
    expect(pages.page.locator("#banner-message")).to_contain_text("the page was hidden")
    pages.page.click("#dismiss")
    pages.operator.wait_for("!status.banner")


def other_tab(pages):
    """The second tab cannot move the arm until it takes control by a button; the arm holds."""
    pages.under_way()
    expect(pages.watcher.page.locator("#live")).to_be_disabled()
    pages.watcher.page.click("#take")
    pages.watcher.wait_for("status.controller === 'you' && status.mode === 'preview'")
    pages.operator.wait_for("status.controller === 'other' && !status.live")
    pages.page.click("#take")
    pages.operator.wait_for("status.controller === 'you'")


def dead_server(pages):
    pages.served.server.close()
    for tab in (pages.operator, pages.watcher):
        tab.until("document.body.dataset.mode === 'lost'")
        expect(tab.page.locator("#stop")).to_be_disabled()
        expect(tab.page.locator("#banner")).to_contain_text("Stop cannot reach the arm")


# Low supply near the end: the alarm of a Dynamixel lasts until its power was off.
FAULTS = (stop, refused_goal, limp_servo, silent_servo, reset, hidden_page, other_tab,
          brown_out, pulled_cable, low_supply, dead_server)  # fmt: skip


def cells():
    """Return all cells with all faults, and a part that has each value at least once."""
    rng = random.Random(SEED)
    widths, faults = rng.sample(WIDTHS, 4), rng.sample(FAULTS, len(FAULTS))
    for i, (arm, width) in enumerate(zip(ARMS, widths, strict=True)):
        some = sorted(faults[i::4], key=FAULTS.index)
        yield pytest.param(arm, width, SCHEMES[i % 2], some, id=f"{arm}-{width}-part")
    for arm, width, scheme in itertools.product(ARMS, WIDTHS, SCHEMES):
        yield pytest.param(
            arm, width, scheme, FAULTS, id=f"{arm}-{width}-{scheme}", marks=pytest.mark.campaign
        )


@pytest.mark.parametrize(("arm", "width", "scheme", "faults"), list(cells()))
def test_fault_is_shown_in_both_browser_tabs_until_acknowledged(
    browser, arm, width, scheme, faults
):
    with serve_view(arm) as served:
        pages = Pages(browser, served, arm, width, scheme)
        try:
            for fault in faults:
                fault(pages)
            assert pages.operator.errors + pages.watcher.errors == []
        finally:
            pages.close()
