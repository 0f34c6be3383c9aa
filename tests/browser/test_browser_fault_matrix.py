"""Every fault on every arm, width and colour scheme: told in both tabs, and nothing moves then."""

import itertools
import random

import pytest

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


class Desk:
    """A page in control of an arm, a second one that looks on, and the arm's simulated line."""

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
        """Return the line of now: an arm that was opened again has another one."""
        return self.served.line

    def close(self):
        for context in self.contexts:
            context.close()

    def under_way(self):
        """Go live, and send a joint away from where it is; return once it moves."""
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
        """Expect that both tabs say it, Stop is in reach, and nothing moves until acknowledged."""
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


def stop(desk):
    desk.under_way()
    desk.page.click("#stop")
    desk.expect_stop("Stopped from the page")


def silent_servo(desk):
    desk.under_way()
    desk.add("silent", id=servo_id(desk.arm, desk.joint))
    desk.expect_stop(desk.joint)


def reset(desk):
    desk.under_way()
    desk.add("reset", id=servo_id(desk.arm, desk.joint))
    desk.expect_stop("was reset", "does not answer")  # it is silent while it starts


def brown_out(desk):
    desk.under_way()
    desk.add("brownout", for_s=0.4)
    desk.expect_stop("was reset", "were reset", "does not answer", "supply")


def low_supply(desk):
    desk.under_way()
    desk.add("voltage", volts=3.0, for_s=3.0)
    desk.expect_stop("supply", "voltage")
    desk.operator.wait_for("!status.health.supply.startsWith('3.0')")


def pulled_cable(desk):
    desk.under_way()
    desk.line.plugged = False
    desk.expect_stop("Lost connection")


def limp_servo(desk):
    desk.operator.wait_for("status.mode === 'preview'")
    desk.line.servos[servo_id(desk.arm, desk.joint)].write("torque_enable", 0)
    for tab in (desk.operator, desk.watcher):
        tab.until(f"document.getElementById('mode').textContent.includes('limp: {desk.joint}')")
    desk.page.locator(f"[data-joint={desk.joint}] .torque").click()
    for tab in (desk.operator, desk.watcher):
        tab.until("!document.getElementById('mode').textContent.includes('limp')")


def refused_goal(desk):
    desk.operator.wait_for("status.mode === 'preview'")
    before = desk.served.goals()
    desk.type_joint(1e4)
    desk.page.wait_for_selector("#banner:not([hidden])")
    assert desk.joint in desk.page.inner_text("#banner")
    assert desk.served.goals() == before


def hidden_page(desk):
    desk.under_way()
    desk.page.evaluate(HIDE, True)
    desk.operator.wait_for("status.mode === 'preview' && status.banner?.action === 'go_live'")
    desk.page.evaluate(HIDE, False)
    assert "the page was hidden" in desk.page.inner_text("#banner-message")
    desk.page.click("#dismiss")
    desk.operator.wait_for("!status.banner")


def other_tab(desk):
    """The second tab cannot move the arm, and takes control by one button: the arm holds."""
    desk.under_way()
    assert desk.watcher.page.is_disabled("#live")
    desk.watcher.page.click("#take")
    desk.watcher.wait_for("status.controller === 'you' && status.mode === 'preview'")
    desk.operator.wait_for("status.controller === 'other' && !status.live")
    desk.page.click("#take")
    desk.operator.wait_for("status.controller === 'you'")


def dead_server(desk):
    desk.served.server.close()
    for tab in (desk.operator, desk.watcher):
        tab.until("document.body.dataset.mode === 'lost'")
        assert tab.page.is_disabled("#stop")
        assert "Stop cannot reach the arm" in tab.page.inner_text("#banner")


# Low supply near the end: the alarm of a Dynamixel lasts until its power was off.
FAULTS = (stop, refused_goal, limp_servo, silent_servo, reset, hidden_page, other_tab,
          brown_out, pulled_cable, low_supply, dead_server)  # fmt: skip


def cells():
    """Return all cells with all faults, and a part with each value of each at least once."""
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
def test_a_fault_is_told_in_both_tabs_and_nothing_moves_until_somebody_has_looked(
    browser, arm, width, scheme, faults
):
    with serve_view(arm) as served:
        desk = Desk(browser, served, arm, width, scheme)
        try:
            for fault in faults:
                fault(desk)
            assert desk.operator.errors + desk.watcher.errors == []
        finally:
            desk.close()
