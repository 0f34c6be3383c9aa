"""A power supply for tests: it fails at a chosen moment, for files and for servos alike."""

import os

from ikservo.files import writing


class PowerCut(BaseException):
    """Nothing runs any more, no handler and no clean-up."""


class Power:
    """Counts what needs power and cuts it before the nth of them."""

    def __init__(self, lasts=None):
        self.lasts, self.spent = lasts, 0

    @property
    def gone(self):
        return self.lasts is not None and self.spent > self.lasts

    def spend(self):
        self.spent += 1
        if self.gone:
            raise PowerCut

    def feeds_files(self, monkeypatch):
        """Let every system call of a save need power."""
        monkeypatch.setattr(writing, "os", _Os(self))
        return self

    def feeds_port(self, port):
        """Let every packet to the servos need power."""
        write = port.write

        def powered(data):
            if data[:2] == b"\xff\xff" and is_write(bytes(data)):
                self.spend()
            elif self.gone:
                raise PowerCut
            return write(data)

        port.write = powered
        return self


def is_write(packet):
    """Return whether a packet writes into a memory: protocol 2.0, or 1.0 and Feetech."""
    return (packet[7] if packet[:4] == b"\xff\xff\xfd\x00" else packet[4]) == 3


class _Os:
    """The module os, each of whose calls that touch a disk needs power."""

    def __init__(self, power):
        self._power = power

    def __getattr__(self, name):
        real = getattr(os, name)
        if name not in ("open", "write", "fsync", "replace"):
            return real

        def call(*words, **more):
            self._power.spend()
            return real(*words, **more)

        return call


class FailingOs:
    """The module os, whose nth call of a save fails with an error."""

    def __init__(self, nth, number):
        self.nth, self.number, self.calls = nth, number, 0

    def __getattr__(self, name):
        real = getattr(os, name)
        if name not in ("open", "write", "fsync", "replace"):
            return real

        def call(*words, **more):
            self.calls += 1
            if self.calls == self.nth:
                raise OSError(self.number, os.strerror(self.number))
            return real(*words, **more)

        return call
