"""Simulate a gamepad whose axes $IKSERVO_TEST_AXES gives as [x, y, unused, z]."""

import json
import os

JOYBUTTONDOWN, JOYBUTTONUP = 1, 2


class error(Exception):  # noqa: N801, N818  # pygame's name
    pass


def init():
    joystick.init()


def quit():
    pass


class joystick:  # noqa: N801
    ready = False

    @classmethod
    def init(cls):
        cls.ready = True

    @classmethod
    def quit(cls):
        cls.ready = False

    @classmethod
    def get_init(cls):
        return cls.ready

    @staticmethod
    def get_count():
        return 1

    class Joystick:
        def __init__(self, number):
            self.axes = json.loads(os.environ["IKSERVO_TEST_AXES"])

        def init(self):
            pass

        def quit(self):
            pass

        def get_name(self):
            return "scripted"

        def get_button(self, number):
            return False

        def get_axis(self, number):
            return self.axes[number]


class event:  # noqa: N801
    @staticmethod
    def get():
        return []
