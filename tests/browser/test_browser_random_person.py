"""Random input on the page of every arm: no goal leaves the limits."""

import contextlib

import numpy as np
import pytest
from playwright.sync_api import Error

from tests.arm.audit import Auditor
from tests.browser.page_operator import Operator, serve_view
from tests.oracle import ARMS

pytestmark = [pytest.mark.browser, pytest.mark.campaign, pytest.mark.timeout(600)]

DEEDS = 40
BUTTONS = (
    "#live", "#execute", "#stop", "#acknowledge", "#relax", "#take", "#undo", "#redo", "#fit",
    "#gripper-open", "#gripper-close", "#poses button", "#views button", "#speeds button",
    "#joint-steps button", "#tool-steps button", "[data-joint] button",
)  # fmt: skip
KEYS = ("ArrowUp", "ArrowDown", "ArrowLeft", "ArrowRight", "Alt+ArrowUp", "Escape", "Space")
RANGES = ("-400", "-90", "0", "35", "90", "400")
LIVE = 0.3  # the share of deeds before which Live is wanted


class RandomPerson:
    """Drags, clicks, types, presses buttons and keys at random, by a seed."""

    def __init__(self, operator, seed):
        self.operator, self.page, self.rng = operator, operator.page, np.random.default_rng(seed)
        self.page.set_default_timeout(1_000)

    def do_something(self):
        deeds = (
            self.press,
            self.press,
            self.drag,
            self.click,
            self.type_joint,
            self.key,
            self.look,
        )
        deed = deeds[self.rng.integers(len(deeds))]
        # what is disabled, hidden or covered cannot be used by a person either
        with contextlib.suppress(Error):
            if self.rng.random() < LIVE and self.operator.status["mode"] == "preview":
                self.page.click("#live")
            deed()
        self.page.wait_for_timeout(int(self.rng.integers(20, 1200)))

    def press(self):
        found = self.page.locator(BUTTONS[self.rng.integers(len(BUTTONS))]).all()
        found[self.rng.integers(len(found))].click()

    def drag(self):
        tip = self.operator.tip_px()
        start = tip if self.rng.random() < 0.6 else self.place()
        self.operator.drag(start, self.rng.uniform(-250.0, 250.0, 2), steps=10).release()

    def click(self):
        self.operator.click(self.place())

    def type_joint(self):
        fields = self.page.locator("[data-joint] input[type=text]").all()
        field = fields[self.rng.integers(len(fields))]
        field.fill(str(self.rng.choice(RANGES)))
        field.press("Enter")

    def key(self):
        self.page.keyboard.press(str(self.rng.choice(KEYS)))

    def look(self):
        self.page.mouse.wheel(0, float(self.rng.uniform(-300, 300)))

    def place(self):
        box = self.operator.box
        return self.rng.uniform((0.0, 0.0), (box["width"], box["height"]))


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize("name", ARMS)
def test_random_page_input_does_not_send_goals_outside_limits(browser, name, seed):
    with serve_view(name, "sim:" if seed % 2 else "sim:?pose=home") as served:
        audit, context = Auditor(served.arm), browser.new_context()
        operator = Operator(context.new_page(), served)
        person = RandomPerson(operator, seed)
        for _ in range(DEEDS):
            person.do_something()
        assert operator.errors == []
        operator.page.keyboard.press("Escape")
        operator.page.wait_for_timeout(1500)  # it brakes
        context.close()
        assert audit.goals
        assert [fault for fault in audit.faults() if "outside" in fault] == []
