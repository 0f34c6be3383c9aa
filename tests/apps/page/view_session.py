"""A session of the view in virtual time: an arm, its thread, the controller and a client."""

import itertools
import time

import numpy as np

from ikservo.apps.page.message_handling import SessionController
from ikservo.apps.page.messages import page_messages
from ikservo.apps.page.running.arm_thread import ArmThread
from ikservo.apps.page.server.auth import Permission
from ikservo.arm import open_arm
from tests.arm.simulated import clock_of, line_of, registers, servo_group

NUMBERS = itertools.count(1)
LOOKS, LOOK_S = 3000, 0.005  # at a path that is planned in the background


class ViewSession:
    """A controller, its arm thread and its clients; a test runs each control cycle itself."""

    def __init__(self, arm=None):
        self.arm = arm or open_arm("so101", "sim:?pose=home")
        self.arm.enable()
        self.clock = line_of(self.arm) and clock_of(self.arm)
        self.arm_thread = ArmThread(lambda: self.arm, self.clock)
        self.controller = SessionController(self.arm_thread, self.clock)
        self.goals = []
        self.client = self.connect()

    def connect(self, right=Permission.CONTROL):
        client = self.controller.connect(right)
        self.send_message(page_messages.SetViewport, client, w=900, h=700, dpr=1, view="side")
        return client

    def send_message(self, kind, client=None, **fields):
        word = kind.model_fields["kind"].annotation.__args__[0]
        message = kind(kind=word, seq=next(NUMBERS), seen=0, **fields)
        self.controller.receive(client or self.client, message)

    def point(self, phase, x, y, client=None):
        self.send_message(page_messages.Pointer, client, phase=phase, x=x, y=y, button=0, pointer=1)

    def click(self, x, y, client=None):
        self.point("down", x, y, client)
        self.point("up", x, y, client)

    def latest_frames(self, client=None):
        """Return the latest status and scene for a client."""
        self.clock.sleep_until(self.clock.now_s() + 0.11)
        frames = self.controller.frames(client or self.client)
        return {frame["kind"]: frame for frame in frames}

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.controller.close()
        self.arm.close()

    @property
    def interaction(self):
        """Return the controller's gestures and goal; only this function accesses them."""
        return self.controller._interaction

    def planned(self):
        """Wait until the path to the goal is planned or refused; return the frames that say so."""
        for _ in range(LOOKS):
            self.arm_thread.step()
            frames, path = self.latest_frames(), self.interaction.path
            if path is not None and (path.plan is not None or path.refusal is not None):
                return frames
            time.sleep(LOOK_S)
        raise AssertionError("the path is never planned")

    def go_there(self):
        """Let the arm execute the shown path once there is one."""
        self.planned()
        number = self.interaction.path.number
        self.send_message(page_messages.ArmAction, action="execute", path=number)

    def camera(self, client=None):
        """Return the picking camera of a client."""
        controller = self.controller
        return controller._composer.camera(controller._clients[client or self.client])

    def chain_joints(self):
        """Return the measured joints of the chain (dof,)."""
        return self.arm.joint_index.chain_joints(self.arm_thread.snapshot.measured)

    def ticks(self):
        return registers(self.arm, "present_position")

    def enable_live(self):
        self.send_message(page_messages.SetSpeed, name="fast")
        self.send_message(page_messages.SetLive, on=True)
        return self

    def record_goals(self):
        """Return a list that grows by the time and the positions of each goal on the bus."""
        servos, sent_goals = servo_group(self.arm), []
        command = type(servos).send_goals

        def record(positions, *more):
            sent_goals.append((self.clock.now_s(), np.array(positions)))
            return command(servos, positions, *more)

        servos.send_goals = record
        return sent_goals

    def run(self, cycles=1000, on_cycle=lambda _: None, *, heartbeats=True):
        """Run one command with heartbeats of the page; ``on_cycle`` may send more messages."""
        count = itertools.count()
        self.goals, self.measured = [], []
        original = self.arm_thread.on_cycle

        def seen(cycle):
            original(cycle)
            self.goals.append(cycle.goals.copy())
            self.measured.append(cycle.measured.copy())
            number = next(count)
            if number > cycles:
                self.send_message(page_messages.SetLive, on=False)
            elif heartbeats and number % 10 == 0:
                self.send_message(page_messages.Heartbeat, visible=True)
            on_cycle(number)

        self.arm_thread.on_cycle = seen
        self.arm_thread.step()
        self.arm_thread.on_cycle = original
