"""A person before the page, and the arm behind it as the simulated servos have it."""

import math
from contextlib import contextmanager

import numpy as np
import pinocchio

from ikservo.model import load_model
from ikservo.view.session.house import House
from tests.arm.simulated import line_of, registers, true_joints, true_tip_m
from tests.oracle import pinocchio_model

PATIENCE_MS = 15_000
_STILL = 10


class Stand:
    """A served view: its addresses, and its simulated servos."""

    def __init__(self, house, urls):
        self.house, self.urls = house, urls

    @property
    def arm(self):
        return self.house.pilot.arm

    @property
    def line(self):
        return line_of(self.arm)

    def ticks(self):
        return registers(self.arm, "present_position")

    def goals(self):
        return registers(self.arm, "goal_position")

    def tip_m(self):
        return true_tip_m(self.arm)

    def joints(self):
        return true_joints(self.arm)

    def place_m(self, joint):
        """Return where a joint's pivot is (3,), metres, by Pinocchio."""
        model = pinocchio_model(self.arm.model.name)
        q = pinocchio.neutral(model)
        for name, value in self.joints().items():
            q[model.joints[model.getJointId(name)].idx_q] = value
        data = model.createData()
        pinocchio.forwardKinematics(model, data, q)
        return np.array(data.oMi[model.getJointId(joint)].translation)


class HeldHouse(House):
    """A view of an arm that holds itself when it is opened, as one in use does."""

    def _open(self):
        arm = super()._open()
        arm.enable()
        return arm


@contextmanager
def opened_house(arm="so101", port="sim:?pose=home", dead_man_s=5.0):
    """Serve a view; a busy machine makes pages stutter, so the dead man is patient by default."""
    house = HeldHouse(load_model(arm), port, dead_man_s=dead_man_s)
    with house as urls, house.serve_beside():
        yield Stand(house, urls)


class Person:
    """Moves the pointer, presses keys and reads what the page says."""

    def __init__(self, page, stand, *, watch=False):
        self.page, self.stand = page, stand
        self.errors = []
        self.before = stand.ticks()
        page.set_default_timeout(PATIENCE_MS)
        page.on("pageerror", lambda error: self.errors.append(str(error)))
        page.goto(stand.urls.watch if watch else stand.urls.control)
        self.until("Boolean(window.ikservo?.scene && window.ikservo.status)")
        self.wait_for_picture()

    # --- what the page says ---

    @property
    def status(self):
        return self.page.evaluate("window.ikservo.status")

    def until(self, words):
        """Wait until an expression is true in the page."""
        for _ in range(PATIENCE_MS // 20):
            if self.page.evaluate(words):
                return self
            self.page.wait_for_timeout(20)
        raise AssertionError(f"never in {PATIENCE_MS} ms: {words}\n{self.status}")

    def wait_for(self, words):
        """Wait for an expression over `status` and `scene`."""
        begin = "(() => { const { status, scene } = window.ikservo;"
        return self.until(f"{begin} return Boolean({words}); }})()")

    def wait_for_picture(self):
        """Wait until what is drawn fits the drawing's size of now."""
        self.wait_for(
            "Math.abs(scene.items.find((i) => i.kind === 'text').at[1] + 22"
            " - document.getElementById('drawing').clientHeight) < 1"
        )
        self.box = self.page.locator("#drawing").bounding_box()

    def items(self, style, **names):
        scene = self.page.evaluate("window.ikservo.scene")
        return [
            item
            for item in scene["items"]
            if item["style"] == style and all(item.get(k) == v for k, v in names.items())
        ]

    @property
    def pixels_per_metre(self):
        """Return the scale, by the bar that the page draws."""
        bar, words = self.items("scale")
        number, unit = words["text"].split()
        length_m = float(number) * {"cm": 0.01, "mm": 0.001}[unit]
        return (bar["points"][1][0] - bar["points"][0][0]) / length_m

    def tip_px(self):
        return np.array(self.items("tip")[0]["at"])

    def hub_px(self, joint):
        return np.array(self.items("hub", joint=joint)[0]["at"])

    # --- what the person does ---

    def throw_live(self):
        self.page.click("#speeds button[value=fast]")
        self.wait_for("status.speed === 'fast'")
        self.page.click("#live")
        return self.wait_for("status.mode === 'live'")

    def over(self, px):
        return self.box["x"] + px[0], self.box["y"] + px[1]

    def click(self, px):
        self.before = self.stand.ticks()
        self.page.mouse.click(*self.over(px))
        return self

    def drag(self, start, move, steps=8):
        """Press at a pixel, move by pixels, and keep holding."""
        start, self.before = np.asarray(start), self.stand.ticks()
        self.page.mouse.move(*self.over(start))
        self.page.mouse.down()
        self.page.mouse.move(*self.over(start + move), steps=steps)
        return self

    def release(self):
        self.page.mouse.up()
        return self

    def until_still(self):
        """Wait until the servos have come to rest, where the page sent them."""
        still, last = 0, None
        for _ in range(PATIENCE_MS // 50):
            self.page.wait_for_timeout(50)
            now = (self.stand.ticks(), self.stand.goals())
            still, last = (still + 1 if now == last else 0), now
            if still >= _STILL:
                return self
        raise AssertionError("the arm does not come to rest")

    def until_moving(self):
        """Wait until the servos have moved since the last gesture began."""
        for _ in range(PATIENCE_MS // 20):
            self.page.wait_for_timeout(20)
            moved = max(abs(self.stand.ticks()[i] - self.before[i]) for i in self.before)
            if moved > 5:
                return self
        raise AssertionError(f"the arm does not move\n{self.status}")


def apart_mm(one, other):
    return 1000 * math.dist(one, other)
