"""A camera whose cable a test can pull."""

import threading

import numpy as np


class Webcam:
    """A camera with pictures of one colour whose cable a test can pull."""

    def __init__(self):
        self.plugged, self.opened, self.released = True, 0, 0
        self.pace, self.error = threading.Event(), None
        self.delivers, self.is_held = threading.Event(), False
        self.delivers.set()

    def open(self, _source):
        self.opened += 1
        return self

    def isOpened(self):  # noqa: N802
        return self.plugged

    def read(self):
        self.pace.wait(0.01)
        self.is_held = not self.delivers.is_set()
        self.delivers.wait()
        if self.error is not None:
            raise self.error
        return self.plugged, np.full((24, 32, 3), (0, 0, 255), np.uint8)

    def release(self):
        self.released += 1
