"""A room of a test: an arm in virtual time, its pilot, its desk, and who visits it."""

import itertools

import numpy as np

from ikservo.arm import open_arm
from ikservo.view import messages as said
from ikservo.view.arm_thread import ArmThread
from ikservo.view.auth import Permission
from ikservo.view.controller import SessionController
from tests.arm.simulated import clock_of, line_of, registers, servo_group

NUMBERS = itertools.count(1)


class Room:
    """A desk, its pilot and the visitors of a test; nothing runs but what a test lets run."""

    def __init__(self, arm=None):
        self.arm = arm or open_arm("so101", "sim:?pose=home")
        self.arm.enable()
        self.clock = line_of(self.arm) and clock_of(self.arm)
        self.pilot = ArmThread(lambda: self.arm, self.clock)
        self.desk = SessionController(self.pilot, self.clock)
        self.goals = []
        self.visitor = self.arrive()

    def arrive(self, right=Permission.CONTROL):
        visitor = self.desk.connect(right)
        self.say(said.SetViewport, visitor, w=900, h=700, dpr=1, view="side")
        return visitor

    def say(self, kind, visitor=None, **fields):
        word = kind.model_fields["kind"].annotation.__args__[0]
        message = kind(kind=word, seq=next(NUMBERS), seen=0, **fields)
        self.desk.receive(visitor or self.visitor, message)

    def point(self, phase, x, y, visitor=None):
        self.say(said.Pointer, visitor, phase=phase, x=x, y=y, button=0, pointer=1)

    def click(self, x, y, visitor=None):
        self.point("down", x, y, visitor)
        self.point("up", x, y, visitor)

    def told(self, visitor=None):
        """Return the latest status and scene for a visitor."""
        self.clock.sleep_until(self.clock.now_s() + 0.11)
        frames = self.desk.frames(visitor or self.visitor)
        return {frame["kind"]: frame for frame in frames}

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.desk.close()
        self.arm.close()

    def ticks(self):
        return registers(self.arm, "present_position")

    def throw_live(self):
        self.say(said.SetSpeed, name="fast")
        self.say(said.SetLive, on=True)
        return self

    def listen_in(self):
        """Return a list that grows by the time and the positions of each goal on the bus."""
        servos, told = servo_group(self.arm), []
        command = type(servos).send_goals

        def heard(positions, *more):
            told.append((self.clock.now_s(), np.array(positions)))
            return command(servos, positions, *more)

        servos.send_goals = heard
        return told

    def run(self, beats=1000, at_beat=lambda _: None, *, beating=True):
        """Let the pilot do one thing, the page beating; ``at_beat`` may say more."""
        count = itertools.count()
        self.goals = []
        see = self.pilot.on_cycle

        def seen(beat):
            see(beat)
            self.goals.append(beat.goals.copy())
            number = next(count)
            if number > beats:
                self.say(said.SetLive, on=False)
            elif beating and number % 10 == 0:
                self.say(said.Heartbeat, visible=True)
            at_beat(number)

        self.pilot.on_cycle = seen
        self.pilot.step()
        self.pilot.on_cycle = see
