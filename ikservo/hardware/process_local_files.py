"""Files that belong to one process: a forked child closes its copies at once.

Python opens files so that programs started with ``exec`` do not inherit them. A child made by a
plain ``fork`` (``os.fork``, ``multiprocessing`` with its method "fork") has a copy of every open
file: it would keep the lock of a port after its parent was killed, and could write to the servos.
"""

from __future__ import annotations

import os
from typing import Protocol
from weakref import WeakSet

__all__ = ["abandon_in_forked_children"]


class _ForkAware(Protocol):
    """An object with open files that a forked child must not keep."""

    def abandon(self) -> None:
        """Close this process's copies of the files; the parent keeps its own unchanged."""
        ...


_fork_aware: WeakSet[_ForkAware] = WeakSet()


def abandon_in_forked_children(resource: _ForkAware) -> None:
    """Call ``resource.abandon()`` in every child process forked while the resource exists."""
    _fork_aware.add(resource)


def _abandon_all_in_child() -> None:
    for resource in list(_fork_aware):
        resource.abandon()
    _fork_aware.clear()


if hasattr(os, "register_at_fork"):  # not on Windows, which has no fork
    os.register_at_fork(after_in_child=_abandon_all_in_child)
