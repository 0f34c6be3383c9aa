"""An operator of the page, and the simulated servos of the arm behind it."""

import itertools
import json
import math
import threading
import time
from contextlib import contextmanager

import numpy as np
import pinocchio
from playwright.sync_api import expect

from ikservo.apps.page.messages.page_messages import read_message
from ikservo.apps.page.page_app import ViewApp
from ikservo.apps.page.served_arms import ArmAtPort
from ikservo.apps.page.server.auth import Permission
from ikservo.model import load_model
from ikservo.model.scene_file import with_scene
from tests.arm.simulated import line_of, registers, true_joints, true_tip_m, without_zeros
from tests.oracle import pinocchio_model

TIMEOUT_S = 60.0  # for busy machines; waits for an event return with the event
REPEAT_S = 4.0  # between two presses; longer than a page needs to say that the first came too late
SHOWN = "Boolean(window.ikservo?.scene && window.ikservo.status)"
LOOK_MS = 40  # between two looks at the servos
STILL = 8  # number of looks; longer than a sagging arm waits before it lifts itself
THERE = 4  # number of looks
AT_HOME_RAD = 0.012  # more than an arm sags when its torque comes on


def attempts(pause, timeout_s=TIMEOUT_S):
    """Yield at once, then after each pause, until the time is over."""
    end_s = time.monotonic() + timeout_s
    while True:
        yield
        if time.monotonic() > end_s:
            return
        pause()


expect.set_options(timeout=1000 * TIMEOUT_S)


def with_long_timeout(page):
    """Give Playwright's own waits on a page the same time-out as those here."""
    page.set_default_timeout(1000 * TIMEOUT_S)
    return page


class ServedView:
    """A served view: its addresses, the stack that ends its server, and its simulated servos."""

    def __init__(self, app, urls, server):
        self.app, self.urls, self.server = app, urls, server

    @property
    def view(self):
        """Return the arm thread and the controller of the arm that a page shows first."""
        return self.app.arms.find("")

    @property
    def arm(self):
        return self.view.arm_thread.arm

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

    def brought_home(self):
        """Release what the last test left behind, and bring the arm to its first posture."""
        controller, arm_thread = self.view.controller, self.view.arm_thread
        until(lambda: not controller._clients)
        if arm_thread.snapshot.stop_notice:
            arm_thread.acknowledge()
            until(lambda: not arm_thread.snapshot.stop_notice)
        if not self.is_home():
            me, numbers = controller.connect(Permission.CONTROL), itertools.count(1)

            def send(**words):
                text = json.dumps({**words, "seq": next(numbers), "seen": 0})
                controller.receive(me, read_message(text))

            def is_home():
                send(kind="heartbeat", visible=True)  # a page that is silent ends Live
                return self.is_home()

            for words in GO_HOME:
                send(**words)
            until(is_home, lambda: (arm_thread.snapshot, self.joints()))
            controller.disconnect(me)
        return self

    def is_home(self):
        return away_from_home_rad(self.arm) < AT_HOME_RAD

    def place_m(self, joint):
        """Return the position of a joint's pivot (3,), metres, by Pinocchio."""
        model = pinocchio_model(self.arm.model.name)
        q = pinocchio.neutral(model)
        for name, value in self.joints().items():
            q[model.joints[model.getJointId(name)].idx_q] = value
        data = model.createData()
        pinocchio.forwardKinematics(model, data, q)
        return np.array(data.oMi[model.getJointId(joint)].translation)


class HoldingView(ViewApp):
    """A view of an arm that holds when it is opened, like one in use.

    Its simulator runs in real time, in which a limp arm falls before its torque is on.
    """

    def __init__(self, *args, calibrated=True, **options):
        self._calibrated = calibrated
        super().__init__(*args, **options)

    def _open_arm(self, model, port):
        arm = super()._open_arm(model, port)
        arm.enable()
        if "pose=home" in port and away_from_home_rad(arm) > AT_HOME_RAD:
            arm.pose("home", speed="fast")
        return arm if self._calibrated else without_zeros(arm)


def away_from_home_rad(arm):
    home = arm.model.pose("home")
    return max(abs(at - home[name]) for name, at in true_joints(arm).items())


@contextmanager
def serve_view(
    arm="so101", port="sim:?pose=home", dead_man_s=5.0, *, scene=None, calibrated=True, **options
):
    """Serve a view with a long dead-man time, because a busy machine delays pages."""
    model = load_model(arm) if scene is None else with_scene(load_model(arm), scene)
    places = [ArmAtPort(model, port)]
    view = HoldingView(places, dead_man_s=dead_man_s, calibrated=calibrated, **options)
    with view as urls, view.serve_in_thread() as server:
        yield ServedView(view, urls, server)


class Operator:
    """Moves the pointer, presses keys and reads what the page says."""

    def __init__(self, page, served, *, watch=False, options="&draw=2d"):
        self.page, self.served = page, served
        self.errors = []
        self.before = served.ticks()
        with_long_timeout(page)
        page.on("pageerror", lambda error: self.errors.append(str(error)))
        page.goto((served.urls.watch if watch else served.urls.control) + options)
        self.until(SHOWN)
        self.wait_for_picture()

    # --- what the page says ---

    @property
    def status(self):
        return self.page.evaluate("window.ikservo.status")

    def until(self, words):
        """Wait until an expression is true in the page."""
        for _ in attempts(self.look_again):
            if self.page.evaluate(words):
                return self
        raise AssertionError(f"never in {TIMEOUT_S} s: {words}\n{self.status}")

    def look_again(self):
        self.page.wait_for_timeout(LOOK_MS)

    def wait_for(self, words):
        """Wait for an expression over `status`, `scene` and the drawn `items`."""
        return self.until(over_page(words))

    def repeat(self, act, is_done):
        """Act until the action has its effect: a page that draws slowly refuses late input.

        The action must be repeatable, such as typing a number.
        """
        for _ in attempts(act, TIMEOUT_S):
            for _ in attempts(self.look_again, REPEAT_S):
                if is_done():
                    return self
        raise AssertionError(f"it never had its effect\n{self.status}")

    def type(self, selector, value, words):
        """Type into a field until an expression (see `wait_for`) is true."""

        def enter():
            self.page.fill(selector, value)
            self.page.press(selector, "Enter")

        enter()
        return self.repeat(enter, lambda: self.page.evaluate(over_page(words)))

    def until_drawn(self, frames=4):
        """Wait for the frame that includes all earlier actions: two frames may be under way."""
        drawn = self.page.evaluate("window.ikservo.drawn")
        return self.until(f"window.ikservo.drawn >= {drawn + frames}")

    def wait_for_picture(self):
        """Wait until the picture has the present size of the drawing."""
        self.wait_for(
            "Math.abs(scene.camera.size[1] - document.getElementById('drawing').clientHeight) < 1"
        )
        self.box = self.page.locator("#drawing").bounding_box()
        return self

    def items(self, style, **names):
        return [
            item
            for item in self.page.evaluate("window.ikservo.items")
            if item["style"] == style and all(item.get(k) == v for k, v in names.items())
        ]

    @property
    def pixels_per_metre(self):
        """Return the scale of the picture, by the bar that the page draws."""
        bar, words = self.items("scale")
        number, unit = words["text"].split()
        length_m = float(number) * {"cm": 0.01, "mm": 0.001}[unit]
        return (bar["points"][1][0] - bar["points"][0][0]) / length_m

    def tip_px(self):
        return np.array(self.items("tip")[0]["at"])

    def hub_px(self, joint):
        return np.array(self.items("hub", joint=joint)[0]["at"])

    # --- what the person does ---

    def start_calibration(self, how="accept"):
        """Press Calibrate, and choose a calibration by hand or another one."""
        self.page.click("#calibrate")
        self.page.click(f"#calibration:has([data-action=stops]) [data-action={how}]")
        return self.until("!document.querySelector('#calibration [data-action=stops]')")

    def open_solver(self):
        if self.page.get_attribute("#solver", "open") is None:
            self.page.click("#solver > summary")
        return self

    def enable_live(self):
        self.page.click("#speeds button[value=fast]")
        self.wait_for("status.speed === 'fast'")
        self.page.click("#live")
        return self.wait_for("status.mode === 'live'")

    def over(self, px):
        return float(self.box["x"] + px[0]), float(self.box["y"] + px[1])

    def click(self, px):
        self.before = self.served.ticks()
        self.page.mouse.click(*self.over(px))
        return self

    def drag(self, start, move, steps=8):
        """Press at a pixel, move by pixels, and keep holding."""
        start, self.before = np.asarray(start), self.served.ticks()
        self.page.mouse.move(*self.over(start))
        self.page.mouse.down()
        self.page.mouse.move(*self.over(start + move), steps=steps)
        return self

    def release(self):
        self.page.mouse.up()
        return self

    def until_still(self):
        """Wait until the servos have come to rest at the goal of the page."""
        still, last = 0, None
        for _ in attempts(self.look_again):
            now = (self.served.ticks(), self.served.goals())
            still, last = (still + 1 if now == last else 0), now
            if still >= STILL:
                return self
        raise AssertionError("the arm does not come to rest")

    def until_near(self, place_m, wanted_m, near_mm):
        """Wait until a point of the arm is at its expected position and stays there."""
        there = 0
        for _ in attempts(self.look_again):
            there = there + 1 if apart_mm(place_m(), wanted_m) < near_mm else 0
            if there >= THERE:
                return self
        raise AssertionError(f"{place_m()} m instead of {wanted_m} m\n{self.status}")

    def until_moving(self):
        """Wait until the servos have moved since the last gesture began."""
        for _ in attempts(self.look_again):
            moved = max(abs(self.served.ticks()[i] - self.before[i]) for i in self.before)
            if moved > 5:
                return self
        raise AssertionError(f"the arm does not move\n{self.status}")


GO_HOME = [{"kind": "set_speed", "name": "fast"}, {"kind": "set_live", "on": True},
           {"kind": "go_to_pose", "name": "home"}]  # fmt: skip


def over_page(words):
    """Convert an expression over `status`, `scene` and the drawn `items` to one of the page."""
    begin = "(() => { const { status, scene, items } = window.ikservo;"
    return f"{begin} return Boolean({words}); }})()"


def until(true, what=lambda: ""):
    """Wait until a condition is true; on a time-out report the state instead."""
    for _ in attempts(lambda: threading.Event().wait(LOOK_MS / 1000)):
        if true():
            return
    raise AssertionError(f"it never came true: {what()}")


def apart_mm(one, other):
    return 1000 * math.dist(one, other)
