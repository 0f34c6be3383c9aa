"""Power cuts at a chosen moment of a save or of a packet."""

import os

from ikservo.files import writing

# Calls of a save that may fail, or that a power cut may precede.
CALLS = ("open", "write", "fsync", "replace", "close", "unlink")


class PowerCut(BaseException):
    """Ends the program without handlers or clean-up."""


class PowerSupply:
    """Counts the operations that need power and fails at the nth."""

    def __init__(self, lasts=None):
        self.lasts, self.spent = lasts, 0

    @property
    def is_cut(self):
        return self.lasts is not None and self.spent > self.lasts

    def spend(self):
        self.spent += 1
        if self.is_cut:
            raise PowerCut

    def limit_files(self, monkeypatch):
        """Count every system call of a save."""
        patch_calls(monkeypatch, self.spend)
        return self

    def limit_port(self, port):
        """Count every packet to the servos."""
        write = port.write

        def patch_calls(data):
            if data[:2] == b"\xff\xff" and is_write(bytes(data)):
                self.spend()
            elif self.is_cut:
                raise PowerCut
            return write(data)

        port.write = patch_calls
        return self


def is_write(packet):
    """Return whether a packet is a write: protocol 2.0, or 1.0 and Feetech."""
    return (packet[7] if packet[:4] == b"\xff\xff\xfd\x00" else packet[4]) == 3


def patch_calls(monkeypatch, before):
    """Call ``before`` ahead of every disk call of a save."""
    monkeypatch.setattr(writing, "os", _Calls(os, CALLS, before))


def restore_calls(monkeypatch):
    """Restore the real calls."""
    monkeypatch.setattr(writing, "os", os)


class _Calls:
    """A module that calls ``before`` ahead of some of its functions."""

    def __init__(self, module, names, before):
        self._module, self._names, self._before = module, names, before

    def __getattr__(self, name):
        real = getattr(self._module, name)
        if name not in self._names:
            return real

        def call(*args, **kwargs):
            self._before()
            return real(*args, **kwargs)

        return call


class FailingCall:
    """Raises ``OSError`` at the nth call of a save."""

    def __init__(self, nth, number):
        self.nth, self.number, self.calls = nth, number, 0

    def __call__(self):
        self.calls += 1
        if self.calls == self.nth:
            raise OSError(self.number, os.strerror(self.number))
