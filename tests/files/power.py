"""A power supply for tests: it fails at a chosen moment, for files and for servos alike."""

import os
import tempfile

from ikservo.files import writing

# Everything of a save that the system may refuse or a power cut come before.
CALLS = ("open", "write", "fsync", "replace", "close", "unlink")


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
        powered(monkeypatch, self.spend)
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


def powered(monkeypatch, before):
    """Call ``before`` ahead of every call of a save that touches a disk."""
    monkeypatch.setattr(writing, "os", _Calls(os, CALLS, before))
    monkeypatch.setattr(writing, "tempfile", _Calls(tempfile, ("mkstemp",), before))


def unplugged(monkeypatch):
    """Give the real calls back."""
    monkeypatch.setattr(writing, "os", os)
    monkeypatch.setattr(writing, "tempfile", tempfile)


class _Calls:
    """A module, some of whose calls need something first."""

    def __init__(self, module, names, before):
        self._module, self._names, self._before = module, names, before

    def __getattr__(self, name):
        real = getattr(self._module, name)
        if name not in self._names:
            return real

        def call(*words, **more):
            self._before()
            return real(*words, **more)

        return call


class Refusals:
    """Lets the nth call of a save fail with an error."""

    def __init__(self, nth, number):
        self.nth, self.number, self.calls = nth, number, 0

    def __call__(self):
        self.calls += 1
        if self.calls == self.nth:
            raise OSError(self.number, os.strerror(self.number))
